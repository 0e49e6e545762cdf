//! The gateway: the gRPC API of the node for clients and bridges (crates/api/proto/ledgerd/v1/gateway.proto).

mod audience;
mod current;
mod looks;
mod reads;
mod submit;
mod subscribe;
mod transfer;

use crate::awake::Awake;
use crate::blocks::Blocks;
use crate::clock::Clock;
use crate::config::Limits;
use crate::denials::Denials;
use crate::host::Caller;
use crate::orderer::{Executed, Seat};
use crate::peers::{Directory, Member, Peers};
use crate::slice::Turns;
use crate::space::Space;
use crate::waiters::Waiters;
use crate::witness::Witness;
pub(crate) use audience::Audience;
pub(crate) use current::Current;
use ledger::Ledger;
use ledger_api::tls::TlsIdentity;
pub(crate) use ledger_api::to_status as status;
use ledger_api::v1::gateway_server::Gateway;
use ledger_api::v1::{
    Block, Delivery, DenialsRequest, DenialsResponse, GetBlockRequest, GetTransactionRequest, QueryRequest,
    QueryResponse, StatusRequest, StatusResponse, SubmitRequest, SubmitResponse, SubscribeRequest, TransactionRecord,
    TransferLeadershipRequest, TransferLeadershipResponse,
};
use ledger_identity::Identity;
use ledger_rejection::Code;
use ledger_replica::Retries;
use ledger_replica::gateway::Shares;
pub(crate) use looks::Looks;
use std::pin::Pin;
use std::sync::Arc;
use std::time::Instant;
use submit::Verdicts;
use tokio::sync::mpsc;
use tokio_stream::Stream;
use tonic::{Request, Response, Status, Streaming};

/// The gateway of a node; cheap to clone.
#[derive(Clone)]
pub(crate) struct GatewayService {
    pub(crate) node: Arc<NodeView>,
}

/// The gateway's view of its node.
pub(crate) struct NodeView {
    /// This node, as it was known when it started.
    pub me: Member,
    /// Name of the network for people.
    pub label: String,
    /// The ledger.
    pub ledger: Arc<Ledger>,
    /// Executed blocks.
    pub blocks: Arc<Blocks>,
    /// Clients that wait.
    pub waiters: Arc<Waiters>,
    /// Calls that were refused.
    pub denials: Arc<Denials>,
    /// Where ordering is, when it is.
    pub seat: Arc<Seat>,
    /// Makes the state as new as what was committed when somebody asked.
    pub current: Current,
    /// Blocks that were executed.
    pub executed: Arc<Executed>,
    /// The members of the network.
    pub directory: Arc<Directory>,
    /// The ways to the other nodes.
    pub peers: Arc<Peers>,
    /// Limits of the configuration.
    pub limits: Limits,
    /// The calls that each identity has in flight.
    pub shares: Shares,
    /// The turns to look at transactions.
    pub looks: Arc<Looks>,
    /// Repetitions that are ordered although the state refuses them.
    pub retries: Retries,
    /// Longest time that data waits until it is looked at, microseconds.
    pub wait_max: u64,
    /// The identities that have subscriptions.
    pub audience: Arc<Audience>,
    /// The room that the disk still has.
    pub space: Arc<Space>,
    /// This node's certificate, for when it ends.
    pub identity: TlsIdentity,
    /// Compares what others attest.
    pub witness: Arc<Witness>,
    /// Keeps the processors awake.
    pub awake: Arc<Awake>,
    /// How long the turns of its threads are.
    pub turns: Turns,
    /// The node's clock.
    pub clock: Clock,
    /// When the node started.
    pub started: Instant,
}

impl GatewayService {
    /// The caller's identity, which must not have been revoked since it connected.
    fn caller<T>(&self, request: &Request<T>) -> Result<Arc<Identity>, Status> {
        let identity =
            request.extensions().get::<Caller>().and_then(|caller| caller.identity.clone()).ok_or_else(|| {
                status(
                    &ledger_rejection::Rejection::new(
                        Code::CertificateRequired,
                        "this call needs a client certificate",
                    )
                    .next("enrol first: ledgerctl enroll"),
                )
            })?;
        self.node.check(&identity)?;
        Ok(identity)
    }
}

impl NodeView {
    /// Refuses an identity that was revoked or whose certificate has run out since it connected.
    pub(crate) fn check(&self, identity: &Identity) -> Result<(), Status> {
        identity.check_validity(self.clock.wall()).map_err(|error| status(&error.into()))?;
        self.ledger.check_revoked(identity).map_err(|rejection| status(&rejection))
    }
}

#[tonic::async_trait]
impl Gateway for GatewayService {
    async fn submit(&self, request: Request<SubmitRequest>) -> Result<Response<SubmitResponse>, Status> {
        let share = self.node.shares.of(self.caller(&request)?.id());
        let (answers, mut answer) = mpsc::unbounded_channel();
        self.node.submit_one(request.into_inner(), &share, &answers).await;
        drop(answers);
        let stopping = || status(&ledger_rejection::Rejection::new(Code::ShuttingDown, "the node is stopping"));
        answer.recv().await.ok_or_else(stopping)?.map(Response::new)
    }

    type SubmitStreamStream = Verdicts;

    async fn submit_stream(
        &self,
        request: Request<Streaming<SubmitRequest>>,
    ) -> Result<Response<Self::SubmitStreamStream>, Status> {
        let share = self.node.shares.of(self.caller(&request)?.id());
        Ok(Response::new(submit::stream(self.clone(), share, request.into_inner())))
    }

    async fn query(&self, request: Request<QueryRequest>) -> Result<Response<QueryResponse>, Status> {
        let caller = self.caller(&request)?;
        self.node.query(&caller, request.into_inner()).await.map(Response::new)
    }

    type SubscribeStream = Pin<Box<dyn Stream<Item = Result<Delivery, Status>> + Send>>;

    async fn subscribe(&self, request: Request<SubscribeRequest>) -> Result<Response<Self::SubscribeStream>, Status> {
        let caller = self.caller(&request)?;
        let deliveries = subscribe::start(Arc::clone(&self.node), caller, request.into_inner()).await?;
        Ok(Response::new(Box::pin(deliveries)))
    }

    async fn status(&self, request: Request<StatusRequest>) -> Result<Response<StatusResponse>, Status> {
        self.caller(&request)?;
        self.node.status().map(Response::new).map_err(|rejection| status(&rejection))
    }

    async fn get_block(&self, request: Request<GetBlockRequest>) -> Result<Response<Block>, Status> {
        let caller = self.caller(&request)?;
        let height = request.into_inner().height;
        if height > self.node.ledger.tip().height {
            self.node.current.reach().await.map_err(|rejection| status(&rejection))?;
        }
        self.node.block(&caller, height).map(Response::new).map_err(|rejection| status(&rejection))
    }

    async fn get_transaction(
        &self,
        request: Request<GetTransactionRequest>,
    ) -> Result<Response<TransactionRecord>, Status> {
        let caller = self.caller(&request)?;
        let id = request.into_inner().id;
        let found = match self.node.transaction(&caller, &id) {
            Err(rejection) if rejection.code == Code::NotFound => {
                self.node.current.reach().await.map_err(|rejection| status(&rejection))?;
                self.node.transaction(&caller, &id)
            }
            found => found,
        };
        found.map(Response::new).map_err(|rejection| status(&rejection))
    }

    async fn denials(&self, request: Request<DenialsRequest>) -> Result<Response<DenialsResponse>, Status> {
        let caller = self.caller(&request)?;
        self.node.denied(&caller, request.into_inner().limit).map(Response::new).map_err(|rejection| status(&rejection))
    }

    async fn transfer_leadership(
        &self,
        request: Request<TransferLeadershipRequest>,
    ) -> Result<Response<TransferLeadershipResponse>, Status> {
        let caller = self.caller(&request)?;
        Ok(Response::new(self.node.transfer_leadership(&caller, request.into_inner().node_id).await))
    }
}
