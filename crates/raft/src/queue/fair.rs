//! One lane: a bounded queue that is fair between organisations, and within each between the creators of what waits.
//!
//! Start-time fair queueing (Goyal, Vin, Cheng 1996) in two levels. An organisation has a tag: the virtual time at which its
//! first transaction begins. Each transaction that is taken of it moves the tag on by its cost. An organisation of which nothing waits begins where
//! the queue is, or where it has ended before, if that is later. The lowest tag is taken next, and within the organisation the creators are served in the same way
//! ([`Backlog`]). So thirty identities of one organisation get what one gets that is alone. When the queue is full, the last in
//! order goes: it belongs to the organisation with most waiting.

mod backlog;

use super::{Creators, QueueStatus, Waiting};
use backlog::{Backlog, cost, creator};
use bytes::Bytes;
use ledger::block::{PAYLOAD_BYTES_MAX, TRANSACTIONS_MAX};
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use std::collections::BTreeMap;

/// So many transactions may wait however long they do. After a stall of the disk or an election they are soon done,
/// while a longer queue of old ones delays what is new.
pub(super) const LATE_TRANSACTIONS_MAX: usize = 128;

/// One lane.
#[derive(Debug)]
pub(crate) struct Queue {
    creators: Creators,
    /// Organisations of what waits, by the hashes of their names; and those that have had more than the others just now.
    organisations: BTreeMap<Hash, Organisation>,
    /// Virtual time: the tag of what was taken last.
    reached: u64,
    /// Number of the next transaction.
    next: u64,
    transactions: usize,
    bytes: usize,
    transactions_max: usize,
    bytes_max: usize,
}

/// The waiting transactions of one organisation.
#[derive(Debug)]
struct Organisation {
    /// Where the first of them begins in virtual time.
    tag: u64,
    backlog: Backlog,
}

impl Organisation {
    /// Where the next one would begin in virtual time.
    fn end(&self) -> u64 {
        self.tag.saturating_add(self.backlog.cost())
    }
}

impl Queue {
    pub(super) fn new(transactions_max: usize, bytes_max: usize, creators: Creators) -> Self {
        Self {
            creators,
            organisations: BTreeMap::new(),
            reached: 0,
            next: 0,
            transactions: 0,
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
        let organisation = self.creators.organisation(&creator);
        let mut refused = Vec::new();
        while self.transactions >= self.transactions_max || self.bytes.saturating_add(bytes) > self.bytes_max {
            let reason = self.full();
            match self.make_room(&organisation, &creator) {
                Some(last) => refused.push((last, reason)),
                None => {
                    refused.push((waiting, reason));
                    return refused;
                }
            }
        }
        let begins = Organisation { tag: self.reached, backlog: Backlog::default() };
        let organisation = self.organisations.entry(organisation).or_insert(begins);
        if organisation.backlog.is_empty() {
            organisation.tag = organisation.tag.max(self.reached);
        }
        organisation.backlog.push(creator, self.next, waiting);
        self.next += 1;
        self.transactions += 1;
        self.bytes += bytes;
        refused
    }

    /// Takes out the last in order, if it would come after a new one of this creator.
    fn make_room(&mut self, of: &Hash, creator: &Hash) -> Option<Waiting> {
        let own = self.organisations.get(of).map_or(self.reached, Organisation::end);
        let waiting = self.organisations.iter().filter(|(_, organisation)| !organisation.backlog.is_empty());
        let (most, longest) = waiting.max_by_key(|(_, organisation)| organisation.end())?;
        let last = match most == of {
            true => longest.backlog.last_behind(creator)?,
            false => {
                let last = longest.backlog.last()?;
                // It begins where the organisation ends without it.
                let begins = longest.end().saturating_sub(longest.backlog.cost_of(&last));
                (begins > own).then_some(last)?
            }
        };
        let most = *most;
        self.remove(&most, last)
    }

    /// Takes the first `count`.
    pub(crate) fn take(&mut self, count: usize) -> Vec<Waiting> {
        let mut taken = Vec::with_capacity(count.min(self.transactions));
        while taken.len() < count
            && let Some((name, first)) = self.first()
        {
            if let Some(organisation) = self.organisations.get_mut(&name) {
                self.reached = self.reached.max(organisation.tag);
                organisation.tag = organisation.tag.saturating_add(organisation.backlog.cost_of(&first));
                organisation.backlog.reached(&first);
            }
            taken.extend(self.remove(&name, first));
        }
        self.forget();
        taken
    }

    /// The first in order, and its organisation.
    fn first(&self) -> Option<(Hash, backlog::Rank)> {
        let firsts = self.organisations.iter().filter_map(|(name, organisation)| {
            let first = organisation.backlog.first()?;
            Some((organisation.tag, first.number, *name, first))
        });
        firsts.min_by_key(|(tag, number, ..)| (*tag, *number)).map(|(_, _, name, first)| (name, first))
    }

    /// Takes out what has waited longer than `wait_us_max` and would be taken next, as far as `cost_max` goes.
    pub(super) fn take_late(&mut self, now: u64, wait_us_max: u64, cost_max: usize) -> Vec<Waiting> {
        let mut spare = self.transactions.saturating_sub(LATE_TRANSACTIONS_MAX);
        let (mut spent, mut late) = (0, Vec::new());
        for (name, place, waiting) in self.in_order() {
            if spent >= cost_max || spare == 0 {
                break;
            }
            if now.saturating_sub(waiting.since) > wait_us_max {
                late.push((name, place));
                spare -= 1;
            } else {
                spent += cost(&waiting.transaction);
            }
        }
        let late = late.into_iter().filter_map(|(name, place)| self.remove(&name, place)).collect();
        self.forget();
        late
    }

    /// Forgets organisations of which nothing waits, unless they have had more than the others of what is taken now.
    fn forget(&mut self) {
        let (reached, quiet) = (self.reached, self.transactions == 0);
        self.organisations
            .retain(|_, organisation| !organisation.backlog.is_empty() || (organisation.tag > reached && !quiet));
    }

    /// All that waits, in the order in which it will be taken.
    fn in_order(&self) -> InOrder<'_> {
        let heads = self.organisations.iter().filter_map(|(name, organisation)| {
            let mut rest = organisation.backlog.in_order();
            let first = rest.next()?;
            Some(Head { tag: organisation.tag, name: *name, first, rest })
        });
        InOrder { heads: heads.collect() }
    }

    /// How full it is.
    pub(crate) fn status(&self) -> QueueStatus {
        QueueStatus { transactions: self.transactions, bytes: self.bytes }
    }

    pub(super) fn is_empty(&self) -> bool {
        self.transactions == 0
    }

    pub(super) fn peek(&self, count: usize) -> impl Iterator<Item = Bytes> + '_ {
        self.in_order().take(count).map(|(_, _, waiting)| waiting.transaction.clone())
    }

    /// How many fit into a block that holds `transactions` with `bytes` already, with their bytes and cost: up to about
    /// `bytes_target`, and until `cost_max` is reached.
    pub(super) fn cut(&self, transactions: usize, bytes: usize, bytes_target: usize, cost_max: usize) -> Share {
        let mut share = Share::default();
        for (_, _, waiting) in self.in_order() {
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

    fn remove(&mut self, name: &Hash, place: backlog::Rank) -> Option<Waiting> {
        let organisation = self.organisations.get_mut(name)?;
        let waiting = organisation.backlog.remove(place)?;
        self.transactions -= 1;
        self.bytes -= waiting.transaction.len();
        Some(waiting)
    }

    fn full(&self) -> Rejection {
        Rejection::new(Code::Overloaded, "too many transactions wait to be ordered")
            .found(format!("{} transactions, {} bytes", self.transactions, self.bytes))
            .wanted(format!("at most {} transactions, {} bytes", self.transactions_max, self.bytes_max))
    }
}

/// The waiting transactions, in the order in which they will be taken. Nothing is taken.
struct InOrder<'a> {
    /// One for each organisation of which something is left.
    heads: Vec<Head<'a>>,
}

struct Head<'a> {
    /// Where the first begins in virtual time.
    tag: u64,
    name: Hash,
    first: (backlog::Rank, &'a Waiting),
    rest: backlog::Ordered<'a>,
}

impl<'a> Iterator for InOrder<'a> {
    type Item = (Hash, backlog::Rank, &'a Waiting);

    fn next(&mut self) -> Option<Self::Item> {
        let heads = self.heads.iter().enumerate();
        let (place, _) = heads.min_by_key(|(_, head)| (head.tag, head.first.0.number))?;
        let head = self.heads.get_mut(place)?;
        let (name, (rank, waiting)) = (head.name, head.first);
        match head.rest.next() {
            Some(next) => {
                head.first = next;
                head.tag = head.tag.saturating_add(cost(&waiting.transaction) as u64);
            }
            None => drop(self.heads.swap_remove(place)),
        }
        Some((name, rank, waiting))
    }
}

/// A lane's part of a block.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Share {
    pub(super) transactions: usize,
    pub(super) bytes: usize,
    pub(super) cost: usize,
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
        Queue::new(transactions_max, 1 << 20, Creators::default())
    }

    /// Creators 100 and above are of one organisation, and the others each of its own.
    fn with_a_crowd(transactions_max: usize) -> Queue {
        let organisation = |creator: &Hash| Some(if creator.0[0] >= 100 { Hash([255; 32]) } else { *creator });
        Queue::new(transactions_max, 1 << 20, Creators::new(organisation))
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
    fn thirty_creators_of_one_organisation_leave_half_to_the_one_of_another() {
        let mut queue = with_a_crowd(1000);
        for nth in 0..10 {
            for creator in 100..130 {
                queue.push(waiting(creator, nth, 0));
            }
        }
        for nth in 0..10 {
            queue.push(waiting(1, nth, 0));
        }
        let order = names(&queue.take(20));
        assert_eq!(order.iter().filter(|(who, _)| *who == 1).count(), 10, "{order:?}");
        let crowd: std::collections::BTreeSet<_> = order.iter().filter(|(who, _)| *who >= 100).collect();
        assert!(crowd.iter().all(|(_, nth)| *nth == 0) && crowd.len() == 10, "in turns within it, too: {order:?}");
    }

    #[test]
    fn creators_of_one_organisation_that_send_one_at_a_time_do_not_pass_another_one_again_and_again() {
        let mut queue = with_a_crowd(1000);
        for nth in 0..30 {
            queue.push(waiting(1, nth, 0));
        }
        let mut taken = Vec::new();
        for _ in 0..20 {
            for creator in 100..130 {
                queue.push(waiting(creator, 0, 0));
            }
            taken.extend(names(&queue.take(2)));
        }
        assert_eq!(taken.iter().filter(|(who, _)| *who == 1).count(), 20, "{taken:?}");
    }

    #[test]
    fn an_organisation_that_sends_much_one_at_a_time_gets_no_more_bytes_than_another() {
        let mut queue = with_a_crowd(1000);
        let large = |nth| {
            let mut large = waiting(1, nth, 0);
            large.transaction = [large.transaction.as_ref(), &[0; 3000]].concat().into();
            large
        };
        for nth in 0..100 {
            queue.push(waiting(100, nth, 0));
        }
        let (mut much, mut little) = (0, 0);
        queue.push(large(0));
        for _ in 0..50 {
            let taken = queue.take(1).remove(0).transaction;
            let bytes = cost(&taken);
            match bytes > 3000 {
                true => {
                    much += bytes;
                    queue.push(large(0));
                }
                false => little += bytes,
            }
        }
        assert!(much <= 2 * little, "{much} of one large at a time, {little} of many small ones");
    }

    #[test]
    fn a_full_queue_refuses_those_of_the_organisation_with_most_waiting() {
        let mut queue = with_a_crowd(10);
        for creator in 100..110 {
            queue.push(waiting(creator, 0, 0));
        }
        for nth in 0..20 {
            queue.push(waiting(1, nth, 0));
        }
        let order = names(&queue.take(usize::MAX));
        assert_eq!(order.iter().filter(|(who, _)| *who == 1).count(), 5, "{order:?}");
    }

    #[test]
    fn what_is_cut_and_looked_at_is_what_is_taken() {
        let mut queue = with_a_crowd(1000);
        for nth in 0..10 {
            for creator in [1, 100, 101, 2, 102] {
                if nth % 2 == 0 || creator > 2 {
                    queue.push(waiting(creator, nth, 0));
                }
            }
        }
        for count in [1, 3, 7, 100] {
            let looked_at: Vec<_> = queue.peek(count).collect();
            let taken: Vec<_> = queue.take(count).into_iter().map(|waiting| waiting.transaction).collect();
            assert_eq!(looked_at, taken);
        }
        assert_eq!(queue.status(), QueueStatus::default());
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
        assert!(queue.organisations.is_empty() && queue.is_empty());
        assert_eq!(queue.status(), QueueStatus::default());
    }
}
