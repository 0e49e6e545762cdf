//! The service that other nodes call.

use super::connections::Connections;
use crate::ordering::directory::Member;
use crate::peers::sync::{Reader, Source};
use crate::process::caller::Caller;
use crate::process::memory;
use ledger_api::v1::peer_server::Peer;
use ledger_api::v1::{self, PeerClosed, PeerFrame};
use ledger_identity::Role;
use ledger_raft::PeerMessage;
use std::sync::Arc;
use tokio::sync::watch;
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Request, Response, Status, Streaming};

/// Takes a message of another node; false when this one is stopping.
pub(crate) type Deliver = Box<dyn Fn(u64, PeerMessage) -> bool + Send + Sync>;

/// The service that takes the messages of other nodes. `deliver` answers false when the node is stopping.
pub(crate) struct PeerService {
    connections: Arc<Connections>,
    source: Arc<Source>,
    members: watch::Receiver<Arc<[Member]>>,
    deliver: Deliver,
}

impl PeerService {
    /// Takes calls from these members only, as they change.
    pub(crate) fn new(
        connections: Arc<Connections>,
        source: Arc<Source>,
        members: watch::Receiver<Arc<[Member]>>,
        deliver: Deliver,
    ) -> Self {
        Self { connections, source, members, deliver }
    }

    /// The calling node, which must be a member now.
    fn sender<T>(&self, request: &Request<T>) -> Result<Member, Status> {
        self.reader(request)?.ok_or_else(|| {
            let caller = request.extensions().get::<Caller>().and_then(|caller| caller.identity.as_ref());
            Status::permission_denied(format!(
                "found {}, wanted a node that is a member of this network; a removed node joins again as a new one",
                caller.map(|identity| identity.id()).unwrap_or_default()
            ))
        })
    }

    /// The calling node, also one that is no member: so one that was removed while it was away gets the blocks that say so.
    /// Everybody with a certificate may read them at the gateway, too.
    fn reader<T>(&self, request: &Request<T>) -> Result<Reader, Status> {
        let caller = request.extensions().get::<Caller>();
        let identity = caller
            .and_then(|caller| caller.identity.as_ref())
            .ok_or_else(|| Status::unauthenticated("found no certificate, wanted one of a node of this network"))?;
        if identity.role != Role::Node {
            return Err(Status::permission_denied(format!(
                "found {} with role {}, wanted a node of this network",
                identity.id(),
                identity.role
            )));
        }
        let members = self.members.borrow();
        let own = |member: &&Member| member.organisation == identity.organisation && member.name == identity.name;
        Ok(members.iter().find(own).cloned())
    }
}

/// Waits until this node is no member any more.
async fn removed(members: &mut watch::Receiver<Arc<[Member]>>, id: u64) {
    let gone = members.wait_for(|members| !members.iter().any(|member| member.id == id)).await.is_ok();
    if !gone {
        // The node itself ends; its streams end with its server.
        std::future::pending::<()>().await;
    }
}

#[tonic::async_trait]
impl Peer for PeerService {
    async fn messages(&self, request: Request<Streaming<PeerFrame>>) -> Result<Response<PeerClosed>, Status> {
        let member = self.sender(&request)?;
        self.connections.heard_of(member.id);
        let mut frames = request.into_inner();
        let mut members = self.members.clone();
        let removed = removed(&mut members, member.id);
        tokio::pin!(removed);
        loop {
            let frame = tokio::select! {
                biased;
                () = &mut removed => {
                    tracing::info!(node = %member.full_name(), "peer is no longer a member; closing its stream");
                    return Err(Status::permission_denied("this node was removed from the network"));
                }
                frame = frames.message() => frame?,
            };
            let Some(PeerFrame { message }) = frame else { return Ok(Response::new(PeerClosed {})) };
            memory::has_carried(message.len());
            let message = PeerMessage::decode(message).map_err(|error| {
                tracing::warn!(node = %member.full_name(), %error, "peer sent an invalid message; closing the stream");
                Status::invalid_argument(error.to_string())
            })?;
            if !(self.deliver)(member.id, message) {
                return Err(Status::unavailable("the node is stopping"));
            }
        }
    }

    async fn chain(&self, request: Request<v1::ChainRequest>) -> Result<Response<v1::ChainResponse>, Status> {
        let reader = self.reader(&request)?;
        Ok(Response::new(self.source.chain(reader.as_ref(), request.get_ref())))
    }

    type BlocksStream = ReceiverStream<Result<v1::BlockEntries, Status>>;

    async fn blocks(&self, request: Request<v1::BlocksRequest>) -> Result<Response<Self::BlocksStream>, Status> {
        let reader = self.reader(&request)?;
        self.source.blocks(request.into_inner().from_height, &reader).map(Response::new)
    }

    async fn snapshot(&self, request: Request<v1::SnapshotRequest>) -> Result<Response<v1::SnapshotResponse>, Status> {
        self.reader(&request)?;
        let source = Arc::clone(&self.source);
        let answer = tokio::task::spawn_blocking(move || source.snapshot()).await;
        answer.map_err(|_| Status::internal("a thread panicked"))?.map(Response::new)
    }

    type SnapshotChunksStream = ReceiverStream<Result<v1::SnapshotChunk, Status>>;

    async fn snapshot_chunks(
        &self,
        request: Request<v1::SnapshotChunksRequest>,
    ) -> Result<Response<Self::SnapshotChunksStream>, Status> {
        let reader = self.reader(&request)?;
        let v1::SnapshotChunksRequest { height, from_chunk } = request.into_inner();
        self.source.chunks((height, from_chunk), &reader).map(Response::new)
    }

    async fn digest(&self, request: Request<v1::DigestRequest>) -> Result<Response<v1::DigestResponse>, Status> {
        self.reader(&request)?;
        self.source.digest(request.into_inner().height).map(Response::new)
    }

    async fn certified(
        &self,
        request: Request<v1::CertifiedRequest>,
    ) -> Result<Response<v1::CertifiedResponse>, Status> {
        self.reader(&request)?;
        self.source.certified(request.into_inner().height).await.map(Response::new)
    }

    async fn writes(&self, request: Request<v1::WritesRequest>) -> Result<Response<v1::WritesResponse>, Status> {
        self.sender(&request)?;
        Ok(Response::new(self.source.writes(request.into_inner().height)))
    }
}
