//! Mutual TLS 1.3 between clients, bridges and nodes.
//!
//! The identity in the certificate counts, checked against the network's organisations
//! ([`ledger_identity::msp::Msps`]); host names are not checked, because robots move between addresses. The name that a
//! client sends says its network ([`server_name`]). A server must
//! show a certificate of role node: a user's certificate never passes as a node's. A client may come without a
//! certificate; it can then only enrol, which the gateway decides.
//!
//! Sessions are never resumed: resumption would skip the check of the certificate, and so outlive a revocation.
//!
//! ```text
//! server_config(node, trust)                    any client of the network, or one without a certificate
//! client_config(me, ServerTrust::Roots(msps))   any node of the network
//! client_config(me, ServerTrust::Learnt)       the same, as its nodes have told since
//! client_config(None, ServerTrust::Fingerprint) first contact: any node below the CA with this fingerprint
//! ```

mod client;
mod identity;
mod name;
mod refusal;
mod server;
mod trust;
mod verifier;

pub(crate) use client::unverified_config;
pub use client::{client_config, client_config_expecting};
pub use identity::{Own, TlsError, TlsIdentity};
pub use name::{named_network, server_name};
pub use refusal::{Refusal, refusal};
pub use server::server_config;
pub use trust::{ServerTrust, TrustSource, Trusted, client_identity};

use rustls::SupportedProtocolVersion;
use rustls::crypto::{CryptoProvider, ring};
use rustls::version::TLS13;
use std::sync::Arc;

/// The protocol that both sides speak inside: HTTP/2, for gRPC.
pub const ALPN: &[u8] = b"h2";

const VERSIONS: &[&SupportedProtocolVersion] = &[&TLS13];

/// The cryptography, passed explicitly wherever rustls wants it: nothing depends on a process-wide default.
fn provider() -> Arc<CryptoProvider> {
    Arc::new(ring::default_provider())
}
