//! Renewal: whoever still has a good certificate receives the next one.

use super::EnrolmentService;
use ledger::identity::Identity;
use ledger::{Bytes, Rejection};
use ledger_api::v1;
use std::sync::Arc;

impl EnrolmentService {
    /// A certificate for the key of a request, by the CA of the caller's organisation. The caller was verified, on a
    /// connection or because it is this node itself.
    ///
    /// # Errors
    /// [`ledger::Code::NotFound`] if this node does not carry that CA, and as
    /// [`crate::ca::CertificateAuthority::renew`].
    pub(crate) async fn renew_for(
        &self,
        caller: Arc<Identity>,
        request: Bytes,
    ) -> Result<v1::EnrolResponse, Rejection> {
        self.blocking(move |shared| {
            let now = (shared.clock)();
            let certificate = shared.authority_of(&caller)?.renew(&caller.name, caller.role, &request, now)?;
            tracing::info!(name = caller.id(), "certificate renewed");
            Ok(v1::EnrolResponse {
                verdict: Some(v1::Verdict::default()),
                certificate: certificate.into(),
                // Our CAs sign with their root, which everybody has from the network.
                chain: Vec::new(),
                organisation: caller.organisation.clone(),
                network: Some(shared.network()),
            })
        })
        .await
    }

    /// Does this node carry the CA of that organisation?
    pub(crate) fn carries(&self, organisation: &str) -> bool {
        self.shared.authorities.contains_key(organisation)
    }
}
