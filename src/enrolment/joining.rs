//! An organisation that was invited has no certificate that counts yet: this node submits for it what it has signed
//! with the key of its invitation. The chaincode checks that signature; here only size and frequency are limited.

use super::EnrolmentService;
use futures::future::BoxFuture;
use ledger::governance::NAME as MSP;
use ledger::{Bytes, Code, Hash, Rejection};
use ledger_api::tls::{ServerTrust, TlsIdentity, TrustSource};
use ledger_api::{Client, Credentials, Options};
use std::sync::Arc;

/// Largest request to join, in bytes: names, an address, and certificates in hexadecimal.
const JOIN_BYTES_MAX: usize = 64 * 1024;

/// Carries requests through this node's own gateway, which is at `address`, signed as the node.
pub(crate) fn carrier(address: &str, network: Hash, identity: &TlsIdentity, trust: &Arc<dyn TrustSource>) -> Carrier {
    let (address, identity, trust) = (address.to_owned(), identity.clone(), Arc::clone(trust));
    Box::new(move |join| {
        let (nodes, trust) = (vec![address.clone()], ServerTrust::Network(Arc::clone(&trust)));
        let credentials = Credentials::new(network, identity.clone(), trust);
        Box::pin(async move {
            let client = Client::connect_with(nodes, credentials?, Options::default()).await?;
            client.invoke(MSP, "join_organisation", vec![join]).await.map(|_| ())
        })
    })
}

/// Submits a call of `msp join_organisation` with this argument as the node itself.
pub(crate) type Carrier = Box<dyn Fn(Bytes) -> BoxFuture<'static, Result<(), Rejection>> + Send + Sync>;

impl EnrolmentService {
    /// Carries a request to the ledger.
    ///
    /// # Errors
    /// [`Code::TooLarge`], [`Code::Overloaded`] if too many were refused lately, and what the chaincode says.
    pub(super) async fn carry(&self, join: Bytes) -> Result<(), Rejection> {
        if join.len() > JOIN_BYTES_MAX {
            return Err(Rejection::new(Code::TooLarge, "the request to join is too large")
                .found(format!("{} bytes", join.len()))
                .wanted(format!("at most {JOIN_BYTES_MAX} bytes")));
        }
        self.shared.begin_try()?;
        let Ok(_turn) = self.shared.carrying.try_acquire() else {
            return Err(Rejection::new(Code::Overloaded, "this node carries another request to join at the moment")
                .next("try again in a few seconds"));
        };
        (self.shared.carrier)(join).await?;
        self.shared.forgive_try();
        tracing::info!("an organisation has joined through this node");
        Ok(())
    }
}
