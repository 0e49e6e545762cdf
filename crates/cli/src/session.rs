//! A connection as the selected context.

use crate::cli::Global;
use crate::context;
use ledger::identity::Identity;
use ledger::{Bytes, Code, Hash, Rejection};
use ledger_api::{Client, Committed, Context};
use std::time::Duration;

/// The chaincode that keeps robots, grants and policies.
pub(crate) const ABAC: &str = "abac";
/// The chaincode that keeps organisations and revocations.
pub(crate) const MSP: &str = "msp";
/// How long a connection may take before the node counts as unreachable.
const CONNECT_MAX: Duration = Duration::from_secs(3);

/// A connection as the selected context.
pub(crate) struct Session {
    context: Context,
    /// For what is no call of a chaincode.
    pub(crate) client: Client,
}

impl Session {
    /// Connects as the context that the command line, the environment or `context use` selects.
    pub(crate) async fn open(global: &Global) -> Result<Self, Rejection> {
        Self::connect(context::selected(global)?).await
    }

    /// Connects as this context.
    pub(crate) async fn connect(context: Context) -> Result<Self, Rejection> {
        match tokio::time::timeout(CONNECT_MAX, Client::connect(&context)).await {
            Ok(client) => Ok(Self { client: client?, context }),
            Err(_) => Err(Rejection::new(Code::Unreachable, format!("no answer from {}", context.nodes.join(", ")))
                .found(format!("silence for {} s", CONNECT_MAX.as_secs()))
                .wanted("a node that answers")
                .next("check the address and that the node runs; `ledgerctl context show` prints what is tried")),
        }
    }

    /// Calls a function in a transaction and waits for its verdict.
    pub(crate) async fn call(&self, chaincode: &str, function: &str, args: Vec<Bytes>) -> Result<Committed, Rejection> {
        self.client.invoke(chaincode, function, args).await
    }

    /// Calls a function on the committed state.
    pub(crate) async fn ask(&self, chaincode: &str, function: &str, args: Vec<Bytes>) -> Result<Bytes, Rejection> {
        self.client.query(chaincode, function, args).await
    }

    /// As whom we are connected, read from our certificate.
    pub(crate) fn identity(&self) -> Result<Identity, Rejection> {
        context::identity(&self.context)
    }

    /// The context behind the connection.
    pub(crate) fn context(&self) -> &Context {
        &self.context
    }

    /// The address that a new member of our organisation can enrol at.
    pub(crate) fn node(&self) -> String {
        self.context.nodes.first().cloned().unwrap_or_default()
    }

    /// SHA-256 of the root certificate of an organisation.
    pub(crate) fn ca_fingerprint(&self, organisation: &str) -> Result<Hash, Rejection> {
        let msp = self.context.msps.get(organisation);
        msp.and_then(|msp| msp.roots().next()).map(|root| Hash::of(&[root])).ok_or_else(|| {
            Rejection::new(Code::NotFound, format!("the context does not know the CA of {organisation}"))
                .wanted(format!("a root certificate of {organisation}"))
                .next("enrol again: the context was made before that organisation joined")
        })
    }
}
