//! Subscriptions: events from a height on, decided one by one whether this caller may read them.

use super::{NodeView, status};
use crate::blocks::Interest;
use ledger::identity::Identity;
use ledger::transaction::Transaction;
use ledger::{Bytes, Code, Hash, Outcome, Rejection};
use ledger_api::v1::{Delivery, EventRecord, SubscribeRequest};
use std::collections::HashSet;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;
use tokio::sync::mpsc;
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

/// Checks the request and starts delivering.
pub(super) fn start(
    node: Arc<NodeView>,
    reader: Arc<Identity>,
    request: SubscribeRequest,
) -> Result<ReceiverStream<Result<Delivery, Status>>, Status> {
    if request.subjects.len() > FILTER_MAX || request.names.len() > FILTER_MAX {
        return Err(status(
            &Rejection::new(Code::TooLarge, "subscription has too many filters")
                .found(format!("{} subjects and {} names", request.subjects.len(), request.names.len()))
                .wanted(format!("at most {FILTER_MAX} of each")),
        ));
    }
    if node.subscribers.load(Ordering::Relaxed) >= node.limits.subscribers_max {
        return Err(status(
            &Rejection::new(Code::Overloaded, "the node has as many subscribers as it accepts")
                .wanted(format!("at most {} (limits.subscribers_max)", node.limits.subscribers_max))
                .next("subscribe at another node"),
        ));
    }
    let next = match request.from_height {
        0 => node.ledger.tip().height + 1,
        height => height,
    };
    let heartbeat = match request.heartbeat_ms {
        0 => None,
        ms => Some(Duration::from_millis(ms.into()).max(HEARTBEAT_MIN)),
    };
    let (deliveries, stream) = mpsc::channel(WAITING_MAX);
    let counted = Counted::new(Arc::clone(&node.subscribers));
    let interest = node.blocks.interest(request.subjects.clone());
    let SubscribeRequest { chaincode, subjects, names, .. } = request;
    let wanted = Wanted { chaincode, subjects: subjects.into_iter().collect(), names: names.into_iter().collect() };
    let (sent, shown) = (Instant::now(), HashSet::new());
    let subscription =
        Subscription { node, reader, wanted, interest, next, deliveries, sent, shown, _counted: counted };
    tokio::spawn(subscription.run(heartbeat));
    Ok(ReceiverStream::new(stream))
}

/// Which events are delivered. What is empty admits all.
struct Wanted {
    chaincode: String,
    subjects: HashSet<String>,
    names: HashSet<String>,
}

struct Subscription {
    node: Arc<NodeView>,
    reader: Arc<Identity>,
    wanted: Wanted,
    /// Tells which blocks need not be looked at.
    interest: Interest,
    /// The next height to look at.
    next: u64,
    deliveries: mpsc::Sender<Result<Delivery, Status>>,
    /// When something was sent last.
    sent: Instant,
    /// Creators whose certificate this stream has shown.
    shown: HashSet<Hash>,
    _counted: Counted,
}

impl Subscription {
    async fn run(mut self, heartbeat: Option<Duration>) {
        loop {
            let going_on = match self.catch_up().await {
                // Also while blocks come, if nothing in them is wanted.
                Ok(true) if heartbeat.is_some_and(|period| self.sent.elapsed() >= period) => self.beat().await,
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
            let woken = async {
                match heartbeat {
                    Some(period) => drop(timeout_at(self.sent + period, self.interest.wait()).await),
                    None => self.interest.wait().await,
                }
            };
            tokio::select! {
                () = woken => {}
                () = self.deliveries.closed() => return,
            }
        }
    }

    /// Delivers what there is of concern in every block that was executed by now. False if the subscriber is gone.
    async fn catch_up(&mut self) -> Result<bool, Status> {
        let mut silent = 0;
        loop {
            // First the height, then the marks up to there: a block is marked before it counts as reached.
            let reached = self.node.blocks.height();
            let Some(first) = self.interest.take(reached) else {
                self.next = self.next.max(reached + 1);
                return Ok(true);
            };
            self.next = self.next.max(first);
            while self.next <= reached {
                let outcome = self.node.blocks.get(self.next).map_err(|fault| status(&fault))?;
                let delivery = outcome.and_then(|outcome| self.delivery(&outcome));
                self.next += 1;
                silent += 1;
                let sent = match delivery {
                    Some(delivery) => {
                        // A right that was revoked ends here, before anything of the block is shown.
                        self.node.check(&self.reader)?;
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

    /// The heartbeat: nothing was sent for a while. False if the subscriber is gone.
    async fn beat(&mut self) -> Result<bool, Status> {
        self.node.check(&self.reader)?;
        Ok(self.progress().await)
    }

    async fn progress(&mut self) -> bool {
        let delivery =
            Delivery { height: self.next.saturating_sub(1), time: self.node.ledger.tip().time, ..Delivery::default() };
        self.send(delivery).await
    }

    async fn send(&mut self, delivery: Delivery) -> bool {
        let there = self.deliveries.send(Ok(delivery)).await.is_ok();
        self.sent = Instant::now();
        there
    }

    /// What of a block this subscriber wants and may read.
    fn delivery(&mut self, outcome: &Outcome) -> Option<Delivery> {
        let wanted = outcome.events.iter().filter(|emitted| {
            let event = &emitted.event;
            let Wanted { chaincode, subjects, names } = &self.wanted;
            (chaincode.is_empty() || *chaincode == event.chaincode)
                && (subjects.is_empty() || subjects.contains(&event.subject))
                && (names.is_empty() || names.contains(&event.name))
                && self.node.ledger.may_read(&self.reader, event).is_ok()
        });
        let wanted: Vec<_> = wanted.cloned().collect();
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
            EventRecord {
                chaincode: emitted.event.chaincode,
                name: emitted.event.name,
                subject: emitted.event.subject,
                payload: emitted.event.payload,
                index: emitted.index.unwrap_or_default(),
                transaction,
                certificate,
            }
        });
        Some(Delivery {
            height: outcome.header.height,
            time: outcome.header.time,
            events: events.collect(),
            block_hash: outcome.hash.0.to_vec().into(),
        })
    }

    /// The creator's certificate, the first time that this stream shows the creator.
    fn certificate(&mut self, transaction: &Bytes) -> Bytes {
        if transaction.is_empty() {
            return Bytes::new();
        }
        let Ok(transaction) = Transaction::decode(transaction.clone()) else { return Bytes::new() };
        let creator = transaction.creator();
        if !self.shown.insert(creator) {
            return Bytes::new();
        }
        self.node.ledger.certificate(&creator).ok().flatten().unwrap_or_default()
    }
}

/// Counts a subscription while it lives.
struct Counted(Arc<AtomicU64>);

impl Counted {
    fn new(count: Arc<AtomicU64>) -> Self {
        count.fetch_add(1, Ordering::Relaxed);
        Self(count)
    }
}

impl Drop for Counted {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::Relaxed);
    }
}
