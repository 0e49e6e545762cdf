//! A host: what the process gives to the ledger that runs in it. Where it listens, its certificate, the CAs that it carries.
//!
//! ```text
//! node      a host and its instance: up, and down in order
//! serve     the services of an instance on the host's listener
//! ```

mod node;
mod serve;

pub use node::{Node, NodeBuilder};
pub(crate) use serve::{Deliver, Services};

use crate::ca::check_secret;
use crate::config::Config;
use crate::enrolment::Authorities;
use ledger_api::tls::TlsIdentity;
use ledger_rejection::{Code, Rejection};
use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr};
use std::sync::Arc;
use tokio::net::TcpListener;

/// The node's certificate, its CA behind it, in its data directory.
pub(crate) const CERTIFICATE_FILE: &str = "node.pem";
/// The node's key, in its data directory.
pub(crate) const KEY_FILE: &str = "node.key";

/// What a process gives to a ledger.
pub(crate) struct Host {
    /// The node's certificate and key, shared with all that show them.
    pub(crate) identity: TlsIdentity,
    /// The CAs that the node carries.
    pub(crate) authorities: Arc<Authorities>,
    listener: TcpListener,
    address: SocketAddr,
}

impl Host {
    /// Reads the certificate, the key and the CAs of the data directory, and listens. Nothing is accepted before
    /// [`Host::serve`].
    ///
    /// # Errors
    /// [`Code::BadFile`] if one of the files is missing, damaged, or a key that others may read;
    /// [`Code::BadConfiguration`] if nothing can listen there.
    pub(crate) async fn open(config: &Config) -> Result<Self, Rejection> {
        check_secret(
            &config.data.join(KEY_FILE),
            "if others may have read it, remove the node and let it join anew with another key",
        )?;
        let identity = TlsIdentity::from_pem_files(&config.data.join(CERTIFICATE_FILE), &config.data.join(KEY_FILE))
            .map_err(|error| Rejection::new(Code::BadFile, error.to_string()).next("restore the file from a copy"))?;
        let authorities =
            Arc::new(Authorities::open(&config.data, (config.ca.certificate_days, config.ca.secret_days))?);
        let listener = listen(&config.listen).await?;
        let address = listener.local_addr().map_err(|error| Rejection::new(Code::Internal, error.to_string()))?;
        Ok(Self { identity, authorities, listener, address })
    }

    /// Where it listens; the port is the real one where the configuration said 0.
    pub(crate) fn address(&self) -> SocketAddr {
        self.address
    }

    /// Where this machine reaches the node's own gateway.
    pub(crate) fn own_gateway(&self) -> String {
        reachable(self.address).to_string()
    }
}

/// Where this machine reaches a node that may listen on all its addresses.
fn reachable(mut address: SocketAddr) -> SocketAddr {
    if address.ip().is_unspecified() {
        address.set_ip(if address.is_ipv4() { Ipv4Addr::LOCALHOST.into() } else { Ipv6Addr::LOCALHOST.into() });
    }
    address
}

async fn listen(address: &str) -> Result<TcpListener, Rejection> {
    TcpListener::bind(address).await.map_err(|error| {
        Rejection::new(Code::BadConfiguration, format!("cannot listen on {address}: {error}"))
            .next("choose another address with the setting listen, or end the process that uses this one")
    })
}
