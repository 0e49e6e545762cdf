//! The credentials of a node in its data directory: certificate, key, and the CAs whose keys it holds.

use crate::process::config::Config;
use crate::storage::files::{CERTIFICATE_FILE, KEY_FILE};
use crate::trust::ca::check_secret;
use crate::trust::enrolment::Authorities;
use ledger_api::tls::TlsIdentity;
use ledger_base::rejection::{Code, Rejection};
use std::sync::Arc;

/// The certificate, the key and the CAs of a node.
pub(crate) struct NodeCredentials {
    /// The node's certificate and key, shared with all that show them.
    pub(crate) identity: TlsIdentity,
    /// The CAs that the node carries.
    pub(crate) authorities: Arc<Authorities>,
}

impl NodeCredentials {
    /// Reads them from the data directory.
    ///
    /// # Errors
    /// [`Code::BadFile`] if one of the files is missing, damaged, or a key that others may read.
    pub(crate) fn read(config: &Config) -> Result<Self, Rejection> {
        check_secret(
            &config.data.join(KEY_FILE),
            "if others may have read it, remove the node from the network, and join it again with a new key",
        )?;
        let identity = TlsIdentity::from_pem_files(&config.data.join(CERTIFICATE_FILE), &config.data.join(KEY_FILE))
            .map_err(|error| Rejection::new(Code::BadFile, error.to_string()).next("restore the file from a copy"))?;
        let authorities =
            Arc::new(Authorities::open(&config.data, (config.ca.certificate_days, config.ca.secret_days))?);
        Ok(Self { identity, authorities })
    }
}
