//! One voter with a simulated disk and no threads: what its replica does with what happens.

use crate::cluster::names::Names;
use bytes::Bytes;
use ledger::network::{FoundingNode, FoundingOrganisation, Genesis};
use ledger::transaction::{Body, Transaction};
use ledger::{Chaincode, Context, Ledger, Registry};
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::key::{KeyKind, SigningKey};
use ledger_raft::{Desired, Input, Lane, PeerMessage, Secret, Transactions};
use ledger_replica::catch_up::{Behind, CatchUp, Caught, Got, Holding, Offer, Todo, Who};
use ledger_replica::conductor::{Conductor, Happened, Next};
use ledger_replica::{
    Answer, Circumstances, Effect, Event, Executor, FULL_DISK_PAUSE, Last, Now, Replica, Settings, Timing, WAIT_MAX,
    Waiter, Waiters, Work,
};
use ledger_storage::block_store::{BlockStore, Options, StoreError};
use ledger_storage::disk::SimDisk;
use ledger_storage::entry::{Entry, EntryKind};
use ledger_storage::results::ResultStore;
use ledger_storage::state::{MemoryState, State};
use std::sync::{Arc, mpsc};
use testkit::{Ca, User};

/// 2030-01-01, in microseconds since the UNIX epoch.
const EPOCH: u64 = 1_893_456_000_000_000;
const SECOND: u64 = 1_000_000;
const TICK: u64 = 10_000;

/// Notes what it is told; `alarm` wants a block five seconds later.
struct Notes;

impl Chaincode for Notes {
    fn name(&self) -> &'static str {
        "notes"
    }

    fn invoke(&self, ctx: &mut Context<'_>, function: &str, args: &[Bytes]) -> Result<Bytes, Rejection> {
        ctx.put(function.as_bytes(), ctx.block_time().to_be_bytes().to_vec());
        Ok(args.first().cloned().unwrap_or_default())
    }

    fn begin_block(&self, ctx: &mut Context<'_>) {
        if self.next_deadline(ctx).is_some_and(|due| due <= ctx.block_time()) {
            ctx.delete(b"alarm");
        }
    }

    fn next_deadline(&self, ctx: &Context<'_>) -> Option<u64> {
        let set = ctx.get(b"alarm")?;
        Some(u64::from_be_bytes(set.as_ref().try_into().unwrap()) + 5 * SECOND)
    }
}

/// The client's answer: the code, and the height of the block.
type Heard = (u32, Code, u64);

struct Client(u32, mpsc::Sender<Heard>);

impl Waiter for Client {
    fn answer(self, answer: &Answer<'_>) {
        let (code, height) = match answer {
            Answer::Executed(told) => (told.result.code(), told.height),
            Answer::Refused { reason, .. } => (reason.code, 0),
        };
        self.1.send((self.0, code, height)).unwrap();
    }

    fn name(&self) -> &str {
        "Org1/Salma"
    }

    fn is_gone(&self) -> bool {
        false
    }
}

struct Node {
    replica: Replica<Client>,
    executor: Arc<Executor>,
    waiters: Arc<Waiters<Client>>,
    store: Arc<BlockStore>,
    disk: SimDisk,
    now: u64,
    key: SigningKey,
    certificate: Bytes,
    network: Hash,
    nonce: u64,
    answers: (mpsc::Sender<Heard>, mpsc::Receiver<Heard>),
}

impl Node {
    fn new() -> Self {
        let ca = Ca::new("org1-ca");
        let User { key, certificate } = ca.user("Salma", "member", KeyKind::Ed25519);
        let ca = ca.root();
        let organisation = FoundingOrganisation::below("Org1", ca);
        let node = |id: u64| FoundingNode {
            id,
            name: format!("node{id}"),
            organisation: "Org1".into(),
            address: format!("127.0.0.1:{}", 7000 + id),
            voter: true,
        };
        let genesis = Genesis {
            rules: ledger::Rules::NEWEST.number(),
            label: "test".into(),
            created: EPOCH - SECOND,
            salt: Hash::ZERO,
            organisations: vec![organisation],
            nodes: vec![node(1)],
            snapshot_every: 1000,
        };
        let genesis = genesis.to_bytes().unwrap();
        let (_, network) = Genesis::from_bytes(&genesis).unwrap();
        let disk = SimDisk::new(1);
        let (store, _) = BlockStore::open(Arc::new(disk.clone()), Options::new(network.0, || 7)).unwrap();
        let store = Arc::new(store);
        let results = Arc::new(ResultStore::open(Arc::new(SimDisk::new(2)), network).unwrap());
        let state = Arc::new(State::open(Box::new(MemoryState::default())).unwrap());
        let mut registry = Registry::new();
        registry.install(Arc::new(Notes)).unwrap();
        let ledger = Arc::new(Ledger::open(&genesis, registry, state, results).unwrap());
        let waiters = Arc::new(Waiters::default());
        let executor = Arc::new(Executor::new(ledger, vec![Arc::clone(&waiters) as _]));
        let settings = Settings {
            id: 1,
            seed: 1,
            timing: Timing { tick: TICK, election_ticks: 20, ..Timing::default() },
            secret: Secret::default(),
        };
        let desired = Desired { voters: [1].into(), ..Desired::default() };
        let (log, executes, waits) = (Arc::clone(&store), Arc::clone(&executor), Arc::clone(&waiters));
        let replica = Replica::start(&settings, log, executes, waits, desired, Arc::new(Names));
        let mut node = Self {
            replica: replica.unwrap(),
            executor,
            waiters,
            store,
            disk,
            now: 0,
            key,
            certificate,
            network,
            nonce: 0,
            answers: mpsc::channel(),
        };
        // It is alone, so it leads; it orders once the first block of its term is executed.
        while node.executor.ledger().tip().height == 0 {
            node.turn();
            node.finish();
        }
        assert!(node.replica.leads());
        node
    }

    fn clocks(&self) -> Now {
        Now { clock: EPOCH + self.now, elapsed: self.now, accepts_until: u64::MAX, doubt: None }
    }

    fn step(&mut self, event: Event) -> Vec<Effect> {
        let mut effects = Vec::new();
        self.replica.step(self.clocks(), event, &mut effects);
        effects
    }

    /// The work that is due now is done, but for the write and the execution.
    fn turn(&mut self) {
        self.step(Event::Time { full: false });
    }

    /// Writes and executes until nothing is left to do at this moment.
    fn finish(&mut self) {
        while self.replica.must_write(self.clocks()) {
            let written = self.store.flush().map(drop);
            let stuck = written.is_err();
            self.step(Event::Written(written));
            if stuck {
                return;
            }
            self.execute();
        }
    }

    fn execute(&mut self) {
        while let Some(Work::Here(entries) | Work::Elsewhere(entries)) =
            self.replica.work(Circumstances { inputs_wait: false, other_is_idle: true })
        {
            self.executor.execute_all(&entries).unwrap();
            let height = entries.last().unwrap().index;
            self.step(Event::Executed { height, took: 1 });
        }
    }

    fn transaction(&mut self, function: &str) -> Transaction {
        self.nonce += 1;
        let body = Body {
            network: Bytes::copy_from_slice(&self.network.0),
            creator: Bytes::copy_from_slice(&Hash::of(&[&self.certificate]).0),
            nonce: [self.nonce.to_be_bytes(), [0; 8]].concat().into(),
            not_after: EPOCH + self.now + 60 * SECOND,
            chaincode: "notes".into(),
            function: function.into(),
            args: Vec::new(),
            known_block: None,
        };
        Transaction::sign(&body, &self.key).unwrap().with_certificate(self.certificate.clone()).unwrap()
    }

    /// A client waits for a transaction.
    fn waits(&self, client: u32, transaction: &Transaction) {
        self.waiters.add(self.now, transaction, Lane::Data, Client(client, self.answers.0.clone()));
    }

    fn submit(&mut self, client: u32, function: &str) {
        let transaction = self.transaction(function);
        self.waits(client, &transaction);
        self.step(Event::Input(Input::Submit { lane: Lane::Data, transaction: transaction.encoded().clone() }));
    }

    fn heard(&self) -> Vec<Heard> {
        self.answers.1.try_iter().collect()
    }

    fn height(&self) -> u64 {
        self.executor.ledger().tip().height
    }
}

#[test]
fn a_client_is_answered_when_its_block_is_on_the_disk_and_executed() {
    let mut node = Node::new();
    let height = node.height();
    node.submit(1, "note");
    assert_eq!(node.replica.work(Circumstances { inputs_wait: false, other_is_idle: true }), None, "not written yet");
    assert_eq!(node.heard(), []);
    node.finish();
    assert_eq!(node.heard(), [(1, Code::Ok, height + 1)]);
    assert!(node.waiters.is_empty());
}

#[test]
fn a_full_disk_is_tried_again_after_a_pause_and_answers_nobody_before() {
    let mut node = Node::new();
    node.disk.set_capacity(Some(node.disk.used_bytes()));
    node.submit(1, "note");
    assert!(node.replica.must_write(node.clocks()));
    let full = node.store.flush();
    assert!(matches!(full, Err(StoreError::DiskFull { .. })), "{full:?}");
    node.step(Event::Written(full.map(drop)));
    node.submit(2, "note");
    assert!(!node.replica.must_write(node.clocks()), "what comes does not hurry it");
    assert!(node.heard().is_empty() && node.replica.waits_for_write());
    node.disk.set_capacity(None);
    node.now += FULL_DISK_PAUSE;
    assert!(node.replica.must_write(node.clocks()));
    node.finish();
    let height = node.height();
    assert_eq!(node.heard(), [(1, Code::Ok, height - 1), (2, Code::Ok, height)]);
}

#[test]
fn a_deadline_that_no_traffic_meets_is_met_by_one_empty_block() {
    let mut node = Node::new();
    node.submit(1, "alarm");
    node.finish();
    let height = node.height();
    let due = node.executor.deadline();
    assert_eq!(due, EPOCH + node.now + 5 * SECOND);
    for _ in 0..TICK {
        node.turn();
        assert!(!node.replica.must_write(node.clocks()) || node.clocks().clock >= due, "too early");
        if node.clocks().clock >= due {
            break;
        }
        let wait = node.replica.wait(node.clocks());
        assert!((1..=SECOND).contains(&wait), "a node alone looks at the clock once a second");
        node.now += wait;
    }
    assert_eq!(node.clocks().clock, due, "it wakes up at the deadline itself");
    node.turn();
    node.finish();
    assert_eq!((node.height(), node.executor.deadline()), (height + 1, u64::MAX));
    node.turn();
    assert!(!node.replica.must_write(node.clocks()), "nothing more is due");
}

#[test]
fn who_waits_for_what_could_not_be_forwarded_is_told_at_once() {
    let mut node = Node::new();
    let (lost, other) = (node.transaction("lost"), node.transaction("other"));
    node.waits(1, &lost);
    node.waits(2, &other);
    let forward = Transactions { control: Vec::new(), data: vec![lost.encoded().clone()], code: 0 };
    let effects = node.step(Event::Unsent { to: 7, message: PeerMessage::Forward(forward) });
    let [Effect::Denied(denied)] = effects.as_slice() else { panic!("{effects:?}") };
    assert_eq!((denied.who.as_deref(), denied.rejection.code), (Some("Org1/Salma"), Code::NoLeader));
    assert_eq!(node.heard(), [(1, Code::NoLeader, 0)]);
}

#[test]
fn what_waits_is_submitted_again_in_the_order_in_which_it_came() {
    let mut node = Node::new();
    let transactions: Vec<_> = (0..20).map(|_| node.transaction("note")).collect();
    for (client, transaction) in (0..).zip(&transactions) {
        node.waits(client, transaction);
    }
    // A second client keeps the place of the first.
    node.waits(100, transactions.first().unwrap());
    let again: Vec<_> = node.waiters.all().into_iter().map(|(_, encoded)| encoded).collect();
    assert!(again.iter().eq(transactions.iter().map(Transaction::encoded)));
}

#[test]
fn the_verdict_on_a_forged_copy_answers_nobody() {
    let mut node = Node::new();
    let transaction = node.transaction("note");
    let stranger = testkit::key(KeyKind::Ed25519);
    let forged = Transaction::sign(transaction.body(), &stranger).unwrap();
    let forged = forged.with_certificate(node.certificate.clone()).unwrap();
    assert_eq!(forged.id(), transaction.id());
    node.waits(1, &transaction);
    for copy in [&forged, &transaction] {
        let transaction = copy.encoded().clone();
        node.step(Event::Input(Input::Submit { lane: Lane::Data, transaction }));
        node.finish();
    }
    assert_eq!(node.heard(), [(1, Code::Ok, node.height())]);
}

#[test]
fn who_waits_too_long_is_told_that_nobody_knows() {
    let mut node = Node::new();
    let (one, two) = (node.transaction("note"), node.transaction("note"));
    node.waits(1, &one);
    node.now += SECOND;
    node.waits(2, &two);
    node.now += WAIT_MAX - SECOND;
    node.waiters.sweep(node.now);
    assert_eq!(node.heard(), []);
    node.waiters.sweep(node.now + 1);
    assert_eq!(node.heard(), [(1, Code::Timeout, 0)]);
    assert!(!node.waiters.is_empty(), "the other one waits on");
}

#[test]
fn a_lot_is_executed_by_the_other_thread_and_in_order() {
    let mut node = Node::new();
    node.submit(1, "note");
    node.step(Event::Written(node.store.flush().map(drop)));
    let busy = Circumstances { inputs_wait: true, other_is_idle: true };
    let Some(Work::Elsewhere(entries)) = node.replica.work(busy) else { panic!("inputs wait") };
    let next = Entry { kind: EntryKind::Normal, ..entries.first().unwrap().clone() };
    assert_eq!(next.index, node.height() + 1);
    assert_eq!(node.replica.work(busy), None, "it is given once");
}

#[test]
fn a_node_that_ends_its_engine_with_a_full_disk_waits_and_goes_on_when_there_is_room() {
    let mut node = Node::new();
    let mut conductor = Conductor::new(1, Arc::clone(node.executor.ledger()));
    assert_eq!(conductor.step(Happened::Looked(Vec::new())), Ok(Next::Start));
    let behind = Behind { from: 2, first_index: 9 };
    assert_eq!(conductor.step(Happened::Behind(behind)), Ok(Next::End(behind)));
    node.submit(1, "note");
    node.disk.set_capacity(Some(node.disk.used_bytes()));
    assert_eq!(conductor.step(Happened::Ended), Ok(Next::Flush));
    let staged = node.store.last_index();
    for _ in 0..3 {
        let full = node.store.flush().map(drop);
        assert!(matches!(full, Err(StoreError::DiskFull { .. })), "{full:?}");
        assert_eq!(conductor.step(Happened::Flushed(full)), Ok(Next::Pause(FULL_DISK_PAUSE)));
        assert_eq!(conductor.step(Happened::Behind(behind)), Ok(Next::Nothing), "it knows");
        assert_eq!(conductor.step(Happened::Waited), Ok(Next::Flush));
    }
    node.disk.set_capacity(None);
    let written = node.store.flush().map(drop);
    assert_eq!(conductor.step(Happened::Flushed(written)), Ok(Next::CatchUp(Some(behind))));
    assert_eq!(node.store.durable_index(), staged, "nothing that was staged is lost");
}

#[test]
fn a_node_whose_disk_fails_while_its_engine_ends_does_not_go_on() {
    let node = Node::new();
    let mut conductor = Conductor::new(1, Arc::clone(node.executor.ledger()));
    let behind = Behind { from: 2, first_index: 9 };
    for happened in [Happened::Looked(Vec::new()), Happened::Behind(behind), Happened::Ended] {
        conductor.step(happened).unwrap();
    }
    let broken =
        StoreError::Io { operation: "write", file: "log".into(), source: Arc::new(std::io::Error::other("no answer")) };
    let reason = conductor.step(Happened::Flushed(Err(broken))).unwrap_err();
    assert_eq!(reason.code, Code::DiskFailed);
}

#[test]
fn a_peer_that_calls_its_own_disk_damaged_does_not_stop_a_node_that_catches_up() {
    let node = Node::new();
    let offer = |id: u64| {
        let who = Who { id, organisation: "Org1".into(), name: format!("node{id}"), vouched: false };
        let has = Holding { height: 50 + id, first_height: 1, snapshot_height: 50, ..Holding::default() };
        Offer { who, has, peer: id }
    };
    let damaged = || Rejection::new(Code::Corrupt, "a block is damaged");
    let behind = Behind { from: 2, first_index: 9 };
    let mut machine = CatchUp::new(Arc::clone(node.executor.ledger()), "Org1".into(), Some(behind), None);
    let opened = machine.step(Got::Offers(vec![offer(2), offer(3)]));
    assert!(matches!(opened, Todo::Open { peer: 3, .. }), "the one with most blocks first");
    let next = machine.step(Got::Blocks(Err(damaged())));
    assert!(matches!(next, Todo::Open { peer: 2, .. }), "another node is asked");
    let next = machine.step(Got::Blocks(Err(damaged())));
    assert!(matches!(next, Todo::Manifest { peer: 2 | 3 }), "and then for snapshots");
    assert!(matches!(machine.step(Got::Manifest(Err(damaged()))), Todo::Manifest { .. }));
    assert!(matches!(machine.step(Got::Unfetched(damaged())), Todo::Done(Caught::Nothing)));
    let own = machine.step(Got::TakenIn(Err(damaged())));
    assert!(matches!(own, Todo::Failed(reason) if reason.code == Code::Corrupt), "its own disk does");
}

#[test]
fn a_peer_whose_messages_bring_no_block_does_not_hold_up_a_node_that_catches_up() {
    let node = Node::new();
    let who = Who { id: 2, organisation: "Org1".into(), name: "node2".into(), vouched: false };
    let has = Holding { height: 50, first_height: 1, snapshot_height: 50, ..Holding::default() };
    let offer = Offer { who, has, peer: 2 };
    let behind = Behind { from: 2, first_index: 9 };
    let mut machine = CatchUp::new(Arc::clone(node.executor.ledger()), "Org1".into(), Some(behind), None);
    assert!(matches!(machine.step(Got::Offers(vec![offer])), Todo::Open { peer: 2, .. }));
    let next = machine.step(Got::Blocks(Ok(Some(Vec::new()))));
    assert!(matches!(next, Todo::Manifest { peer: 2 }), "there is no other node to ask for blocks");
}

#[test]
fn a_replica_that_ends_writes_the_log_and_executes_what_is_committed_then() {
    let mut node = Node::new();
    node.submit(1, "note");
    assert_eq!(node.replica.end(), Some(Last::Write));
    node.step(Event::Written(node.store.flush().map(drop)));
    let Some(Last::Execute(entries)) = node.replica.end() else { panic!("the block is committed") };
    assert_eq!(entries.first().map(|entry| entry.index), Some(node.height() + 1));
    node.executor.execute_all(&entries).unwrap();
    assert_eq!(node.heard(), [(1, Code::Ok, node.height())]);
    assert_eq!(node.replica.end(), None);
}

#[test]
fn a_full_disk_keeps_no_replica_from_ending() {
    let mut node = Node::new();
    node.submit(1, "note");
    node.disk.set_capacity(Some(node.disk.used_bytes()));
    assert_eq!(node.replica.end(), Some(Last::Write));
    node.step(Event::Written(node.store.flush().map(drop)));
    assert_eq!(node.replica.end(), None, "it is tried once");
    assert!(node.heard().is_empty(), "nobody was told otherwise");
}

#[test]
#[should_panic(expected = "an engine that was behind restarts with the fetched blocks")]
fn an_engine_that_starts_again_without_the_blocks_that_it_lacked_is_found() {
    let node = Node::new();
    let mut conductor = Conductor::new(1, Arc::clone(node.executor.ledger()));
    let behind = Behind { from: 2, first_index: 9 };
    for happened in [Happened::Looked(Vec::new()), Happened::Behind(behind), Happened::Ended, Happened::Flushed(Ok(()))]
    {
        conductor.step(happened).unwrap();
    }
    let _never = conductor.step(Happened::Caught(Caught::Up));
}

#[test]
#[should_panic(expected = "fetched blocks are executed up to their end; found block 1 of 2")]
fn fetched_blocks_that_were_not_executed_are_found() {
    let node = Node::new();
    let who = Who { id: 2, organisation: "Org1".into(), name: "node2".into(), vouched: false };
    let has = Holding { height: 2, first_height: 1, ..Holding::default() };
    let mut machine = CatchUp::new(Arc::clone(node.executor.ledger()), "Org1".into(), None, None);
    machine.step(Got::Offers(vec![Offer { who, has, peer: 2 }]));
    let block = Entry { index: 2, term: 1, kind: EntryKind::Normal, data: Bytes::new() };
    assert!(matches!(machine.step(Got::Blocks(Ok(Some(vec![block])))), Todo::More));
    assert!(matches!(machine.step(Got::Blocks(Ok(None))), Todo::TakeIn(_)));
    machine.step(Got::TakenIn(Ok(())));
}

#[test]
#[should_panic(expected = "each transaction of a block has one id and one verdict")]
fn a_block_with_a_verdict_too_few_is_found() {
    let node = Node::new();
    let block = Entry { index: 2, term: 1, kind: EntryKind::Normal, data: Bytes::new() };
    let mut outcome = node.executor.ledger().apply(&block).unwrap();
    outcome.transactions.push(Bytes::from_static(b"without a verdict"));
    node.waiters.resolve(&outcome, node.executor.ledger());
}
