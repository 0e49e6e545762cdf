//! Calls of this node on the ledger for its CAs, through its own gateway and signed as the node.

use bytes::Bytes;
use futures::future::BoxFuture;
use ledger::msp::NAME as MSP;
use ledger_api::tls::{ServerTrust, TlsIdentity, TrustSource};
use ledger_api::{Client, Credentials, Options};
use ledger_base::hash::Hash;
use ledger_base::rejection::Rejection;
use std::sync::Arc;
use std::time::Duration;

/// How long a call may take: who enrols waits for it.
const CALL_TIME_MAX: Duration = Duration::from_secs(10);

/// A call of a function of `msp` with one argument, signed by the node; answers with what the function returned.
type Submit = Box<dyn Fn(&'static str, Bytes) -> BoxFuture<'static, Result<Bytes, Rejection>> + Send + Sync>;
/// Waits until this node has executed everything that was committed when it was asked.
type CatchUp = Box<dyn Fn() -> BoxFuture<'static, Result<(), Rejection>> + Send + Sync>;

/// How the node speaks and hears; see the module.
pub(crate) struct LedgerClient {
    /// See [`Submit`].
    pub(super) submit: Submit,
    /// See [`CatchUp`].
    pub(super) catch_up: CatchUp,
}

impl LedgerClient {
    /// Through the gateway at `address`, which is this node's own.
    pub(crate) fn through(address: &str, network: Hash, identity: &TlsIdentity, trust: &Arc<dyn TrustSource>) -> Self {
        let door = Door { address: address.to_owned(), network, identity: identity.clone(), trust: Arc::clone(trust) };
        let (submitting, door) = (door.clone(), door);
        Self {
            submit: Box::new(move |function, argument| {
                let door = submitting.clone();
                Box::pin(async move {
                    let done = door.connect().await?.invoke(MSP, function, vec![argument]).await?;
                    Ok(done.response)
                })
            }),
            catch_up: Box::new(move || {
                let door = door.clone();
                Box::pin(async move { door.connect().await?.query(MSP, "organisations", Vec::new()).await.map(drop) })
            }),
        }
    }
}

#[derive(Clone)]
struct Door {
    address: String,
    network: Hash,
    identity: TlsIdentity,
    trust: Arc<dyn TrustSource>,
}

impl Door {
    /// A connection for one call: enrolments are rare, and the node's certificate is renewed meanwhile.
    async fn connect(&self) -> Result<Client, Rejection> {
        let trust = ServerTrust::Network(Arc::clone(&self.trust));
        let credentials = Credentials::new(self.network, self.identity.clone(), trust)?;
        let options = Options { deadline: CALL_TIME_MAX, ..Options::default() };
        Client::connect_with(vec![self.address.clone()], credentials, options).await
    }
}
