//! An organisation that was invited has no certificate that counts yet: this node submits for it what it has signed
//! with the key of its invitation. The chaincode checks that signature; here only size and frequency are limited.

use super::EnrolmentService;
use bytes::Bytes;
use ledger_base::rejection::{Code, Rejection};
use std::net::IpAddr;

/// Largest request to join, in bytes: names, an address, and certificates in hexadecimal.
const JOIN_BYTES_MAX: usize = 64 * 1024;

impl EnrolmentService {
    /// Carries a request to the ledger.
    ///
    /// # Errors
    /// [`Code::TooLarge`], [`Code::Overloaded`] if too many were refused lately, and what the chaincode says.
    pub(super) async fn carry(&self, join: Bytes, source: IpAddr) -> Result<(), Rejection> {
        if join.len() > JOIN_BYTES_MAX {
            return Err(Rejection::new(Code::TooLarge, "the request to join is too large")
                .found(format!("{} bytes", join.len()))
                .wanted(format!("at most {JOIN_BYTES_MAX} bytes")));
        }
        self.shared.count_try(source)?;
        let Ok(_turn) = self.shared.carrying.try_acquire() else {
            return Err(Rejection::new(Code::Overloaded, "this node is processing another request to join")
                .next("try again in a few seconds"));
        };
        (self.shared.client.submit)("join_organisation", join).await?;
        self.shared.forgive_try(source);
        tracing::info!("an organisation joined through this node");
        Ok(())
    }
}
