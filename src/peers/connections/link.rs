//! One outgoing connection: made, used until it breaks, made again.

use super::Dialer;
use super::pace::{Cause, Paces};
use crate::ordering::directory::Member;
use crate::process::config::DialRules;
use bytes::Bytes;
use hyper_util::rt::TokioIo;
use ledger::msp::never_dialled;
use ledger_api::tls::{ServerTrust, TlsError, client_config, client_config_expecting, server_name};
use ledger_api::v1::PeerFrame;
use ledger_api::v1::peer_client::PeerClient;
use ledger_base::hash::Hash;
use ledger_raft::PEER_MESSAGE_BYTES_MAX;
use std::error::Error;
use std::io;
use std::net::SocketAddr;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::task::{Context, Poll};
use std::time::{Duration, Instant};
use tokio::net::TcpStream;
use tokio::sync::{Notify, mpsc, oneshot};
use tokio_rustls::TlsConnector;
use tokio_rustls::rustls::ClientConfig;
use tokio_stream::Stream;
use tonic::transport::{Channel, Endpoint, Uri};

/// Time for a connection to be made.
const CONNECT_TIME_MAX: Duration = Duration::from_secs(3);
/// A connection that lasts so long was of use.
const USE_MIN: Duration = Duration::from_secs(1);
/// Most addresses of one name that are tried.
const LOOKED_UP_MAX: usize = 8;

/// The way to a peer.
pub(super) struct Way {
    pub member: Member,
    pub dialer: Dialer,
    /// Set while messages can be sent.
    pub connected: Arc<AtomicBool>,
    /// The peer was approved to order.
    pub votes: Arc<AtomicBool>,
    /// Ends the pause before the next attempt.
    pub wake: Arc<Notify>,
}

impl Way {
    /// Keeps a connection until the sender of the messages is gone.
    pub(super) async fn keep_connected(self, mut messages: mpsc::Receiver<Bytes>) {
        let Self { member, dialer, connected, .. } = &self;
        let [paces, _] = &*dialer.paces;
        let place = (member.id, &*member.address);
        let mut last_reason = String::new();
        loop {
            let cause = self.rest(paces, &messages).await;
            if messages.is_closed() {
                return;
            }
            paces.dials(place, cause, Instant::now());
            let reason = match dialer.open(member).await {
                Ok(channel) => {
                    paces.answers(place);
                    // An outage and its end at the same level; without one this is of no interest.
                    match last_reason.is_empty() {
                        true => tracing::debug!(node = %member.full_name(), address = %member.address, "connected"),
                        false => {
                            tracing::info!(node = %member.full_name(), address = %member.address, "reconnected")
                        }
                    }
                    while messages.try_recv().is_ok() {}
                    let since = Instant::now();
                    connected.store(true, Ordering::Relaxed);
                    let reason;
                    (messages, reason) = stream(channel, messages).await;
                    connected.store(false, Ordering::Relaxed);
                    // One that was refused at once is no reason to try sooner.
                    if since.elapsed() > USE_MIN {
                        paces.lasts(place);
                        last_reason = String::new();
                    }
                    reason
                }
                Err(reason) => reason,
            };
            if messages.is_closed() {
                return;
            }
            // The same reason once, not twice a second.
            if reason != last_reason {
                tracing::info!(node = %member.full_name(), address = %member.address, reason, "not connected; retrying");
                last_reason = reason;
            }
        }
    }

    /// Waits until the peer may be dialled, or nobody sends any more.
    async fn rest(&self, paces: &Paces, messages: &mpsc::Receiver<Bytes>) -> Cause {
        let place = (self.member.id, &*self.member.address);
        let mut cause = Cause::Time;
        while !messages.is_closed() {
            let left = paces.left(place, self.votes.load(Ordering::Relaxed), cause, Instant::now());
            if left.is_zero() {
                return cause;
            }
            if tokio::time::timeout(left, self.wake.notified()).await.is_ok() {
                cause = Cause::Call;
            }
        }
        cause
    }
}

impl Dialer {
    /// A connection to a peer, whose certificate must be of that node, for a question. Not sooner than its pace allows.
    pub(crate) async fn channel(&self, member: &Member) -> Result<Channel, String> {
        let [_, paces] = &*self.paces;
        let (place, now) = ((member.id, &*member.address), Instant::now());
        let left = paces.left(place, member.votes(), Cause::Time, now);
        if !left.is_zero() {
            return Err(format!("no answer a moment ago; next attempt in {:.1} s", left.as_secs_f64()));
        }
        paces.dials(place, Cause::Time, now);
        let channel = self.open(member).await?;
        paces.answers(place);
        paces.lasts(place);
        Ok(channel)
    }

    /// A connection to whichever node of the network has this address.
    pub(crate) async fn at(&self, address: &str) -> Result<Channel, String> {
        let trust = ServerTrust::Network(Arc::clone(&self.trust));
        open((address, self.network), None, client_config(Some(self.identity.clone()), trust)).await
    }

    async fn open(&self, member: &Member) -> Result<Channel, String> {
        let trust = ServerTrust::Network(Arc::clone(&self.trust));
        let config = client_config_expecting(Some(self.identity.clone()), trust, &member.full_name());
        // An organisation knows where its own nodes are.
        let rules = (member.organisation != self.organisation).then(|| Arc::clone(&self.rules));
        open((&member.address, self.network), rules, config).await
    }

    /// A connection to some node whose certificate comes from a CA with this fingerprint: for a node whose ledger does
    /// not know the others yet.
    pub(crate) async fn first_contact(&self, address: &str, ca: Hash) -> Result<Channel, String> {
        let config = client_config(Some(self.identity.clone()), ServerTrust::Fingerprint(ca.0));
        open((address, self.network), None, config).await
    }
}

/// Connects with an address that nodes dial, whatever a name leads to.
async fn connect(address: &str, rules: Option<&DialRules>) -> io::Result<TcpStream> {
    let found = tokio::net::lookup_host(address).await?;
    TcpStream::connect(&*dialled(address, rules, found)?).await
}

/// Those of the addresses behind a name that nodes dial. The rules are those for other organisations.
fn dialled(
    address: &str,
    rules: Option<&DialRules>,
    found: impl Iterator<Item = SocketAddr>,
) -> io::Result<Vec<SocketAddr>> {
    let mut refused = None;
    let allowed = found.take(LOOKED_UP_MAX).filter(|found| {
        let (never, here) = (never_dialled(found.ip()), rules.and_then(|rules| rules.refusal(*found)));
        refused = match (never, here) {
            (Some(kind), _) => {
                Some(format!("{address} resolves to {}, {kind}, to which nodes do not connect", found.ip()))
            }
            (None, Some(kind)) => Some(format!(
                "{address} resolves to {found}, {kind}, which [peers] allow in ledgerd.toml does not \
                              include"
            )),
            (None, None) => return true,
        };
        false
    });
    let allowed: Vec<_> = allowed.collect();
    match (allowed.is_empty(), refused) {
        (true, Some(refused)) => Err(io::Error::new(io::ErrorKind::PermissionDenied, refused)),
        _ => Ok(allowed),
    }
}

async fn open(
    (address, network): (&str, Hash),
    rules: Option<Arc<DialRules>>,
    config: Result<ClientConfig, TlsError>,
) -> Result<Channel, String> {
    let tls = TlsConnector::from(Arc::new(config.map_err(|error| error.to_string())?));
    let address = address.to_owned();
    let connect = tower::service_fn(move |_: Uri| {
        let (tls, address, rules) = (tls.clone(), address.clone(), rules.clone());
        async move {
            let socket = connect(&address, rules.as_deref()).await?;
            socket.set_nodelay(true)?;
            let name = server_name(Some(&network)).map_err(io::Error::other)?;
            Ok::<_, io::Error>(TokioIo::new(tls.connect(name, socket).await?))
        }
    });
    Endpoint::from_static("http://node.ledgerd.invalid")
        .connect_timeout(CONNECT_TIME_MAX)
        .http2_keep_alive_interval(Duration::from_secs(2))
        .keep_alive_timeout(Duration::from_secs(2))
        .keep_alive_while_idle(true)
        .connect_with_connector(connect)
        .await
        .map_err(|error| causes(&error))
}

/// Sends until the connection breaks; answers with what is left to send from, and why it broke.
async fn stream(channel: Channel, messages: mpsc::Receiver<Bytes>) -> (mpsc::Receiver<Bytes>, String) {
    let (back, returned) = oneshot::channel();
    let frames = Frames { messages: Some(messages), back: Some(back) };
    let mut client = PeerClient::new(channel).max_encoding_message_size(PEER_MESSAGE_BYTES_MAX + 64);
    let reason = match client.messages(frames).await {
        Ok(_) => "the peer closed the stream".to_owned(),
        Err(status) if status.message().is_empty() => status.code().to_string(),
        Err(status) => status.message().to_owned(),
    };
    // With the connection goes what still sends on it.
    drop(client);
    (returned.await.unwrap_or_else(|_| mpsc::channel(1).1), reason)
}

/// The messages as a connection takes them, without a task in between. When the connection drops it, the rest goes back.
struct Frames {
    messages: Option<mpsc::Receiver<Bytes>>,
    back: Option<oneshot::Sender<mpsc::Receiver<Bytes>>>,
}

impl Stream for Frames {
    type Item = PeerFrame;

    fn poll_next(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<PeerFrame>> {
        match &mut self.messages {
            Some(messages) => messages.poll_recv(context).map(|message| message.map(|message| PeerFrame { message })),
            None => Poll::Ready(None),
        }
    }
}

impl Drop for Frames {
    fn drop(&mut self) {
        if let (Some(messages), Some(back)) = (self.messages.take(), self.back.take()) {
            let _ended = back.send(messages);
        }
    }
}

/// An error with its causes in one line.
fn causes(error: &dyn Error) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        text = format!("{text}: {error}");
        cause = error.source();
    }
    text
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn a_name_that_leads_to_forbidden_addresses_is_dialled_only_at_the_others() {
        let found = |addresses: &[&str]| {
            let addresses: Vec<SocketAddr> = addresses.iter().map(|address| address.parse().unwrap()).collect();
            dialled("deceiving.example:7450", None, addresses.into_iter())
        };
        assert_eq!(found(&["10.0.0.4:7450", "169.254.169.254:7450"]).unwrap(), ["10.0.0.4:7450".parse().unwrap()]);
        let refused = found(&["169.254.169.254:7450", "[fe80::1]:7450"]).unwrap_err().to_string();
        assert!(refused.contains("deceiving.example:7450") && refused.contains("link-local"), "{refused}");
        assert!(found(&[]).unwrap().is_empty());
    }

    #[test]
    fn a_name_of_another_organisation_leads_to_no_service_of_this_machine() {
        let rules = DialRules::new("10.0.0.4:7450", &[]);
        let found = |rules, address: &str| {
            dialled("deceiving.example:7450", rules, [address.parse().unwrap()].into_iter())
                .map_err(|error| error.to_string())
        };
        for (address, kind) in [("127.0.0.1:7451", "of this machine itself"), ("10.0.0.5:22", "a privileged port")] {
            let refused = found(Some(&rules), address).unwrap_err();
            assert!(refused.contains(address) && refused.contains(kind), "{refused}");
            assert_eq!(found(None, address).unwrap().len(), 1, "nodes of its own organisation are dialled there");
        }
        assert_eq!(found(Some(&rules), "10.0.0.5:7450").unwrap().len(), 1);
    }
}
