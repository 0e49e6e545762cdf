//! Subscriptions: events from a height on, decided one by one whether this caller may read them.
//!
//! A caller that asks for events that it may not read is refused, and one that loses the right is told so: silence
//! would look as if nothing happened.

use super::audience::Listener;
use super::{Audience, Questions, check, status};
use crate::clients::rejections::Rejections;
use crate::ordering::Ordering;
use crate::ordering::waiters::known_hash;
use crate::peers::Peers;
use crate::storage::blocks::Interest;
use bytes::Bytes;
use futures::FutureExt;
use ledger::Outcome;
use ledger::transaction::claimed_creator;
use ledger_api::v1::{Delivery, EventRecord, SubscribeRequest};
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::Identity;
use ledger_light::fact::Fact;
use ledger_replica::Foreseen;
use ledger_storage::result::Event;
use std::collections::{BTreeSet, HashSet};
use std::future::pending;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{broadcast, mpsc};
use tokio::time::{Instant, timeout_at};
use tokio_stream::wrappers::ReceiverStream;
use tonic::Status;

/// Deliveries that wait for a slow subscriber; beyond it the subscriber reads from the block store at its own pace.
const WAITING_MAX: usize = 64;
/// Shortest heartbeat.
const HEARTBEAT_MIN: Duration = Duration::from_millis(50);
/// Most subjects or names of a filter.
const FILTER_MAX: usize = 1024;
/// After this many blocks without a matching event, a subscriber that catches up is told how far it is.
const BLOCKS_PER_PROGRESS: u64 = 1024;
/// Most blocks whose hashes come with one delivery.
const HEADS_MAX: u64 = 1024;
/// A subscriber to whom nothing is sent learns at the latest after this that it may read no more.
const CHECK_EVERY: Duration = Duration::from_secs(1);

/// The subscriptions of a node.
pub(crate) struct Subscriptions {
    /// The ledger, its blocks, and readers that wait for a current state.
    pub ordering: Arc<Ordering>,
    /// The certified blocks, and whether the leader is reached.
    pub peers: Arc<Peers>,
    /// The identities that have subscriptions.
    pub audience: Arc<Audience>,
    /// Rejected calls.
    pub rejections: Arc<Rejections>,
    /// The turns to read.
    pub questions: Questions,
}

impl Subscriptions {
    /// Checks the request and starts delivering.
    pub(super) async fn start(
        self: &Arc<Self>,
        reader: Arc<Identity>,
        request: SubscribeRequest,
    ) -> Result<ReceiverStream<Result<Delivery, Status>>, Status> {
        if request.subjects.len() > FILTER_MAX || request.names.len() > FILTER_MAX {
            return Err(status(
                &Rejection::new(Code::TooLarge, "the subscription has too many filters")
                    .found(format!("{} subjects and {} names", request.subjects.len(), request.names.len()))
                    .wanted(format!("at most {FILTER_MAX} of each")),
            ));
        }
        let SubscribeRequest { from_height, chaincode, subjects, names, heartbeat_ms, early, proofs, heads } = request;
        let wanted = Wanted::new(chaincode, subjects, names);
        if let Err(refused) = self.may_follow(&reader, &wanted).await {
            return Err(self.refuse_reader(&reader, &wanted, &refused));
        }
        let listener = match self.audience.enter(&reader) {
            Ok(listener) => listener,
            Err(refused) => return Err(self.refuse_reader(&reader, &wanted, &refused)),
        };
        let next = match from_height {
            0 => self.ordering.storage.ledger.tip().height + 1,
            height => height,
        };
        let heartbeat = match heartbeat_ms {
            0 => None,
            ms => Some(Duration::from_millis(ms.into()).max(HEARTBEAT_MIN)),
        };
        let (deliveries, stream) = mpsc::channel(WAITING_MAX);
        let early = early.then(|| self.peers.early_stops.subscribe());
        let interest = self.ordering.storage.blocks.interest(wanted.subjects.clone());
        let (sent, checked, shown) = (Instant::now(), Instant::now(), HashSet::new());
        let subscription = Subscription {
            node: Arc::clone(self),
            reader,
            wanted,
            interest,
            early,
            proofs,
            heads: heads.then(|| next.saturating_sub(1)),
            next,
            deliveries,
            sent,
            checked,
            unread: false,
            shown,
            _place: listener,
        };
        tokio::spawn(subscription.run(heartbeat));
        Ok(ReceiverStream::new(stream))
    }

    /// May this reader follow that? A refusal stands on a state that has everything that was committed when it was asked.
    async fn may_follow(&self, reader: &Identity, wanted: &Wanted) -> Result<(), Rejection> {
        let Wanted { chaincode, subjects, names } = wanted;
        let ask = || self.ordering.storage.ledger.may_follow(reader, chaincode, subjects, names);
        if ask().is_ok() {
            return Ok(());
        }
        self.ordering.reads.reach().await?;
        ask()
    }

    /// Takes down that a subscription was refused or ended; the answer.
    fn refuse_reader(&self, reader: &Identity, wanted: &Wanted, refused: &Rejection) -> Status {
        let subject = wanted.subjects.join(", ");
        self.rejections.record_subscription(
            self.ordering.clock.now(),
            reader.id(),
            &wanted.chaincode,
            &subject,
            refused,
        );
        status(refused)
    }
}

/// Which events are delivered. An empty filter admits all.
struct Wanted {
    chaincode: String,
    /// Sorted, each once.
    subjects: Vec<String>,
    /// Sorted, each once.
    names: Vec<String>,
}

impl Wanted {
    fn new(chaincode: String, mut subjects: Vec<String>, mut names: Vec<String>) -> Self {
        for list in [&mut subjects, &mut names] {
            list.sort_unstable();
            list.dedup();
        }
        Self { chaincode, subjects, names }
    }

    fn admits(&self, event: &Event) -> bool {
        let listed = |list: &[String], name: &String| list.is_empty() || list.binary_search(name).is_ok();
        (self.chaincode.is_empty() || self.chaincode == event.chaincode)
            && listed(&self.subjects, &event.subject)
            && listed(&self.names, &event.name)
    }
}

struct Subscription {
    node: Arc<Subscriptions>,
    reader: Arc<Identity>,
    wanted: Wanted,
    /// Tells which blocks need not be looked at.
    interest: Interest,
    /// Calls of which it wants to hear before they are ordered, if it does.
    early: Option<broadcast::Receiver<Arc<Foreseen>>>,
    /// It wants proofs.
    proofs: bool,
    /// The height up to which it has received the hashes of blocks, if it wants them.
    heads: Option<u64>,
    /// The next height to look at.
    next: u64,
    deliveries: mpsc::Sender<Result<Delivery, Status>>,
    /// When something was sent last.
    sent: Instant,
    /// When it was last made sure that the subscriber may read.
    checked: Instant,
    /// Something was wanted that the subscriber may not read.
    unread: bool,
    /// Creators whose certificate this stream has shown.
    shown: HashSet<Hash>,
    _place: Listener,
}

impl Subscription {
    async fn run(mut self, heartbeat: Option<Duration>) {
        // Before any message of the stream: a robot takes none that a stop without a verdict forbids.
        if !self.tell_early(None).await {
            return;
        }
        loop {
            let going_on = match self.catch_up().await {
                Ok(true) => match self.check() {
                    // Also while blocks come, if nothing in them is wanted.
                    Ok(()) if heartbeat.is_some_and(|period| self.sent.elapsed() >= period) => {
                        Ok(self.progress().await)
                    }
                    checked => checked.map(|()| true),
                },
                going_on => going_on,
            };
            match going_on {
                Ok(true) => {}
                Ok(false) => return,
                Err(reason) => {
                    let _gone = self.deliveries.send(Err(reason)).await;
                    return;
                }
            }
            let check = self.checked + CHECK_EVERY;
            let due = heartbeat.map_or(check, |period| check.min(self.sent + period));
            tokio::select! {
                biased;
                () = self.deliveries.closed() => return,
                foreseen = foreseen(&mut self.early) => {
                    if !self.tell_early(foreseen).await {
                        return;
                    }
                }
                _ = timeout_at(due, self.interest.wait()) => {}
            }
        }
    }

    /// Delivers what there is of concern in every block that was executed by now. False if the subscriber is gone.
    async fn catch_up(&mut self) -> Result<bool, Status> {
        let mut silent = 0;
        loop {
            // First the height, then the marks up to there: a block is marked before it counts as reached.
            let reached = self.node.ordering.storage.blocks.height();
            let Some(first) = self.interest.take(reached) else {
                self.next = self.next.max(reached + 1);
                return Ok(true);
            };
            self.next = self.next.max(first);
            while self.next <= reached {
                while let Some(foreseen) = foreseen(&mut self.early).now_or_never() {
                    if !self.tell_early(foreseen).await {
                        return Ok(false);
                    }
                }
                let outcome = match self.node.ordering.storage.blocks.recent(self.next) {
                    Some(outcome) => Some(outcome),
                    None => {
                        let _turn = self.node.questions.turn(&self.reader).await;
                        self.node.ordering.storage.blocks.get(self.next).map_err(|fault| status(&fault))?
                    }
                };
                let certified = self.proofs && outcome.as_ref().is_some_and(|outcome| outcome.certifiable.is_some());
                let delivery = outcome.and_then(|outcome| self.delivery(&outcome));
                self.next += 1;
                silent += 1;
                let sent = match delivery {
                    Some(mut delivery) => {
                        if certified {
                            delivery.proof = self.proof(&delivery).await?;
                        }
                        // A right that was revoked ends here, before anything of the block is shown.
                        check(&self.reader, &self.node.ordering)?;
                        silent = 0;
                        self.send(delivery).await
                    }
                    None if silent == BLOCKS_PER_PROGRESS => {
                        silent = 0;
                        self.progress().await
                    }
                    None => true,
                };
                if !sent {
                    return Ok(false);
                }
            }
        }
    }

    /// Makes sure, now and then and whenever something could not be shown, that the subscriber may still read.
    fn check(&mut self) -> Result<(), Status> {
        if !std::mem::take(&mut self.unread) && self.checked.elapsed() < CHECK_EVERY {
            return Ok(());
        }
        self.checked = Instant::now();
        check(&self.reader, &self.node.ordering)?;
        let Wanted { chaincode, subjects, names } = &self.wanted;
        let may = self.node.ordering.storage.ledger.may_follow(&self.reader, chaincode, subjects, names);
        may.map_err(|refused| self.node.refuse_reader(&self.reader, &self.wanted, &refused))
    }

    /// Tells how far this node is. False if the subscriber is gone.
    async fn progress(&mut self) -> bool {
        // Who waits for a height that is yet to come has not seen what is before it.
        let height = self.next.saturating_sub(1).min(self.node.ordering.storage.blocks.height());
        let tip = self.node.ordering.storage.ledger.tip();
        let block_hash = if tip.height == height { tip.hash.0.to_vec().into() } else { Bytes::new() };
        self.send(Delivery { height, time: tip.time, block_hash, ..Delivery::default() }).await
    }

    async fn send(&mut self, mut delivery: Delivery) -> bool {
        if !delivery.early {
            delivery.heads = self.heads_until(delivery.height);
        }
        let there = self.deliveries.send(Ok(delivery)).await.is_ok();
        self.sent = Instant::now();
        there
    }

    /// The hashes of the blocks since the last delivery, as far as they are at hand.
    fn heads_until(&mut self, height: u64) -> Bytes {
        let Some(told) = &mut self.heads else { return Bytes::new() };
        let from = told.saturating_add(1).max(height.saturating_sub(HEADS_MAX - 1)).max(1);
        *told = height.max(*told);
        let mut heads = Vec::new();
        for outcome in (from..=height).map(|height| self.node.ordering.storage.blocks.recent(height)) {
            match outcome {
                Some(outcome) => heads.extend_from_slice(&known_hash(&outcome.hash)),
                // Only those behind it are without a gap.
                None => heads.clear(),
            }
        }
        heads.into()
    }

    /// Tells of a call that is not ordered yet; of all of them, if it is not said which one. False if the subscriber is gone.
    async fn tell_early(&mut self, foreseen: Option<Arc<Foreseen>>) -> bool {
        let open = match foreseen {
            Some(foreseen) => vec![foreseen],
            None if self.early.is_some() => self.node.peers.early_stops.open_calls(),
            None => Vec::new(),
        };
        for foreseen in open {
            if !self.tell_of(&foreseen).await {
                return false;
            }
        }
        true
    }

    async fn tell_of(&mut self, foreseen: &Foreseen) -> bool {
        let wanted = foreseen.events.iter().filter(|event| self.wanted.admits(event));
        let readable = wanted.filter(|event| self.node.ordering.storage.ledger.may_read(&self.reader, event).is_ok());
        let mut transaction = foreseen.transaction.encoded().clone();
        let events: Vec<_> =
            readable.map(|event| record(event.clone(), (0, std::mem::take(&mut transaction)), Bytes::new())).collect();
        if events.is_empty() {
            return true;
        }
        let tip = self.node.ordering.storage.ledger.tip();
        self.send(Delivery { height: tip.height, time: tip.time, events, early: true, ..Delivery::default() }).await
    }

    /// The events of a block that this subscriber wants and may read.
    fn delivery(&mut self, outcome: &Outcome) -> Option<Delivery> {
        let wanted = outcome.events.iter().filter(|emitted| self.wanted.admits(&emitted.event));
        let (wanted, unread): (Vec<_>, Vec<_>) = wanted
            .partition(|emitted| self.node.ordering.storage.ledger.may_read(&self.reader, &emitted.event).is_ok());
        self.unread |= !unread.is_empty();
        let wanted: Vec<_> = wanted.into_iter().cloned().collect();
        if wanted.is_empty() {
            return None;
        }
        let mut last = None;
        let events = wanted.into_iter().map(|emitted| {
            // A transaction with several events is sent with the first of them.
            let transaction = match emitted.index {
                Some(index) if last != Some(index) => {
                    outcome.transactions.get(index as usize).cloned().unwrap_or_default()
                }
                _ => Bytes::new(),
            };
            last = emitted.index;
            let certificate = self.certificate(&transaction);
            record(emitted.event, (emitted.index.unwrap_or_default(), transaction), certificate)
        });
        Some(Delivery {
            height: outcome.header.height,
            time: outcome.header.time,
            events: events.collect(),
            block_hash: outcome.hash.0.to_vec().into(),
            early: false,
            proof: Bytes::new(),
            heads: Bytes::new(),
        })
    }

    /// A proof of these events; empty if there is none.
    async fn proof(&self, delivery: &Delivery) -> Result<Bytes, Status> {
        let shown: BTreeSet<_> = delivery
            .events
            .iter()
            .map(|EventRecord { chaincode, name, subject, payload, .. }| {
                (chaincode.as_str(), name.as_str(), subject.as_str(), Hash::of(&[payload]))
            })
            .collect();
        let wanted = |fact: &Fact<'_>| match fact {
            Fact::Event { chaincode, name, subject, payload, .. } => {
                shown.contains(&(*chaincode, *name, *subject, *payload))
            }
            _ => false,
        };
        let proof =
            self.node.peers.certificates.prove(&self.node.ordering.storage.ledger, delivery.height, wanted).await;
        let proof = proof.map_err(|fault| status(&fault))?;
        Ok(proof.map(|proof| proof.to_bytes()).unwrap_or_default())
    }

    /// The creator's certificate, the first time that this stream shows the creator.
    fn certificate(&mut self, transaction: &Bytes) -> Bytes {
        if transaction.is_empty() {
            return Bytes::new();
        }
        let Some(creator) = claimed_creator(transaction) else { return Bytes::new() };
        if !self.shown.insert(creator) {
            return Bytes::new();
        }
        self.node.ordering.storage.ledger.certificate(&creator).ok().flatten().unwrap_or_default()
    }
}

/// An event as it is delivered, with the transaction that caused it.
fn record(event: Event, (index, transaction): (u32, Bytes), certificate: Bytes) -> EventRecord {
    let Event { chaincode, name, subject, payload } = event;
    EventRecord { chaincode, name, subject, payload, index, transaction, certificate }
}

/// The next call that is sent before it is ordered; none if some were missed. Waits permanently where they were not asked for. Cancelling
/// it loses nothing.
async fn foreseen(early: &mut Option<broadcast::Receiver<Arc<Foreseen>>>) -> Option<Arc<Foreseen>> {
    let Some(calls) = early else { return pending().await };
    match calls.recv().await {
        Ok(foreseen) => Some(foreseen),
        Err(broadcast::error::RecvError::Lagged(_)) => None,
        Err(broadcast::error::RecvError::Closed) => pending().await,
    }
}
