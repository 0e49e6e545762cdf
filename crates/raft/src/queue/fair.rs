//! One lane: a bounded queue that is fair between the creators of what waits in it.
//!
//! Start-time fair queueing (Goyal, Vin, Cheng 1996). Everything gets a tag when it comes: where its creator's previous
//! transaction ends in virtual time, but not before what is taken now. Tags give the order. So the transactions of one
//! creator stay in their order, and those who send little pass those who send much. When the queue is full, the last in
//! order goes: it belongs to the creator with most waiting.

use super::{QueueStatus, Waiting};
use bytes::Bytes;
use ledger::block::{PAYLOAD_BYTES_MAX, TRANSACTIONS_MAX};
use ledger::transaction::claimed_creator;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use std::collections::BTreeMap;

/// The cost of executing a transaction beside its bytes, in bytes that cost about as much.
const TRANSACTION_COST_BYTES: usize = 256;
/// So many transactions may wait however long they do. After a stall of the disk or an election they are soon done,
/// while a longer queue of old ones delays what is new.
pub(super) const LATE_TRANSACTIONS_MAX: usize = 128;

/// One lane.
#[derive(Debug)]
pub(crate) struct Queue {
    /// In the order in which it will be taken.
    items: BTreeMap<Rank, Waiting>,
    /// Creators of what waits.
    creators: BTreeMap<Hash, Backlog>,
    /// Virtual time: the tag of what was taken last.
    reached: u64,
    /// Number of the next transaction.
    next: u64,
    bytes: usize,
    transactions_max: usize,
    bytes_max: usize,
}

/// A place in the order: by tag, then as they came.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Rank {
    tag: u64,
    number: u64,
}

/// The waiting transactions of one creator.
#[derive(Debug, Default)]
struct Backlog {
    transactions: usize,
    /// Where it ends in virtual time.
    end: u64,
}

impl Queue {
    pub(super) fn new(transactions_max: usize, bytes_max: usize) -> Self {
        Self {
            items: BTreeMap::new(),
            creators: BTreeMap::new(),
            reached: 0,
            next: 0,
            bytes: 0,
            transactions_max,
            bytes_max,
        }
    }

    /// Takes a transaction in. Answers with what is refused for it: itself, or others when it takes their place.
    pub(super) fn push(&mut self, waiting: Waiting) -> Vec<(Waiting, Rejection)> {
        let bytes = waiting.transaction.len();
        if bytes > PAYLOAD_BYTES_MAX {
            let reason = Rejection::new(Code::TooLarge, "transaction does not fit a block")
                .found(format!("{bytes} bytes"))
                .wanted(format!("at most {PAYLOAD_BYTES_MAX} bytes"))
                .next("split it");
            return vec![(waiting, reason)];
        }
        let creator = creator(&waiting.transaction);
        let tag = self.creators.get(&creator).map_or(self.reached, |backlog| backlog.end.max(self.reached));
        let mut refused = Vec::new();
        while self.items.len() >= self.transactions_max || self.bytes.saturating_add(bytes) > self.bytes_max {
            let reason = self.full();
            match self.items.last_key_value().map(|(place, _)| *place) {
                Some(last) if last.tag > tag => refused.extend(self.remove(last).map(|waiting| (waiting, reason))),
                _ => {
                    refused.push((waiting, reason));
                    return refused;
                }
            }
        }
        let backlog = self.creators.entry(creator).or_default();
        backlog.transactions += 1;
        backlog.end = tag + cost(&waiting.transaction) as u64;
        self.bytes += bytes;
        self.items.insert(Rank { tag, number: self.next }, waiting);
        self.next += 1;
        refused
    }

    /// Takes the first `count`.
    pub(crate) fn take(&mut self, count: usize) -> Vec<Waiting> {
        let mut taken = Vec::with_capacity(count.min(self.items.len()));
        while taken.len() < count
            && let Some((place, _)) = self.items.first_key_value()
        {
            let place = *place;
            self.reached = self.reached.max(place.tag);
            taken.extend(self.remove(place));
        }
        taken
    }

    /// Takes out what has waited longer than `wait_us_max` and would be taken next, as far as `cost_max` goes.
    pub(super) fn take_late(&mut self, now: u64, wait_us_max: u64, cost_max: usize) -> Vec<Waiting> {
        let mut spare = self.items.len().saturating_sub(LATE_TRANSACTIONS_MAX);
        let (mut spent, mut late) = (0, Vec::new());
        for (place, waiting) in &self.items {
            if spent >= cost_max || spare == 0 {
                break;
            }
            if now.saturating_sub(waiting.since) > wait_us_max {
                late.push(*place);
                spare -= 1;
            } else {
                spent += cost(&waiting.transaction);
            }
        }
        late.into_iter().filter_map(|place| self.remove(place)).collect()
    }

    /// How full it is.
    pub(crate) fn status(&self) -> QueueStatus {
        QueueStatus { transactions: self.items.len(), bytes: self.bytes }
    }

    pub(super) fn is_empty(&self) -> bool {
        self.items.is_empty()
    }

    pub(super) fn peek(&self, count: usize) -> impl Iterator<Item = Bytes> + '_ {
        self.items.values().take(count).map(|waiting| waiting.transaction.clone())
    }

    /// How many fit into a block that holds `transactions` with `bytes` already, with their bytes and cost: up to about
    /// `bytes_target`, and until `cost_max` is reached.
    pub(super) fn cut(&self, transactions: usize, bytes: usize, bytes_target: usize, cost_max: usize) -> Share {
        let mut share = Share::default();
        for waiting in self.items.values() {
            let count = transactions + share.transactions;
            let (before, more) = (bytes + share.bytes, waiting.transaction.len());
            let full = before >= bytes_target || before + more > bytes_target.max(more);
            if count >= TRANSACTIONS_MAX
                || share.cost >= cost_max
                || (count > 0 && (full || before + more > PAYLOAD_BYTES_MAX))
            {
                break;
            }
            share.transactions += 1;
            share.bytes += more;
            share.cost += cost(&waiting.transaction);
        }
        share
    }

    fn remove(&mut self, place: Rank) -> Option<Waiting> {
        let waiting = self.items.remove(&place)?;
        self.bytes -= waiting.transaction.len();
        let creator = creator(&waiting.transaction);
        if let Some(backlog) = self.creators.get_mut(&creator) {
            backlog.transactions -= 1;
            if backlog.end == place.tag + cost(&waiting.transaction) as u64 {
                // It was the creator's last: the next one follows what is left.
                backlog.end = place.tag;
            }
            if backlog.transactions == 0 {
                self.creators.remove(&creator);
            }
        }
        Some(waiting)
    }

    fn full(&self) -> Rejection {
        Rejection::new(Code::Overloaded, "too many transactions wait to be ordered")
            .found(format!("{} transactions, {} bytes", self.items.len(), self.bytes))
            .wanted(format!("at most {} transactions, {} bytes", self.transactions_max, self.bytes_max))
    }
}

/// A lane's part of a block.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Share {
    pub(super) transactions: usize,
    pub(super) bytes: usize,
    pub(super) cost: usize,
}

fn cost(transaction: &Bytes) -> usize {
    transaction.len() + TRANSACTION_COST_BYTES
}

/// Its creator. Bytes that are no transaction belong to an unknown creator, who is one creator like others.
fn creator(transaction: &Bytes) -> Hash {
    claimed_creator(transaction).unwrap_or_default()
}

#[cfg(test)]
#[expect(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]
mod tests {
    use super::*;

    /// An envelope of a body that names a creator, and says which of the creator's transactions it is.
    fn waiting(creator: u8, nth: u8, since: u64) -> Waiting {
        let body = [&[0x12, 32][..], &[creator; 32], &[0x1a, 1, nth]].concat();
        let envelope = [&[0x0a, u8::try_from(body.len()).unwrap()][..], &body].concat();
        Waiting { transaction: envelope.into(), origin: None, since }
    }

    fn names(waiting: &[Waiting]) -> Vec<(u8, u8)> {
        waiting.iter().map(|waiting| (waiting.transaction[4], *waiting.transaction.last().unwrap())).collect()
    }

    fn queue(transactions_max: usize) -> Queue {
        Queue::new(transactions_max, 1 << 20)
    }

    #[test]
    fn who_sends_little_passes_who_sends_much() {
        let mut queue = queue(1000);
        for nth in 0..100 {
            assert!(queue.push(waiting(1, nth, 0)).is_empty());
        }
        assert_eq!(names(&queue.take(2)), [(1, 0), (1, 1)]);
        assert!(queue.push(waiting(2, 0, 0)).is_empty());
        assert!(queue.push(waiting(2, 1, 0)).is_empty());
        assert_eq!(names(&queue.take(4)), [(2, 0), (1, 2), (2, 1), (1, 3)], "in turns, not behind the ninety-eight");
    }

    #[test]
    fn the_transactions_of_one_creator_stay_in_their_order() {
        let mut queue = queue(1000);
        for nth in 0..50 {
            for creator in 0..5 {
                if nth % (creator + 1) == 0 {
                    queue.push(waiting(creator, nth, 0));
                }
            }
        }
        let order = names(&queue.take(usize::MAX));
        for creator in 0..5 {
            let own: Vec<_> = order.iter().filter(|(who, _)| *who == creator).map(|(_, nth)| *nth).collect();
            assert!(own.is_sorted() && !own.is_empty(), "{own:?}");
        }
    }

    #[test]
    fn a_full_queue_refuses_whoever_has_most_waiting() {
        let mut queue = queue(10);
        for nth in 0..10 {
            queue.push(waiting(1, nth, 0));
        }
        let refused = queue.push(waiting(2, 0, 0));
        assert_eq!(refused[0].1.code, Code::Overloaded);
        let (refused, _): (Vec<_>, Vec<_>) = refused.into_iter().unzip();
        assert_eq!(names(&refused), [(1, 9)], "the newest of the one who fills the queue makes room");
        let (refused, _): (Vec<_>, Vec<_>) = queue.push(waiting(1, 10, 0)).into_iter().unzip();
        assert_eq!(names(&refused), [(1, 10)], "who fills it gets no more in");
        assert_eq!(queue.status().transactions, 10);
        // Until both have as much.
        for nth in 1..20 {
            queue.push(waiting(2, nth, 0));
        }
        let order = names(&queue.take(usize::MAX));
        assert_eq!(order.iter().filter(|(who, _)| *who == 2).count(), 5, "{order:?}");
    }

    #[test]
    fn what_waited_too_long_is_taken_out_unless_it_is_little() {
        let mut queue = queue(1000);
        let many = LATE_TRANSACTIONS_MAX + 10;
        for nth in 0..many {
            queue.push(waiting(1, u8::try_from(nth).unwrap(), 0));
        }
        queue.push(waiting(1, 200, 900));
        assert!(queue.take_late(1000, 1000, usize::MAX).is_empty(), "just in time");
        let late = queue.take_late(1001, 1000, usize::MAX);
        assert_eq!(late.len(), 11, "the others are soon done");
        assert_eq!(names(&late)[0], (1, 0), "the oldest");
        assert!(queue.take_late(1001, 1000, usize::MAX).is_empty());
    }

    #[test]
    fn an_empty_queue_remembers_nobody() {
        let mut queue = queue(1000);
        for creator in 0..100 {
            queue.push(waiting(creator, 0, 0));
        }
        queue.take(usize::MAX);
        assert!(queue.creators.is_empty() && queue.is_empty());
        assert_eq!(queue.status(), QueueStatus::default());
    }
}
