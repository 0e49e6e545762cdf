//! Limits connections per name, for example per address or identity, and evicts the oldest.
//!
//! Every connection is accepted. Over a limit, the oldest one is closed: of the same name if that name has too many, else
//! of the name with the most. So a flood evicts itself.

use ledger_base::invariant;
use std::collections::{BTreeMap, HashMap};
use std::future::poll_fn;
use std::hash::Hash;
use std::pin::Pin;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll};
use tokio::sync::oneshot;

/// The slots of one kind of connection.
pub(crate) struct ConnectionLimiter<N> {
    /// Most of all names together.
    all_max: usize,
    /// Most of one name.
    each_max: usize,
    table: Mutex<Table<N>>,
}

struct Table<N> {
    /// By the order of arrival.
    slots: BTreeMap<u64, Slot<N>>,
    /// How many there are of each name.
    counts: HashMap<N, usize>,
    next: u64,
}

struct Slot<N> {
    name: N,
    /// Dropped, it ends the permit.
    _permit: oneshot::Sender<()>,
}

/// A slot, until it is dropped or evicted.
pub(crate) struct Permit<N: Clone + Eq + Hash> {
    limiter: Arc<ConnectionLimiter<N>>,
    number: u64,
    evicted: oneshot::Receiver<()>,
    over: bool,
}

impl<N: Clone + Eq + Hash> ConnectionLimiter<N> {
    /// With at most these numbers of slots, altogether and for each name.
    pub(crate) fn new(all_max: usize, each_max: usize) -> Arc<Self> {
        let table = Table { slots: BTreeMap::new(), counts: HashMap::new(), next: 0 };
        Arc::new(Self { all_max, each_max, table: Mutex::new(table) })
    }

    /// A permit for one of this name, and the name of the one that was evicted for it.
    pub(crate) fn enter(self: &Arc<Self>, name: N) -> (Permit<N>, Option<N>) {
        let mut table = self.lock();
        let leaves = match table.counts.get(&name).is_some_and(|count| *count >= self.each_max) {
            true => Some(name.clone()),
            false if table.slots.len() >= self.all_max => {
                table.counts.iter().max_by_key(|(_, count)| **count).map(|(most, _)| most.clone())
            }
            false => None,
        };
        let oldest = leaves
            .as_ref()
            .and_then(|leaves| table.slots.iter().find(|(_, slot)| slot.name == *leaves).map(|(number, _)| *number));
        if let Some(oldest) = oldest {
            table.remove(oldest);
        }
        let (permit, evicted) = oneshot::channel();
        let number = table.next;
        table.next += 1;
        *table.counts.entry(name.clone()).or_default() += 1;
        table.slots.insert(number, Slot { name, _permit: permit });
        let (slots, places) = (table.slots.len(), self.all_max.max(1));
        invariant!(slots <= places, "no more stand at the door than there are places", "{slots} of {places}");
        (Permit { limiter: Arc::clone(self), number, evicted, over: false }, leaves)
    }

    /// Tells all of these names to leave.
    pub(crate) fn end(&self, which: impl Fn(&N) -> bool) {
        let mut table = self.lock();
        let numbers: Vec<u64> =
            table.slots.iter().filter(|(_, slot)| which(&slot.name)).map(|(number, _)| *number).collect();
        numbers.into_iter().for_each(|number| table.remove(number));
    }

    fn lock(&self) -> MutexGuard<'_, Table<N>> {
        self.table.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl<N: Clone + Eq + Hash> Table<N> {
    fn remove(&mut self, number: u64) {
        let Some(slot) = self.slots.remove(&number) else { return };
        if let Some(count) = self.counts.get_mut(&slot.name) {
            *count -= 1;
            if *count == 0 {
                self.counts.remove(&slot.name);
            }
        }
    }
}

impl<N: Clone + Eq + Hash> Permit<N> {
    /// Ready once this one has to leave.
    pub(crate) fn poll_over(&mut self, context: &mut Context<'_>) -> Poll<()> {
        self.over = self.over || Pin::new(&mut self.evicted).poll(context).is_ready();
        if self.over { Poll::Ready(()) } else { Poll::Pending }
    }

    /// Waits until this one has to leave.
    pub(crate) async fn over(&mut self) {
        poll_fn(|context| self.poll_over(context)).await;
    }
}

impl<N: Clone + Eq + Hash> Drop for Permit<N> {
    fn drop(&mut self) {
        self.limiter.lock().remove(self.number);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use futures::FutureExt;

    fn is_over(permit: &mut Permit<&'static str>) -> bool {
        permit.over().now_or_never().is_some()
    }

    #[test]
    fn whoever_comes_too_often_pushes_out_its_own_oldest() {
        let limiter = ConnectionLimiter::new(10, 2);
        let (mut other, _) = limiter.enter("other");
        let (mut first, _) = limiter.enter("busy");
        let (mut second, left) = limiter.enter("busy");
        assert_eq!(left, None);
        let (mut third, left) = limiter.enter("busy");
        assert_eq!(left, Some("busy"));
        assert!(is_over(&mut first) && is_over(&mut first), "it is evicted as often as it asks");
        assert!(!is_over(&mut second) && !is_over(&mut third) && !is_over(&mut other));
    }

    #[test]
    fn where_all_places_are_taken_one_of_the_most_frequent_leaves() {
        let limiter = ConnectionLimiter::new(3, 3);
        let (mut rare, _) = limiter.enter("rare");
        let (mut first, _) = limiter.enter("busy");
        let (mut second, _) = limiter.enter("busy");
        let (mut new, left) = limiter.enter("new");
        assert_eq!(left, Some("busy"));
        assert!(is_over(&mut first));
        assert!(!is_over(&mut rare) && !is_over(&mut second) && !is_over(&mut new));
    }

    #[test]
    fn a_place_that_is_given_up_is_free_and_names_are_forgotten() {
        let limiter = ConnectionLimiter::new(2, 1);
        let (permit, _) = limiter.enter("one");
        drop(permit);
        let (_one, left) = limiter.enter("one");
        let (_two, left_again) = limiter.enter("two");
        assert_eq!((left, left_again), (None, None));
        assert_eq!(limiter.lock().counts.len(), 2);
        drop((_one, _two));
        assert!(limiter.lock().counts.is_empty() && limiter.lock().slots.is_empty());
    }

    #[test]
    fn all_of_a_name_can_be_told_to_leave() {
        let limiter = ConnectionLimiter::new(10, 10);
        let (mut gone, _) = limiter.enter("gone");
        let (mut stays, _) = limiter.enter("stays");
        limiter.end(|name| *name == "gone");
        assert!(is_over(&mut gone) && !is_over(&mut stays));
    }
}
