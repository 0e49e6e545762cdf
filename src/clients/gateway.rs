//! The gateway: the gRPC API of the node for clients and bridges (crates/api/proto/ledgerd/v1/gateway.proto).
//!
//! ```text
//! gateway        the API, and its callers
//!   submit       streams of submissions, which take turns
//!     intake     one submission: taken in, looked at, ordered or answered
//!     looks      turns to look at submissions
//!   records      questions about the state, blocks and transactions
//!     questions  turns to read for somebody who asks
//!   subscribe    events as they happen; audience: their listeners
//!   status       the description of the node; nodes: the descriptions of the others
//!   proofs       proofs of what was certified; evidence: of one transaction
//!   transfer     the leadership for another node
//!   denied       the list of refusals; audited: who did what
//! ```
//!
//! Each of them holds the few parts of the node that it needs; the instance puts them together.

mod audience;
mod audited;
mod denied;
mod evidence;
mod intake;
mod looks;
mod majority;
mod missing;
mod nodes;
mod proofs;
mod questions;
mod records;
mod status;
mod submit;
mod subscribe;
mod transfer;

use crate::ordering::Ordering;
use crate::process::caller::Caller;
use crate::process::clock::Clock;
pub(crate) use audience::Audience;
pub(crate) use audited::Answers;
pub(crate) use intake::Intake;
use ledger::Ledger;
pub(crate) use ledger_api::to_status as status;
use ledger_api::v1::gateway_server::Gateway;
use ledger_api::v1::{
    AuditRequest, AuditResponse, Block, Delivery, DenialsRequest, DenialsResponse, GetBlockRequest,
    GetTransactionRequest, GovernanceRequest, GovernanceStep, NodesRequest, NodesResponse, ProveRequest, ProveResponse,
    ProveTransactionRequest, ProveTransactionResponse, QueryRequest, QueryResponse, StatusRequest, StatusResponse,
    SubmitRequest, SubmitResponse, SubscribeRequest, TransactionRecord, TransferLeadershipRequest,
    TransferLeadershipResponse,
};
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::Identity;
pub(crate) use looks::Looks;
pub(crate) use nodes::Nodes;
pub(crate) use proofs::Proofs;
pub(crate) use questions::Questions;
pub(crate) use records::Records;
pub(crate) use status::Description;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
pub(crate) use submit::Submissions;
use submit::Verdicts;
pub(crate) use subscribe::Subscriptions;
use tokio::sync::mpsc;
use tokio_stream::Stream;
use tonic::{Request, Response, Status, Streaming};

/// The gateway of a node; cheap to clone.
#[derive(Clone)]
pub(crate) struct GatewayService {
    /// Submissions of clients.
    pub submissions: Arc<Submissions>,
    /// The state, blocks and transactions.
    pub records: Arc<Records>,
    /// Proofs of what was certified.
    pub proofs: Arc<Proofs>,
    /// Events as they happen.
    pub subscriptions: Arc<Subscriptions>,
    /// The description of the node.
    pub description: Arc<Description>,
    /// The other nodes.
    pub nodes: Arc<Nodes>,
    /// Tells who did what.
    pub audit: Arc<Answers>,
}

impl GatewayService {
    /// The ledger.
    pub(crate) fn ledger(&self) -> &Ledger {
        &self.description.ordering.storage.ledger
    }

    /// The node's clock.
    pub(crate) fn clock(&self) -> &Clock {
        &self.description.ordering.clock
    }

    /// The caller's identity, which must not have been revoked since it connected.
    fn caller<T>(&self, request: &Request<T>) -> Result<Arc<Identity>, Status> {
        let identity =
            request.extensions().get::<Caller>().and_then(|caller| caller.identity.clone()).ok_or_else(|| {
                status(&Rejection::new(Code::CertificateRequired, "this call requires a client certificate"))
            })?;
        check(&identity, &self.description.ordering)?;
        Ok(identity)
    }
}

/// Refuses an identity that was revoked or whose certificate has run out since it connected.
fn check(identity: &Identity, ordering: &Ordering) -> Result<(), Status> {
    identity.check_validity(ordering.clock.wall()).map_err(|error| status(&error.into()))?;
    ordering.storage.ledger.check_revoked(identity).map_err(|rejection| status(&rejection))
}

/// The answer to a call, or why there is none.
fn answer<T>(answer: Result<T, Rejection>) -> Result<Response<T>, Status> {
    answer.map(Response::new).map_err(|rejection| status(&rejection))
}

/// The answers to a stream of transactions, which say how many voters answer where no leader is known.
pub(crate) struct Explained {
    verdicts: Verdicts,
    records: Arc<Records>,
}

impl Stream for Explained {
    type Item = Result<SubmitResponse, Status>;

    fn poll_next(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Option<Self::Item>> {
        let Self { verdicts, records } = &mut *self;
        let mut answer = Pin::new(verdicts).poll_next(cx);
        if let Poll::Ready(Some(Ok(SubmitResponse { verdict: Some(verdict), .. }))) = &mut answer {
            records.verdict_with_voters(verdict);
        }
        answer
    }
}

#[tonic::async_trait]
impl Gateway for GatewayService {
    async fn submit(&self, request: Request<SubmitRequest>) -> Result<Response<SubmitResponse>, Status> {
        let caller = self.caller(&request)?;
        let (answers, mut answer) = mpsc::unbounded_channel();
        self.submissions.one(caller.id(), request.into_inner(), &answers).await;
        drop(answers);
        let stopping = || status(&Rejection::new(Code::ShuttingDown, "the node is stopping"));
        let mut answer = answer.recv().await.ok_or_else(stopping)??;
        answer.verdict.iter_mut().for_each(|verdict| self.records.verdict_with_voters(verdict));
        Ok(Response::new(answer))
    }

    type SubmitStreamStream = Explained;

    async fn submit_stream(
        &self,
        request: Request<Streaming<SubmitRequest>>,
    ) -> Result<Response<Self::SubmitStreamStream>, Status> {
        let caller = self.caller(&request)?;
        let verdicts = self.submissions.stream(caller.id(), request.into_inner());
        Ok(Response::new(Explained { verdicts, records: Arc::clone(&self.records) }))
    }

    async fn query(&self, request: Request<QueryRequest>) -> Result<Response<QueryResponse>, Status> {
        let caller = self.caller(&request)?;
        self.records.query(&caller, request.into_inner()).await.map(Response::new)
    }

    type SubscribeStream = Pin<Box<dyn Stream<Item = Result<Delivery, Status>> + Send>>;

    async fn subscribe(&self, request: Request<SubscribeRequest>) -> Result<Response<Self::SubscribeStream>, Status> {
        let caller = self.caller(&request)?;
        let deliveries = self.subscriptions.start(caller, request.into_inner()).await?;
        Ok(Response::new(Box::pin(deliveries)))
    }

    async fn status(&self, request: Request<StatusRequest>) -> Result<Response<StatusResponse>, Status> {
        self.caller(&request)?;
        answer(self.description.status())
    }

    async fn nodes(&self, request: Request<NodesRequest>) -> Result<Response<NodesResponse>, Status> {
        self.caller(&request)?;
        answer(self.nodes.all().await)
    }

    async fn get_block(&self, request: Request<GetBlockRequest>) -> Result<Response<Block>, Status> {
        let caller = self.caller(&request)?;
        answer(self.records.block(&caller, request.into_inner().height).await)
    }

    async fn get_transaction(
        &self,
        request: Request<GetTransactionRequest>,
    ) -> Result<Response<TransactionRecord>, Status> {
        let caller = self.caller(&request)?;
        answer(self.records.transaction(&caller, &request.into_inner()).await)
    }

    type GovernanceStream = Pin<Box<dyn Stream<Item = Result<GovernanceStep, Status>> + Send>>;

    async fn governance(
        &self,
        request: Request<GovernanceRequest>,
    ) -> Result<Response<Self::GovernanceStream>, Status> {
        let caller = self.caller(&request)?;
        Ok(Response::new(Box::pin(self.proofs.governance(caller, request.into_inner().after))))
    }

    async fn prove(&self, request: Request<ProveRequest>) -> Result<Response<ProveResponse>, Status> {
        self.caller(&request)?;
        answer(self.proofs.prove(request.into_inner()).await)
    }

    async fn prove_transaction(
        &self,
        request: Request<ProveTransactionRequest>,
    ) -> Result<Response<ProveTransactionResponse>, Status> {
        let caller = self.caller(&request)?;
        answer(self.proofs.link(caller, &request.into_inner().id).await)
    }

    async fn denials(&self, request: Request<DenialsRequest>) -> Result<Response<DenialsResponse>, Status> {
        let caller = self.caller(&request)?;
        answer(denied::latest(&self.description.rejections, &caller, request.into_inner().limit))
    }

    async fn audit(&self, request: Request<AuditRequest>) -> Result<Response<AuditResponse>, Status> {
        let caller = self.caller(&request)?;
        answer(self.audit.answer(caller, request.into_inner()).await)
    }

    async fn transfer_leadership(
        &self,
        request: Request<TransferLeadershipRequest>,
    ) -> Result<Response<TransferLeadershipResponse>, Status> {
        let caller = self.caller(&request)?;
        Ok(Response::new(
            transfer::transfer_leadership(&self.description.ordering, &caller, request.into_inner().node_id).await,
        ))
    }
}
