//! One outgoing connection: made, used until it breaks, made again.

use super::{Dialer, Member};
use bytes::Bytes;
use hyper_util::rt::TokioIo;
use ledger_api::tls::{ServerTrust, TlsError, client_config, client_config_expecting, server_name};
use ledger_api::v1::PeerFrame;
use ledger_api::v1::peer_client::PeerClient;
use ledger_hash::Hash;
use ledger_raft::PEER_MESSAGE_BYTES_MAX;
use std::error::Error;
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
/// Pause before a broken connection is made again: doubles from the first to the last.
const RECONNECT_PAUSE: (Duration, Duration) = (Duration::from_millis(50), Duration::from_secs(1));

/// The way to a peer.
pub(super) struct Way {
    pub member: Member,
    pub dialer: Dialer,
    /// Set while messages can be sent.
    pub connected: Arc<AtomicBool>,
    /// Ends the pause before the next attempt.
    pub wake: Arc<Notify>,
}

impl Way {
    /// Keeps a connection until the sender of the messages is gone.
    pub(super) async fn keep_connected(self, mut messages: mpsc::Receiver<Bytes>) {
        let Self { member, dialer, connected, wake } = self;
        let mut pause = RECONNECT_PAUSE.0;
        let mut last_reason = String::new();
        while !messages.is_closed() {
            let reason = match dialer.channel(&member).await {
                Ok(channel) => {
                    // An outage and its end at the same level; without one this is of no interest.
                    match last_reason.is_empty() {
                        true => tracing::debug!(peer = %member.full_name(), address = %member.address, "connected"),
                        false => {
                            tracing::info!(peer = %member.full_name(), address = %member.address, "connected again")
                        }
                    }
                    while messages.try_recv().is_ok() {}
                    let since = Instant::now();
                    connected.store(true, Ordering::Relaxed);
                    let reason;
                    (messages, reason) = stream(channel, messages).await;
                    connected.store(false, Ordering::Relaxed);
                    // One that was refused at once is no reason to try sooner.
                    if since.elapsed() > RECONNECT_PAUSE.1 {
                        (pause, last_reason) = (RECONNECT_PAUSE.0, String::new());
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
                tracing::info!(peer = %member.full_name(), address = %member.address, %reason, "not connected; trying again");
                last_reason = reason;
            }
            if tokio::time::timeout(pause, wake.notified()).await.is_ok() {
                pause = RECONNECT_PAUSE.0;
            }
            pause = (pause * 2).min(RECONNECT_PAUSE.1);
        }
    }
}

impl Dialer {
    /// A connection to a peer, whose certificate must be of that node.
    pub(crate) async fn channel(&self, member: &Member) -> Result<Channel, String> {
        let trust = ServerTrust::Network(Arc::clone(&self.trust));
        let config = client_config_expecting(Some(self.identity.clone()), trust, &member.full_name());
        open((&member.address, self.network), config).await
    }

    /// A connection to some node whose certificate comes from a CA with this fingerprint: for a node whose ledger does
    /// not know the others yet.
    pub(crate) async fn first_contact(&self, address: &str, ca: Hash) -> Result<Channel, String> {
        let config = client_config(Some(self.identity.clone()), ServerTrust::Fingerprint(ca.0));
        open((address, self.network), config).await
    }
}

async fn open((address, network): (&str, Hash), config: Result<ClientConfig, TlsError>) -> Result<Channel, String> {
    let tls = TlsConnector::from(Arc::new(config.map_err(|error| error.to_string())?));
    let address = address.to_owned();
    let connect = tower::service_fn(move |_: Uri| {
        let (tls, address) = (tls.clone(), address.clone());
        async move {
            let socket = TcpStream::connect(&address).await?;
            socket.set_nodelay(true)?;
            let name = server_name(Some(&network)).map_err(std::io::Error::other)?;
            Ok::<_, std::io::Error>(TokioIo::new(tls.connect(name, socket).await?))
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
