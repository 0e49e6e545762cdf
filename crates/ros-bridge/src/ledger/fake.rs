//! For tests: a ledger that answers what a test says.
#![expect(clippy::unwrap_used, reason = "tests")]

use std::{
    collections::BTreeSet,
    sync::{
        Arc, Mutex,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    task::Poll,
};

use bytes::Bytes;
use futures::{FutureExt, StreamExt, future::BoxFuture, stream::poll_fn};
use ledger::CallRef;
use ledger::transaction::Transaction;
use ledger_api::{
    Answer, Certified, Subscription,
    v1::{Delivery, EventRecord},
};
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{Capabilities, Declaration, Grant, Mode, RobotAsset, ToldCapabilities};
use ledger_gate::fixture::{Network, grant, micros};
use ledger_light::{Certificate, Change, Checkpoint, Governance, Proof, Statement, fact::Fact, merkle, proof::Shown};
use serde_json::{Value, json};
use tokio::sync::{mpsc, watch};
use tokio_stream::wrappers::UnboundedReceiverStream;

use super::gateway::{Deliveries, Gateway, Verdict};

/// The fate of a sample.
#[derive(Clone)]
pub(crate) enum Fate {
    Committed,
    Refused(Code),
    /// No verdict ever comes.
    Lost,
}

/// The other end of a subscription.
type Sender = mpsc::UnboundedSender<Result<Delivery, Rejection>>;

pub(crate) struct Fake {
    /// The governance at the genesis.
    founded: Governance,
    /// Height of the last answer of the voters.
    height: AtomicU64,
    /// Does anybody certify its beginning?
    pub(crate) certifies: AtomicBool,
    /// Do the voters answer?
    pub(crate) answers: AtomicBool,
    /// Does a question to the voters get neither an answer nor a refusal?
    pub(crate) hangs: AtomicBool,
    /// Such questions that nobody waits for any more.
    pub(crate) given_up: Arc<AtomicU64>,
    service: Mutex<Value>,
    grants: Mutex<Value>,
    own: Mutex<Value>,
    fate: Mutex<Fate>,
    /// Arguments of every `set`.
    pub(crate) sets: watch::Sender<Vec<Vec<Bytes>>>,
    streams: Mutex<Vec<(Subscription, Sender)>>,
    /// Signs of life come without an end.
    pub(crate) floods: AtomicBool,
    /// Blocks of the past, each for who asks from its height on.
    kept: Mutex<Vec<Delivery>>,
    /// The stops that the newest question named.
    pub(crate) asked: Mutex<BTreeSet<CallRef>>,
    /// Those that the voters list as settled, by their ids.
    pub(crate) settled: Mutex<Vec<String>>,
}

impl Fake {
    /// A ledger with one service, held by nobody.
    pub(crate) fn new(mode: &str, network: &Network) -> Arc<Self> {
        let fake = Self {
            founded: founded(network),
            height: AtomicU64::new(1),
            certifies: AtomicBool::new(true),
            answers: AtomicBool::new(true),
            hangs: AtomicBool::new(false),
            given_up: Arc::default(),
            service: Mutex::new(Value::Null),
            grants: Mutex::new(json!([])),
            own: Mutex::new(json!({ "epoch": 0, "next_seq": 0 })),
            fate: Mutex::new(Fate::Committed),
            sets: watch::Sender::new(Vec::new()),
            streams: Mutex::default(),
            floods: AtomicBool::new(false),
            kept: Mutex::default(),
            asked: Mutex::default(),
            settled: Mutex::default(),
        };
        fake.set_mode(mode);
        Arc::new(fake)
    }

    pub(crate) fn set_mode(&self, mode: &str) {
        let known = Capabilities::of_mode(&Mode::from(mode)).map(|known| json!(ToldCapabilities::from(known)));
        let capabilities = known.unwrap_or_else(|| json!({ "places": "2" }));
        *self.service.lock().unwrap() = json!({
            "service": "T/cmd_vel", "robot": "T", "organisation": "Org2", "topic": "/cmd_vel",
            "type": "geometry_msgs/msg/Twist", "mode": mode, "direction": "command", "max_age_ms": 10_000, "lease_ms": 10000,
            "lease_ms_max": 600_000, "stop_hex": null, "holder": "", "holders": [], "epoch": 3, "expires": 0,
            "capabilities": capabilities,
        });
    }

    pub(crate) fn set_type(&self, name: &str) {
        *self.service.lock().unwrap().get_mut("type").unwrap() = json!(name);
    }

    pub(crate) fn set_direction(&self, direction: &str) {
        *self.service.lock().unwrap().get_mut("direction").unwrap() = json!(direction);
    }

    pub(crate) fn set_holder(&self, holder: &str, epoch: u64, lease_ms: u64) {
        self.set_grant(&held_by(holder, epoch, lease_ms));
    }

    /// The only grant.
    pub(crate) fn set_grant(&self, grant: &Grant) {
        *self.grants.lock().unwrap() = json!([grant]);
    }

    pub(crate) fn set_free(&self) {
        *self.grants.lock().unwrap() = json!([]);
    }

    pub(crate) fn set_own_epoch(&self, epoch: u64) {
        *self.own.lock().unwrap() = json!({ "epoch": epoch, "next_seq": 0 });
    }

    pub(crate) fn set_fate(&self, fate: Fate) {
        *self.fate.lock().unwrap() = fate;
    }

    fn asset(&self, robot: &str) -> RobotAsset {
        RobotAsset {
            name: robot.to_owned(),
            sub_topic: String::new(),
            pub_topic: String::new(),
            operator: String::new(),
            under_operation: false,
            organisation: "Org2".to_owned(),
            attribute_required: String::new(),
            version: String::new(),
            trusted: Vec::new(),
            services: vec![serde_json::from_value(self.service.lock().unwrap().clone()).unwrap()],
            attributes: Default::default(),
            stopped: None,
        }
    }

    /// Delivers an event to whoever subscribed to it.
    pub(crate) fn deliver(
        &self,
        block_time: u64,
        name: &str,
        payload: &Value,
        caused_by: Option<(&Transaction, &Bytes)>,
    ) {
        let (transaction, certificate) = caused_by
            .map(|(transaction, certificate)| (transaction.encoded().clone(), certificate.clone()))
            .unwrap_or_default();
        let chaincode = if matches!(name, "revoked" | "revocation_list") { "msp" } else { "abac" };
        let event = EventRecord {
            chaincode: chaincode.into(),
            name: name.into(),
            payload: Bytes::from(payload.to_string()),
            transaction,
            certificate,
            ..EventRecord::default()
        };
        self.send(
            name,
            chaincode,
            Delivery { height: 1, time: block_time, events: vec![event], ..Delivery::default() },
        );
    }

    /// Keeps the block of a message.
    pub(crate) fn keep(&self, height: u64, time: u64, signed: &Transaction, certificate: &Bytes) {
        let event = EventRecord {
            chaincode: "abac".into(),
            name: "message".into(),
            transaction: signed.encoded().clone(),
            certificate: certificate.clone(),
            ..EventRecord::default()
        };
        self.kept.lock().unwrap().push(Delivery { height, time, events: vec![event], ..Delivery::default() });
    }

    fn latest(&self) -> Value {
        let kept = self.kept.lock().unwrap();
        let latest = kept.iter().map(|block| {
            json!({ "publisher": format!("Org2/{}", block.height), "epoch": 0, "seq": 1, "count": 1, "height": block.height })
        });
        latest.collect()
    }

    /// A sign of life without events.
    pub(crate) fn heartbeat(&self, block_time: u64) {
        self.send("message", "abac", heartbeat(block_time));
    }

    fn send(&self, name: &str, chaincode: &str, delivery: Delivery) {
        for (wanted, stream) in self.streams.lock().unwrap().iter() {
            if wanted.chaincode == chaincode && wanted.names.iter().any(|wanted| wanted == name) {
                let _gone = stream.send(Ok(delivery.clone()));
            }
        }
    }
}

/// Counts when a question is given up.
struct GivenUp(Arc<AtomicU64>);

impl Drop for GivenUp {
    fn drop(&mut self) {
        self.0.fetch_add(1, Ordering::Relaxed);
    }
}

/// A grant that has just begun.
pub(crate) fn held_by(holder: &str, epoch: u64, lease_ms: u64) -> Grant {
    let now = micros();
    Grant { expires: now + lease_ms * 1000, acquired_at: now, lease_ms, ..grant(holder, epoch) }
}

/// The governance of a network: its organisations, and a voter.
fn founded(network: &Network) -> Governance {
    let mut writes: Vec<_> = [("members", json!({ "voters": [1], "outgoing": [] }))]
        .into_iter()
        .chain([("node/1", json!({ "id": 1, "name": "node1", "organisation": "Org1" }))])
        .map(|(key, record)| (format!("msp\0{key}"), record))
        .collect();
    writes.extend(network.roots.iter().map(|(name, root)| {
        (format!("msp\0organisation/{name}"), json!({ "name": name, "roots": [hex::encode(root)] }))
    }));
    let writes = writes.into_iter().map(|(key, record)| (Bytes::from(key), Some(Bytes::from(record.to_string()))));
    let writes = writes.collect();
    Governance::founded(network.robot.network, 1, &Change { height: 0, writes }).unwrap()
}

fn heartbeat(block_time: u64) -> Delivery {
    Delivery { height: 1, time: block_time, ..Delivery::default() }
}

impl Gateway for Fake {
    fn query(
        &self,
        height: u64,
        _chaincode: &str,
        function: &str,
        _args: Vec<Bytes>,
    ) -> BoxFuture<'static, Result<Answer, Rejection>> {
        let value = match function {
            "robot" => json!(self.asset("T")),
            "service" => self.service.lock().unwrap().clone(),
            "grants" => self.grants.lock().unwrap().clone(),
            "authorize" => self.own.lock().unwrap().clone(),
            "GetSubmittingClientIdentity" => json!({ "id": "Org1/Salma" }),
            "revocations" => json!({ "items": [] }),
            "latest" => self.latest(),
            _ => json!([]),
        };
        std::future::ready(Ok(Answer { response: Bytes::from(value.to_string()), height, time: 0, stale_for: 0 }))
            .boxed()
    }

    fn node(&self) -> String {
        "fake:1".to_owned()
    }

    fn height(&self) -> BoxFuture<'static, Result<u64, Rejection>> {
        std::future::ready(Ok(0)).boxed()
    }

    fn beginning(&self) -> BoxFuture<'static, Result<Governance, Rejection>> {
        let founded = match self.certifies.load(Ordering::Relaxed) {
            true => Ok(self.founded.clone()),
            false => Err(Rejection::new(Code::NotFound, "the node shows no genesis")),
        };
        std::future::ready(founded).boxed()
    }

    /// The checks of proofs are those of the client: here the answer is as if they had been made.
    fn declare(
        &self,
        robot: &str,
        stops: &BTreeSet<CallRef>,
        known: Governance,
    ) -> BoxFuture<'static, Result<Certified, Rejection>> {
        *self.asked.lock().unwrap() = stops.clone();
        if self.hangs.load(Ordering::Relaxed) {
            let given_up = GivenUp(Arc::clone(&self.given_up));
            return async move {
                let _given_up = given_up;
                std::future::pending::<Result<Certified, Rejection>>().await
            }
            .boxed();
        }
        if !self.answers.load(Ordering::Relaxed) {
            return std::future::ready(Err(Rejection::new(Code::Timeout, "nobody answers"))).boxed();
        }
        let grants = serde_json::from_value(self.grants.lock().unwrap().clone()).unwrap();
        let told = json!(Declaration {
            robot: self.asset(robot),
            grants,
            tasks: Vec::new(),
            settled: self.settled.lock().unwrap().clone()
        });
        let (network, height) = (known.network(), self.height.fetch_add(1, Ordering::Relaxed));
        let (control, digest, previous) = (Hash::ZERO, Hash::ZERO, Hash::ZERO);
        let ground = Fact::Ground { governing: known.chain(), control, digest, previous };
        let leaves = [ground.leaf()];
        let results = merkle::root(leaves.to_vec());
        let statement = Statement { network, recoveries: 0, height, time: micros(), block: Hash::ZERO, results };
        let proof = Proof {
            certificate: Certificate { statement, signatures: Vec::new() },
            facts: vec![Shown::of(&ground, &leaves, 0).unwrap()],
        };
        let stored = Checkpoint { governance: known, proof }.to_bytes();
        let checkpoint = Checkpoint::from_bytes(&network, &stored).unwrap();
        std::future::ready(Ok(Certified { response: Bytes::from(told.to_string()), checkpoint })).boxed()
    }

    fn subscribe(&self, wanted: Subscription) -> Deliveries {
        let (sender, mut stream) = mpsc::unbounded_channel();
        let floods = self.floods.load(Ordering::Relaxed) && wanted.chaincode == "abac";
        for block in self.kept.lock().unwrap().iter().filter(|block| block.height == wanted.from_height) {
            let _gone = sender.send(Ok(block.clone()));
        }
        self.streams.lock().unwrap().push((wanted, sender));
        if !floods {
            return UnboundedReceiverStream::new(stream).boxed();
        }
        // Never pending: whoever looks here first looks at nothing else.
        poll_fn(move |context| match stream.poll_recv(context) {
            Poll::Pending => Poll::Ready(Some(Ok(heartbeat(micros())))),
            delivery => delivery,
        })
        .boxed()
    }

    fn set(&self, args: Vec<Bytes>) -> (Option<Hash>, Verdict) {
        let id = Hash::of(&args.iter().map(|arg| &arg[..]).collect::<Vec<_>>());
        self.sets.send_modify(|sets| sets.push(args));
        let verdict = match self.fate.lock().unwrap().clone() {
            Fate::Committed => std::future::ready(Ok(())).boxed(),
            Fate::Refused(code) => std::future::ready(Err(Rejection::new(code, "no"))).boxed(),
            Fate::Lost => std::future::pending().boxed(),
        };
        (Some(id), verdict)
    }

    fn invoke(&self, function: &str, _args: Vec<Bytes>) -> BoxFuture<'static, Result<Bytes, Rejection>> {
        let refused = Rejection::new(Code::UnknownFunction, format!("no {function} in tests"));
        std::future::ready(Err(refused)).boxed()
    }
}
