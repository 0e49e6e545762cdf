//! A node that does what a test tells it: the generated server traits over TLS, and a plug to pull.

mod enrolment;

use crate::authority::{Authority, NETWORK};
use crate::plugged::Plugged;
use bytes::Bytes;
use ledger::Rules;
use ledger::transaction::Transaction;
use ledger_api::tls::{TrustSource, server_config};
use ledger_api::v1::enrolment_server::EnrolmentServer;
use ledger_api::v1::gateway_server::{Gateway, GatewayServer};
use ledger_api::{to_status, v1};
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::Identity;
use ledger_identity::msp::Msps;
use std::collections::BTreeMap;
use std::io;
use std::pin::Pin;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, SystemTime, UNIX_EPOCH};
use tokio::net::TcpListener;
use tokio::sync::{mpsc, watch};
use tokio::task::{AbortHandle, JoinHandle};
use tokio_rustls::TlsAcceptor;
use tokio_stream::wrappers::{ReceiverStream, UnboundedReceiverStream};
use tokio_stream::{Stream, StreamExt};
use tonic::{Request, Response, Status, Streaming};

/// The node's treatment of a transaction.
#[derive(Clone)]
pub(crate) enum Reaction {
    /// Executes it (once) and says so.
    Commit,
    /// Executes it (once) and says nothing.
    CommitSilently,
    /// Refuses it before ordering.
    Refuse(Rejection),
    /// Says nothing, ever.
    Ignore,
}

/// The node's answer about a transaction that it is asked for.
#[derive(Clone, Copy)]
pub(crate) enum Records {
    /// It has it.
    Known,
    /// It has no such transaction.
    Unknown,
    /// Says nothing, ever.
    Silent,
}

type Script = dyn Fn(&Transaction, usize) -> Reaction + Send + Sync;
type Prover = dyn Fn(u64, Hash) -> Bytes + Send + Sync;
type Answers = Pin<Box<dyn Stream<Item = Result<v1::SubmitResponse, Status>> + Send>>;
type Steps = Pin<Box<dyn Stream<Item = Result<v1::GovernanceStep, Status>> + Send>>;
type Deliveries = Pin<Box<dyn Stream<Item = Result<v1::Delivery, Status>> + Send>>;

/// The part that several nodes of one network share: the chain.
#[derive(Default)]
pub(crate) struct Chain {
    /// Id -> height of the executed transactions.
    pub(crate) executed: Mutex<BTreeMap<Hash, u64>>,
}

pub(crate) struct Fake {
    pub(crate) node: Arc<Node>,
    authority: Arc<Authority>,
    address: String,
    server: Mutex<JoinHandle<()>>,
    plugs: Arc<Mutex<Vec<AbortHandle>>>,
}

pub(crate) struct Node {
    authority: Arc<Authority>,
    pub(crate) chain: Arc<Chain>,
    script: Mutex<Arc<Script>>,
    /// Every transaction as it came, in order.
    pub(crate) received: Mutex<Vec<Bytes>>,
    /// Height that the client had seen when it sent each of them.
    pub(crate) min_heights: Mutex<Vec<u64>>,
    /// Whether the client said of each of them that no node had it before.
    pub(crate) first_attempts: Mutex<Vec<bool>>,
    attempts: Mutex<BTreeMap<Hash, usize>>,
    pub(crate) subscriptions: Mutex<Vec<v1::SubscribeRequest>>,
    /// Height of the newest block with an event.
    pub(crate) height: watch::Sender<u64>,
    /// Times of the first blocks; further ones are of now.
    pub(crate) times: Mutex<Vec<u64>>,
    /// The height of heartbeats, if that is larger.
    pub(crate) beat: AtomicU64,
    /// The number of queries that fail before one is answered.
    pub(crate) not_now: Mutex<Vec<Rejection>>,
    /// Microseconds that this node's clock is ahead.
    pub(crate) ahead: AtomicU64,
    pub(crate) network: Mutex<Hash>,
    /// Gives this certificate whatever is asked.
    pub(crate) certificate: Mutex<Option<Bytes>>,
    /// Certifies this name whatever is asked.
    pub(crate) name: Mutex<Option<String>>,
    /// Addresses that it tells of its organisation.
    pub(crate) addresses: Mutex<Vec<String>>,
    /// How often somebody asked for a renewal.
    pub(crate) renewals: AtomicU64,
    /// Why nobody's certificate is renewed.
    pub(crate) no_renewal: Mutex<Option<Rejection>>,
    /// Can it have nothing ordered?
    pub(crate) cut_off: AtomicBool,
    /// The organisations whose CA it carries.
    pub(crate) carries: Mutex<Vec<String>>,
    /// The way that it shows to who asks for the governance.
    pub(crate) steps: Mutex<Vec<v1::GovernanceStep>>,
    /// Makes proofs of a block, with the id of the newest transaction.
    pub(crate) prover: Mutex<Arc<Prover>>,
    /// Does the way that it shows never end? Then its last step comes again and again.
    pub(crate) endless: AtomicBool,
    /// The answers to questions about transactions.
    pub(crate) records: Mutex<Records>,
    /// How often it was asked about one.
    pub(crate) asked: AtomicU64,
}

pub(crate) fn wall_clock() -> u64 {
    u64::try_from(SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_micros()).unwrap()
}

/// Waits until something is true.
pub(crate) async fn until(what: &str, mut holds: impl FnMut() -> bool) {
    let deadline = tokio::time::Instant::now() + Duration::from_secs(60);
    while !holds() {
        assert!(tokio::time::Instant::now() < deadline, "waited in vain until {what}");
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
}

impl Fake {
    pub(crate) async fn start(authority: &Arc<Authority>) -> Self {
        Self::with_chain(authority, Arc::default()).await
    }

    pub(crate) async fn with_chain(authority: &Arc<Authority>, chain: Arc<Chain>) -> Self {
        let node = Arc::new(Node {
            authority: Arc::clone(authority),
            chain,
            script: Mutex::new(Arc::new(|_, _| Reaction::Commit)),
            received: Mutex::default(),
            min_heights: Mutex::default(),
            first_attempts: Mutex::default(),
            attempts: Mutex::default(),
            subscriptions: Mutex::default(),
            height: watch::Sender::new(0),
            times: Mutex::default(),
            beat: AtomicU64::new(0),
            not_now: Mutex::default(),
            ahead: AtomicU64::new(0),
            network: Mutex::new(NETWORK),
            certificate: Mutex::default(),
            name: Mutex::default(),
            addresses: Mutex::default(),
            renewals: AtomicU64::new(0),
            no_renewal: Mutex::default(),
            cut_off: AtomicBool::new(false),
            carries: Mutex::new(vec!["Org1".into()]),
            steps: Mutex::default(),
            prover: Mutex::new(Arc::new(|_, _| Bytes::new())),
            endless: AtomicBool::new(false),
            records: Mutex::new(Records::Known),
            asked: AtomicU64::new(0),
        });
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap().to_string();
        let plugs = Arc::default();
        let server = Mutex::new(serve(&node, authority, &plugs, listener));
        Self { node, authority: Arc::clone(authority), address, server, plugs }
    }

    pub(crate) fn address(&self) -> String {
        self.address.clone()
    }

    /// From now on transactions are treated so; the number counts how often the same one came.
    pub(crate) fn script(&self, script: impl Fn(&Transaction, usize) -> Reaction + Send + Sync + 'static) {
        *self.node.script.lock().unwrap() = Arc::new(script);
    }

    pub(crate) fn min_heights(&self) -> Vec<u64> {
        self.node.min_heights.lock().unwrap().clone()
    }

    pub(crate) fn first_attempts(&self) -> Vec<bool> {
        self.node.first_attempts.lock().unwrap().clone()
    }

    pub(crate) fn received(&self) -> Vec<Bytes> {
        self.node.received.lock().unwrap().clone()
    }

    /// Is there no connection?
    pub(crate) fn idle(&self) -> bool {
        self.plugs.lock().unwrap().iter().all(AbortHandle::is_finished)
    }

    /// Cuts all connections; new ones are accepted.
    pub(crate) fn cut(&self) {
        for plug in self.plugs.lock().unwrap().drain(..) {
            plug.abort();
        }
    }

    /// Cuts all connections and accepts no more.
    pub(crate) async fn stop(&self) {
        self.server.lock().unwrap().abort();
        until("the server has stopped", || self.server.lock().unwrap().is_finished()).await;
        self.cut();
    }

    /// Starts again at the same address.
    pub(crate) async fn restart(&self) {
        let listener = TcpListener::bind(&self.address).await.unwrap();
        *self.server.lock().unwrap() = serve(&self.node, &self.authority, &self.plugs, listener);
    }
}

impl Drop for Fake {
    fn drop(&mut self) {
        self.server.lock().unwrap().abort();
        self.cut();
    }
}

struct Trust(Arc<Msps>);

impl TrustSource for Trust {
    fn msps(&self) -> Arc<Msps> {
        Arc::clone(&self.0)
    }

    fn now(&self) -> u64 {
        wall_clock()
    }

    fn revoked(&self, _identity: &Identity) -> bool {
        false
    }
}

fn serve(
    node: &Arc<Node>,
    authority: &Authority,
    plugs: &Arc<Mutex<Vec<AbortHandle>>>,
    listener: TcpListener,
) -> JoinHandle<()> {
    let config = server_config(authority.node(), Arc::new(Trust(authority.msps()))).unwrap();
    let acceptor = TlsAcceptor::from(Arc::new(config));
    let (connected, connections) = mpsc::channel(16);
    let plugs = Arc::clone(plugs);
    let accept = async move {
        loop {
            let (mut tcp, _) = listener.accept().await.unwrap();
            let (inside, mut outside) = tokio::io::duplex(64 * 1024);
            let forward = tokio::spawn(async move { tokio::io::copy_bidirectional(&mut tcp, &mut outside).await });
            plugs.lock().unwrap().push(forward.abort_handle());
            let (acceptor, connected) = (acceptor.clone(), connected.clone());
            tokio::spawn(async move {
                if let Ok(stream) = acceptor.accept(inside).await {
                    let _stopped = connected.send(Ok::<_, io::Error>(Plugged(stream))).await;
                }
            });
        }
    };
    let server = tonic::transport::Server::builder()
        .add_service(GatewayServer::new(Shared(Arc::clone(node))))
        .add_service(EnrolmentServer::new(Shared(Arc::clone(node))))
        .serve_with_incoming(ReceiverStream::new(connections));
    tokio::spawn(async move {
        tokio::select! {
            () = accept => {}
            done = server => done.unwrap(),
        }
    })
}

#[derive(Clone)]
struct Shared(Arc<Node>);

impl Node {
    fn clock(&self) -> u64 {
        wall_clock() + self.ahead.load(Ordering::SeqCst)
    }

    fn submit(&self, encoded: &Bytes) -> Option<v1::SubmitResponse> {
        let transaction = Transaction::decode(encoded.clone()).unwrap();
        let id = transaction.id();
        let attempt = {
            self.received.lock().unwrap().push(encoded.clone());
            let mut attempts = self.attempts.lock().unwrap();
            let attempt = attempts.entry(id).or_insert(0);
            *attempt += 1;
            *attempt
        };
        let script = Arc::clone(&*self.script.lock().unwrap());
        let mut answer = v1::SubmitResponse { id: Bytes::copy_from_slice(id.as_ref()), ..Default::default() };
        let refused = match script(&transaction, attempt) {
            Reaction::Ignore => return None,
            Reaction::Refuse(refused) => Some(refused),
            _ if transaction.check_time(self.clock()).is_err() => transaction.check_time(self.clock()).err(),
            reaction => {
                let mut executed = self.chain.executed.lock().unwrap();
                let next = u64::try_from(executed.len()).unwrap() + 1;
                let height = *executed.entry(id).or_insert(next);
                if matches!(reaction, Reaction::CommitSilently) {
                    return None;
                }
                answer.height = height;
                answer.response = Bytes::from(height.to_string());
                None
            }
        };
        let ok = v1::Verdict::default();
        answer.verdict = Some(refused.map_or(ok, |refused| v1::Verdict::from(&refused)));
        Some(answer)
    }

    fn describe(&self) -> v1::NetworkResponse {
        v1::NetworkResponse {
            network: Bytes::copy_from_slice(self.network.lock().unwrap().as_ref()),
            label: "fleet".into(),
            organisations: vec![v1::Organisation {
                name: "Org1".into(),
                roots: vec![self.authority.der()],
                addresses: self.addresses.lock().unwrap().clone(),
                ..Default::default()
            }],
            clock: self.clock(),
            cut_off: self.cut_off.load(Ordering::SeqCst),
            carries: self.carries.lock().unwrap().clone(),
            rules: Rules::NEWEST.number(),
            height: 0,
            block_hash: Bytes::new(),
        }
    }
}

/// The delivery of one height: one event that carries the height.
fn delivery(height: u64) -> v1::Delivery {
    let event = v1::EventRecord { payload: Bytes::from(height.to_string()), ..Default::default() };
    v1::Delivery { height, events: vec![event], ..Default::default() }
}

#[tonic::async_trait]
impl Gateway for Shared {
    async fn submit(&self, request: Request<v1::SubmitRequest>) -> Result<Response<v1::SubmitResponse>, Status> {
        self.0.submit(&request.into_inner().transaction).map(Response::new).ok_or_else(|| Status::aborted("silent"))
    }

    type SubmitStreamStream = Answers;

    async fn submit_stream(&self, request: Request<Streaming<v1::SubmitRequest>>) -> Result<Response<Answers>, Status> {
        let mut requests = request.into_inner();
        let (answers, stream) = mpsc::unbounded_channel();
        let node = Arc::clone(&self.0);
        tokio::spawn(async move {
            while let Some(Ok(request)) = requests.next().await {
                node.min_heights.lock().unwrap().push(request.min_height);
                node.first_attempts.lock().unwrap().push(request.first_attempt);
                if let Some(answer) = node.submit(&request.transaction) {
                    let _gone = answers.send(Ok(answer));
                }
            }
        });
        Ok(Response::new(Box::pin(UnboundedReceiverStream::new(stream))))
    }

    async fn query(&self, request: Request<v1::QueryRequest>) -> Result<Response<v1::QueryResponse>, Status> {
        if let Some(refused) = self.0.not_now.lock().unwrap().pop() {
            return Err(to_status(&refused));
        }
        let request = request.into_inner();
        let response = Bytes::from(request.min_height.to_string());
        let verdict = Some(v1::Verdict::default());
        // A current state has what was executed; any other one may be as old as the caller allows.
        let executed = u64::try_from(self.0.chain.executed.lock().unwrap().len()).unwrap();
        let current = executed.max(*self.0.height.borrow());
        let height = if request.may_be_stale { request.min_height } else { current };
        Ok(Response::new(v1::QueryResponse { verdict, response, height, ..Default::default() }))
    }

    type SubscribeStream = Deliveries;

    async fn subscribe(&self, request: Request<v1::SubscribeRequest>) -> Result<Response<Deliveries>, Status> {
        let request = request.into_inner();
        let mut next = request.from_height;
        let heartbeat = request.heartbeat_ms;
        self.0.subscriptions.lock().unwrap().push(request);
        let (mut heights, node) = (self.0.height.subscribe(), Arc::clone(&self.0));
        let (deliveries, stream) = mpsc::channel(16);
        tokio::spawn(async move {
            loop {
                let newest = *heights.borrow_and_update();
                while next <= newest {
                    if deliveries.send(Ok(delivery(next))).await.is_err() {
                        return;
                    }
                    next += 1;
                }
                let silence = if heartbeat == 0 { u64::MAX } else { heartbeat.into() };
                tokio::select! {
                    changed = heights.changed() => changed.unwrap(),
                    () = deliveries.closed() => return,
                    () = tokio::time::sleep(Duration::from_millis(silence)) => {
                        let height = newest.max(node.beat.load(Ordering::Relaxed));
                        let beat = v1::Delivery { height, ..Default::default() };
                        let _gone = deliveries.send(Ok(beat)).await;
                    }
                }
            }
        });
        Ok(Response::new(Box::pin(ReceiverStream::new(stream))))
    }

    async fn status(&self, _request: Request<v1::StatusRequest>) -> Result<Response<v1::StatusResponse>, Status> {
        let height = *self.0.height.borrow();
        Ok(Response::new(v1::StatusResponse { height, clock: self.0.clock(), ..Default::default() }))
    }

    async fn nodes(&self, _request: Request<v1::NodesRequest>) -> Result<Response<v1::NodesResponse>, Status> {
        Ok(Response::new(v1::NodesResponse::default()))
    }

    async fn get_block(&self, request: Request<v1::GetBlockRequest>) -> Result<Response<v1::Block>, Status> {
        let height = request.into_inner().height;
        if height > *self.0.height.borrow() {
            let refused = Rejection::new(Code::NotFound, format!("there is no block {height}")).next("wait for it");
            return Err(to_status(&refused));
        }
        let place = usize::try_from(height).unwrap() - 1;
        let time = self.0.times.lock().unwrap().get(place).copied().unwrap_or_else(wall_clock);
        Ok(Response::new(v1::Block { height, time, ..Default::default() }))
    }

    async fn get_transaction(
        &self,
        request: Request<v1::GetTransactionRequest>,
    ) -> Result<Response<v1::TransactionRecord>, Status> {
        self.0.asked.fetch_add(1, Ordering::Relaxed);
        let records = *self.0.records.lock().unwrap();
        match records {
            Records::Known => {
                Ok(Response::new(v1::TransactionRecord { id: request.into_inner().id, ..Default::default() }))
            }
            Records::Unknown => Err(to_status(&Rejection::new(Code::NotFound, "this node has no such transaction"))),
            Records::Silent => std::future::pending().await,
        }
    }

    type GovernanceStream = Steps;

    async fn governance(&self, _request: Request<v1::GovernanceRequest>) -> Result<Response<Steps>, Status> {
        let steps: Vec<_> = self.0.steps.lock().unwrap().iter().cloned().map(Ok).collect();
        let last = self.0.endless.load(Ordering::Relaxed).then(|| steps.last().cloned()).flatten();
        Ok(Response::new(Box::pin(tokio_stream::iter(
            steps.into_iter().chain(std::iter::from_fn(move || last.clone())),
        ))))
    }

    async fn prove(&self, request: Request<v1::ProveRequest>) -> Result<Response<v1::ProveResponse>, Status> {
        let newest = self.0.received.lock().unwrap().last().cloned().unwrap_or_default();
        let id = Transaction::decode(newest).map_or(Hash::ZERO, |newest| newest.id());
        let prover = Arc::clone(&self.0.prover.lock().unwrap());
        Ok(Response::new(v1::ProveResponse { proof: prover(request.into_inner().height, id) }))
    }

    async fn denials(&self, _request: Request<v1::DenialsRequest>) -> Result<Response<v1::DenialsResponse>, Status> {
        Ok(Response::new(v1::DenialsResponse::default()))
    }

    async fn prove_transaction(
        &self,
        _request: Request<v1::ProveTransactionRequest>,
    ) -> Result<Response<v1::ProveTransactionResponse>, Status> {
        Ok(Response::new(v1::ProveTransactionResponse::default()))
    }

    async fn audit(&self, _request: Request<v1::AuditRequest>) -> Result<Response<v1::AuditResponse>, Status> {
        Ok(Response::new(v1::AuditResponse::default()))
    }

    async fn transfer_leadership(
        &self,
        _request: Request<v1::TransferLeadershipRequest>,
    ) -> Result<Response<v1::TransferLeadershipResponse>, Status> {
        Ok(Response::new(v1::TransferLeadershipResponse::default()))
    }
}
