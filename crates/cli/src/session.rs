//! A connection as the selected context.

use crate::context;
use crate::global::Global;
use crate::output::{Format, warn};
use bytes::Bytes;
use ledger_api::{Client, Committed, Context};
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::Identity;
use serde::Serialize;
use serde::de::DeserializeOwned;

/// The chaincode that keeps robots, grants and policies.
pub(crate) const ABAC: &str = "abac";
/// The chaincode that keeps organisations and revocations.
pub(crate) const MSP: &str = "msp";

/// A connection as the selected context.
pub(crate) struct Session {
    context: Context,
    /// For what is no call of a chaincode.
    pub(crate) client: Client,
    format: Format,
}

impl Session {
    /// Connects as the context that the command line, the environment or `context use` selects.
    pub(crate) async fn open(global: &Global) -> Result<Self, Rejection> {
        let session = Self { format: global.format(), ..Self::connect(context::selected(global)?).await? };
        global.upkeep.begin(global.format(), &session.context, &session.client);
        Ok(session)
    }

    /// Connects as this context, to whichever of its nodes serves.
    pub(crate) async fn connect(context: Context) -> Result<Self, Rejection> {
        let client = Client::connect(&context).await.map_err(context::fitting)?;
        Ok(Self { client, context, format: Format::Table })
    }

    /// Calls a function in a transaction and waits for its verdict, and a moment until that is certified. Warns if it is not.
    pub(crate) async fn call(&self, chaincode: &str, function: &str, args: Vec<Bytes>) -> Result<Committed, Rejection> {
        let done = self.client.invoke(chaincode, function, args).await?;
        self.warn_uncertified(&done);
        Ok(done)
    }

    /// Warns if the outcome of a transaction is not certified, although voters sign its block.
    pub(crate) fn warn_uncertified(&self, done: &Committed) {
        let Committed { id, certified, certificate_due, .. } = done;
        if *certificate_due && !certified {
            let message = format!(
                "transaction {id} is executed, but not certified yet: if the leader lies, only certified outcomes are \
                 final"
            );
            warn(self.format, &message, &format!("check again: ledgerctl tx {id}"));
        }
    }

    /// Calls a function on the committed state.
    pub(crate) async fn ask(&self, chaincode: &str, function: &str, args: Vec<Bytes>) -> Result<Bytes, Rejection> {
        Ok(self.client.query(chaincode, function, args).await?.response)
    }

    /// All elements of a list, which comes in pages.
    pub(crate) async fn list<T: DeserializeOwned>(&self, chaincode: &str, function: &str) -> Result<Vec<T>, Rejection> {
        self.client.list(chaincode, function).await
    }

    /// As whom we are connected, read from our certificate.
    pub(crate) fn identity(&self) -> Result<Identity, Rejection> {
        context::identity(&self.context)
    }

    /// The context behind the connection.
    pub(crate) fn context(&self) -> &Context {
        &self.context
    }

    /// SHA-256 of the root certificate of an organisation.
    pub(crate) fn ca_fingerprint(&self, organisation: &str) -> Result<Hash, Rejection> {
        self.context.ca_fingerprint(organisation).ok_or_else(|| {
            Rejection::new(Code::NotFound, format!("the context has no CA of {organisation}"))
                .wanted(format!("a root certificate of {organisation}"))
                .next("update the organisations of the context, then try again: ledgerctl context refresh")
        })
    }
}

/// A value as the JSON of an argument.
///
/// # Errors
/// [`Code::Internal`] if it cannot be written.
pub(crate) fn argument(value: &impl Serialize) -> Result<Bytes, Rejection> {
    serde_json::to_vec(value).map(Bytes::from).map_err(|error| {
        Rejection::new(Code::Internal, "an argument cannot be encoded as JSON").found(error.to_string())
    })
}
