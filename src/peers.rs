//! Connections between nodes: one outgoing stream to each other node, and the service that takes theirs.

use crate::listen::Caller;
use hyper_util::rt::TokioIo;
use ledger::Bytes;
use ledger::identity::Role;
use ledger_api::tls::{ServerTrust, TlsIdentity, TrustSource, client_config_expecting};
use ledger_api::v1::peer_client::PeerClient;
use ledger_api::v1::peer_server::Peer;
use ledger_api::v1::{self, PeerClosed, PeerFrame};
use ledger_raft::{PEER_MESSAGE_BYTES_MAX, PeerMessage};
use rustls_pki_types::ServerName;
use std::collections::BTreeMap;
use std::error::Error;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use tokio::net::TcpStream;
use tokio::sync::mpsc;
use tokio_rustls::TlsConnector;
use tokio_stream::wrappers::ReceiverStream;
use tonic::transport::{Channel, Endpoint, Uri};
use tonic::{Request, Response, Status, Streaming};

/// Messages that wait for a peer; beyond it they are dropped, and ordering repeats what matters.
const WAITING_MAX: usize = 1024;
/// Time for a connection to be made.
const CONNECT_TIME_MAX: Duration = Duration::from_secs(3);
/// Pause before a broken connection is made again: doubles from the first to the last.
const RECONNECT_PAUSE: (Duration, Duration) = (Duration::from_millis(50), Duration::from_secs(2));

/// A node of the network, as the others need to know it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Member {
    /// Its number in the ordering protocol.
    pub id: u64,
    /// Common name of its certificate.
    pub name: String,
    /// Its organisation.
    pub organisation: String,
    /// `HOST:PORT`.
    pub address: String,
    /// Is it a voter?
    pub voter: bool,
}

/// The other nodes and the way to them.
pub(crate) struct Peers {
    links: BTreeMap<u64, Link>,
}

struct Link {
    member: Member,
    waiting: mpsc::Sender<Bytes>,
    connected: Arc<AtomicBool>,
}

impl Peers {
    /// Keeps a connection to each member. Must be called inside a tokio runtime; ends with it.
    pub(crate) fn connect(members: Vec<Member>, identity: &TlsIdentity, trust: &Arc<dyn TrustSource>) -> Self {
        let links = members.into_iter().map(|member| {
            let (waiting, messages) = mpsc::channel(WAITING_MAX);
            let connected = Arc::new(AtomicBool::new(false));
            let task =
                keep_connected(member.clone(), identity.clone(), Arc::clone(trust), messages, Arc::clone(&connected));
            tokio::spawn(task);
            (member.id, Link { member, waiting, connected })
        });
        Self { links: links.collect() }
    }

    /// Sends a message if the peer keeps up; otherwise the message is dropped and the answer is false.
    pub(crate) fn send(&self, to: u64, message: &PeerMessage) -> bool {
        self.links.get(&to).is_some_and(|link| {
            link.connected.load(Ordering::Relaxed) && link.waiting.try_send(message.to_bytes()).is_ok()
        })
    }

    /// The peers, and whether there is a connection to each.
    pub(crate) fn members(&self) -> impl Iterator<Item = (&Member, bool)> {
        self.links.values().map(|link| (&link.member, link.connected.load(Ordering::Relaxed)))
    }
}

async fn keep_connected(
    member: Member,
    identity: TlsIdentity,
    trust: Arc<dyn TrustSource>,
    mut messages: mpsc::Receiver<Bytes>,
    connected: Arc<AtomicBool>,
) {
    let mut pause = RECONNECT_PAUSE.0;
    let mut last_reason = String::new();
    while !messages.is_closed() {
        match channel(&member, &identity, &trust).await {
            Ok(channel) => {
                tracing::info!(peer = %member.name, address = %member.address, "connected");
                (pause, last_reason) = (RECONNECT_PAUSE.0, String::new());
                while messages.try_recv().is_ok() {}
                connected.store(true, Ordering::Relaxed);
                messages = stream(channel, messages).await;
                connected.store(false, Ordering::Relaxed);
                tracing::info!(peer = %member.name, "connection ended");
            }
            Err(reason) => {
                // The same reason once, not twice a second.
                if reason != last_reason {
                    tracing::info!(peer = %member.name, address = %member.address, %reason, "cannot connect; trying on");
                    last_reason = reason;
                }
            }
        }
        tokio::time::sleep(pause).await;
        pause = (pause * 2).min(RECONNECT_PAUSE.1);
    }
}

async fn channel(member: &Member, identity: &TlsIdentity, trust: &Arc<dyn TrustSource>) -> Result<Channel, String> {
    let expected = format!("{}/{}", member.organisation, member.name);
    let trust = ServerTrust::Network(Arc::clone(trust));
    let config =
        client_config_expecting(Some(identity.clone()), trust, &expected).map_err(|error| error.to_string())?;
    let tls = TlsConnector::from(Arc::new(config));
    let address = member.address.clone();
    let connect = tower::service_fn(move |_: Uri| {
        let (tls, address) = (tls.clone(), address.clone());
        async move {
            let socket = TcpStream::connect(&address).await?;
            socket.set_nodelay(true)?;
            let name = ServerName::try_from("node.ledgerd.invalid").map_err(std::io::Error::other)?;
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

/// Sends until the connection breaks; answers with what is left to send from.
async fn stream(channel: Channel, messages: mpsc::Receiver<Bytes>) -> mpsc::Receiver<Bytes> {
    let (frames, outgoing) = mpsc::channel(1);
    let mut client = PeerClient::new(channel).max_encoding_message_size(PEER_MESSAGE_BYTES_MAX + 64);
    let call = client.messages(ReceiverStream::new(outgoing));
    tokio::pin!(call);
    let mut messages = messages;
    loop {
        tokio::select! {
            _ended = &mut call => return messages,
            message = messages.recv() => {
                let Some(message) = message else { return messages };
                tokio::select! {
                    _ended = &mut call => return messages,
                    sent = frames.send(PeerFrame { message }) => if sent.is_err() { return messages },
                }
            }
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

/// The service that takes the messages of other nodes. `deliver` answers false when the node is stopping.
pub(crate) struct PeerService<D> {
    members: Vec<Member>,
    deliver: D,
}

impl<D: Fn(u64, PeerMessage) -> bool> PeerService<D> {
    /// Takes messages from these members only.
    pub(crate) fn new(members: Vec<Member>, deliver: D) -> Self {
        Self { members, deliver }
    }

    fn sender(&self, caller: Option<&Caller>) -> Result<&Member, Status> {
        let identity = caller
            .and_then(|caller| caller.identity.as_ref())
            .ok_or_else(|| Status::unauthenticated("found no certificate, wanted one of a node of this network"))?;
        let member = self
            .members
            .iter()
            .find(|member| member.organisation == identity.organisation && member.name == identity.name);
        match member {
            Some(member) if identity.role == Role::Node => Ok(member),
            _ => Err(Status::permission_denied(format!(
                "found {} with role {}, wanted the certificate of a node of this network",
                identity.id(),
                identity.role
            ))),
        }
    }
}

#[tonic::async_trait]
impl<D: Fn(u64, PeerMessage) -> bool + Send + Sync + 'static> Peer for PeerService<D> {
    async fn messages(&self, request: Request<Streaming<PeerFrame>>) -> Result<Response<PeerClosed>, Status> {
        let member = self.sender(request.extensions().get::<Caller>())?;
        let mut frames = request.into_inner();
        while let Some(PeerFrame { message }) = frames.message().await? {
            let message = PeerMessage::decode(message).map_err(|error| {
                tracing::warn!(peer = %member.name, %error, "message is not usable; closing the stream");
                Status::invalid_argument(error.to_string())
            })?;
            if !(self.deliver)(member.id, message) {
                return Err(Status::unavailable("the node is stopping"));
            }
        }
        Ok(Response::new(PeerClosed {}))
    }

    async fn chain(&self, _: Request<v1::ChainRequest>) -> Result<Response<v1::ChainResponse>, Status> {
        Err(Status::unimplemented("chain"))
    }

    type BlocksStream = ReceiverStream<Result<v1::BlockEntries, Status>>;

    async fn blocks(&self, _: Request<v1::BlocksRequest>) -> Result<Response<Self::BlocksStream>, Status> {
        Err(Status::unimplemented("blocks"))
    }

    async fn snapshot(&self, _: Request<v1::SnapshotRequest>) -> Result<Response<v1::SnapshotResponse>, Status> {
        Err(Status::unimplemented("snapshot"))
    }

    type SnapshotChunksStream = ReceiverStream<Result<v1::SnapshotChunk, Status>>;

    async fn snapshot_chunks(
        &self,
        _: Request<v1::SnapshotChunksRequest>,
    ) -> Result<Response<Self::SnapshotChunksStream>, Status> {
        Err(Status::unimplemented("snapshot chunks"))
    }

    async fn digest(&self, _: Request<v1::DigestRequest>) -> Result<Response<v1::DigestResponse>, Status> {
        Err(Status::unimplemented("digest"))
    }

    async fn writes(&self, _: Request<v1::WritesRequest>) -> Result<Response<v1::WritesResponse>, Status> {
        Err(Status::unimplemented("writes"))
    }
}
