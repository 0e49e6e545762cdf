//! Connections to a node: TCP, mutual TLS, HTTP/2, and clear words when one of them fails.

mod diagnosis;
mod stream;

pub use diagnosis::found_network;
pub(crate) use diagnosis::{Expected, explain, explain_clock, other_network, way_back};

use crate::tls::{ServerTrust, TlsError, TlsIdentity, client_config, refusal, server_name};
use bytes::Bytes;
use hyper_util::rt::TokioIo;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::IdentityError;
use ledger_identity::certificate::Certificate;
use rustls::{AlertDescription, ClientConfig};
use std::error::Error as StdError;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, SystemTime, UNIX_EPOCH};
use stream::{Fault, Watched};
use tokio::net::TcpStream;
use tokio::time::timeout;
use tokio_rustls::TlsConnector;
use tonic::transport::{Channel, Endpoint};
use tonic::{Status, codegen::http::Uri};

/// How often a silent connection is probed, and how long the answer may take. Together they bound how long a node that
/// was stopped keeps a client waiting.
const KEEP_ALIVE_EVERY: Duration = Duration::from_secs(1);
const KEEP_ALIVE_ANSWER_MAX: Duration = Duration::from_millis(1500);
/// How much a node may send ahead on one stream and on a connection, in bytes.
const STREAM_WINDOW_BYTES: u32 = 1024 * 1024;
const CONNECTION_WINDOW_BYTES: u32 = 4 * 1024 * 1024;

/// The needs of connections as an identity: the identity, the network, and the accepted nodes. Clones share the
/// identity, and so see it renewed.
#[derive(Clone)]
pub struct Credentials {
    /// Name of the network.
    pub network: Hash,
    /// Signs transactions, and shows itself to nodes.
    pub identity: TlsIdentity,
    /// The settings of every connection.
    pub(crate) tls: Arc<ClientConfig>,
    /// The organisation of the identity, if it is known.
    pub(crate) organisation: Option<String>,
}

impl Credentials {
    /// Takes identity and trust together.
    ///
    /// # Errors
    /// [`Code::BadFile`] if certificate and key cannot be used.
    pub fn new(network: Hash, identity: TlsIdentity, trust: ServerTrust) -> Result<Self, Rejection> {
        let tls = client_config(Some(identity.clone()), trust).map_err(|error| unusable(&error))?;
        Ok(Self { network, identity, tls: Arc::new(tls), organisation: None })
    }

    /// The same, of an identity of this organisation: its CA is found by that name.
    pub(crate) fn of(self, organisation: &str) -> Self {
        Self { organisation: Some(organisation.to_owned()), ..self }
    }
}

pub(crate) fn unusable(error: &TlsError) -> Rejection {
    Rejection::new(Code::BadFile, error.to_string()).next("enrol again for a new certificate")
}

/// An open connection to one node.
#[derive(Clone, Debug)]
pub(crate) struct Connection {
    /// Carries any number of calls at once.
    pub(crate) channel: Channel,
    /// `HOST:PORT` of the node.
    pub(crate) address: Arc<str>,
    /// Our own certificate in DER, to explain why it is refused; empty if we show none.
    certificate: Bytes,
    /// Why the connection broke, if it did.
    fault: Arc<Mutex<Option<Fault>>>,
}

impl Connection {
    /// Connects to a node of this network within `patience`; a first contact names none. `certificate` is the one that
    /// `tls` shows, or empty.
    ///
    /// # Errors
    /// [`Code::Unreachable`] with address and reason; the code of the fault if the node's certificate is not accepted;
    /// [`Code::BadArgument`] if the address is none; [`Code::WrongNetwork`] if several networks are served there, and
    /// this one is not.
    pub(crate) async fn open(
        (address, network): (&str, Option<&Hash>),
        tls: Arc<ClientConfig>,
        certificate: &Bytes,
        patience: Duration,
    ) -> Result<Self, Rejection> {
        let origin = origin(address)?;
        match timeout(patience, Self::establish((address, network), origin, tls, certificate)).await {
            Ok(done) => done,
            Err(_) => Err(unreachable(address, &format!("no answer within {} ms", patience.as_millis()))),
        }
    }

    async fn establish(
        (address, network): (&str, Option<&Hash>),
        origin: Uri,
        tls: Arc<ClientConfig>,
        certificate: &Bytes,
    ) -> Result<Self, Rejection> {
        let tcp = TcpStream::connect(address).await.map_err(|error| unreachable(address, &error.to_string()))?;
        tcp.set_nodelay(true).map_err(|error| unreachable(address, &error.to_string()))?;
        let name = server_name(network)
            .map_err(|error| Rejection::new(Code::Internal, format!("the TLS server name is not usable: {error}")))?;
        let secured = TlsConnector::from(tls)
            .connect(name, tcp)
            .await
            .map_err(|error| handshake((address, network), certificate, &error))?;
        let fault = Arc::new(Mutex::new(None));
        let watched = Watched::new(secured, Arc::clone(&fault));
        // The one stream there is: when it breaks, whoever owns the connection opens another, perhaps elsewhere.
        let mut once = Some(TokioIo::new(watched));
        let connector = tower::service_fn(move |_: Uri| {
            let stream = once.take().ok_or_else(|| std::io::Error::other("the connection is closed"));
            std::future::ready(stream)
        });
        let channel = Endpoint::from(origin)
            .initial_stream_window_size(STREAM_WINDOW_BYTES)
            .initial_connection_window_size(CONNECTION_WINDOW_BYTES)
            .http2_keep_alive_interval(KEEP_ALIVE_EVERY)
            .keep_alive_timeout(KEEP_ALIVE_ANSWER_MAX)
            .keep_alive_while_idle(true)
            .connect_with_connector(connector)
            .await
            .map_err(|error| unreachable(address, &chain(&error)))?;
        Ok(Self { channel, address: address.into(), certificate: certificate.clone(), fault })
    }

    /// The refusal behind a failed call. A node that refuses our certificate only closes the connection with an
    /// alert, after the handshake is over for us: hence the look at how the connection broke.
    pub(crate) fn refusal(&self, status: &Status) -> Rejection {
        let fault = self.fault.lock().unwrap_or_else(PoisonError::into_inner).clone();
        match fault {
            Some(Fault::Alert(alert)) => alerted(&self.address, &self.certificate, alert),
            Some(Fault::Broken(reason)) if status.source().is_some() => unreachable(&self.address, &reason),
            _ => crate::report::from_status(&self.address, status),
        }
    }
}

/// No node at this address, and why.
pub(crate) fn unreachable(address: &str, reason: &str) -> Rejection {
    Rejection::new(Code::Unreachable, format!("cannot reach a node at {address}"))
        .found(reason)
        .wanted("a running node that accepts connections")
        .next(format!(
            "check that ledgerd is running there and that no firewall blocks the port: nc -vz {}",
            address.replace(':', " ")
        ))
}

pub(crate) fn origin(address: &str) -> Result<Uri, Rejection> {
    let wrong = || {
        Rejection::new(Code::BadArgument, "an address of a node cannot be read")
            .found(format!("{address:?}"))
            .wanted("HOST:PORT, such as 192.168.1.20:7450 or [::1]:7450")
            .next("add the port that `ledgerd` printed when it started")
    };
    let (host, port) = address.rsplit_once(':').ok_or_else(wrong)?;
    if host.is_empty() || !port.parse::<u16>().is_ok_and(|port| port > 0) {
        return Err(wrong());
    }
    format!("http://{address}").parse().map_err(|_| wrong())
}

/// The TLS handshake failed.
fn handshake((address, network): (&str, Option<&Hash>), certificate: &[u8], error: &std::io::Error) -> Rejection {
    if let Some(refused) = refusal(error) {
        let mut rejection = Rejection::from(refused.clone());
        rejection.message = format!("the node at {address} is not trusted: {}", rejection.message);
        return rejection;
    }
    match Fault::of(error) {
        Fault::Alert(AlertDescription::UnrecognisedName) => not_served(address, network),
        Fault::Alert(alert) => alerted(address, certificate, alert),
        Fault::Broken(reason) => unreachable(address, &format!("no TLS 1.3 connection: {reason}")),
    }
}

/// A process at this address serves several networks, and cannot tell which one is meant, or does not serve it.
fn not_served(address: &str, network: Option<&Hash>) -> Rejection {
    let refused = |message: &str| Rejection::new(Code::WrongNetwork, format!("the process at {address} {message}"));
    match network {
        Some(network) => refused("does not serve this network")
            .found("a process that serves other networks")
            .wanted(format!("network {network}"))
            .next("check the address, or select the context of a network that it serves"),
        None => refused("serves several networks, and the call names none")
            .found("TLS alert UnrecognisedName")
            .wanted("the name of one of its networks")
            .next("use a join token, which names the network, or a node that serves one network"),
    }
}

/// The node ended the connection with an alert, which nearly always means our certificate. Alerts say little: nodes
/// send "unknown" for most faults. Our own look at the certificate says more.
fn alerted(address: &str, certificate: &[u8], alert: AlertDescription) -> Rejection {
    if let Some(outdated) = outdated(certificate) {
        let mut rejection = Rejection::from(outdated);
        rejection.message = format!("the node at {address} rejects the connection: {}", rejection.message);
        return rejection;
    }
    let (code, what, next) = match alert {
        AlertDescription::CertificateExpired => (
            Code::CertificateExpired,
            "has expired, or is not valid yet",
            "enrol again, and check the clocks of both machines",
        ),
        AlertDescription::UnknownCA => (
            Code::Untrusted,
            "belongs to no organisation of its network",
            "check that the context is of this node's network",
        ),
        AlertDescription::CertificateRevoked => (Code::Revoked, "was revoked", "ask an admin of your organisation"),
        AlertDescription::CertificateRequired => (Code::CertificateRequired, "is missing", ""),
        AlertDescription::BadCertificate
        | AlertDescription::CertificateUnknown
        | AlertDescription::UnsupportedCertificate
        | AlertDescription::AccessDenied => {
            (Code::Untrusted, "is not accepted", "check the node's log for the reason, then enrol again")
        }
        other => return unreachable(address, &format!("the other side ended the TLS connection with {other:?}")),
    };
    Rejection::new(code, format!("the node at {address} rejects the connection: our certificate {what}"))
        .found(format!("TLS alert {alert:?}"))
        .wanted("a valid certificate of an organisation of the network")
        .next(next)
}

/// Is our certificate past its validity, or not valid yet, by the clock of this machine?
fn outdated(certificate: &[u8]) -> Option<IdentityError> {
    let Certificate { subject, not_before, not_after, .. } = Certificate::parse(certificate).ok()?;
    let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    let at = u64::try_from(now.as_micros()).unwrap_or(u64::MAX);
    if at > not_after {
        return Some(IdentityError::Expired { subject, not_after, at });
    }
    (at < not_before).then_some(IdentityError::NotYetValid { subject, not_before, at })
}

/// An error with all that it was caused by.
fn chain(error: &dyn StdError) -> String {
    let mut text = error.to_string();
    let mut next = error.source();
    while let Some(source) = next {
        text.push_str(&format!(": {source}"));
        next = source.source();
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_needs_host_and_port() {
        for wrong in ["", "host", "host:", ":7450", "host:0", "host:70000", "ho st:1", "host:7450/x"] {
            assert!(origin(wrong).is_err(), "{wrong}");
        }
        for right in ["host:7450", "10.0.0.4:1", "[::1]:7450"] {
            assert!(origin(right).is_ok(), "{right}");
        }
    }
}
