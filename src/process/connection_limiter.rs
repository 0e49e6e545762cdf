//! The places at the door and behind it. Each kind has a limit, so that nobody keeps the others out.
//!
//! Everybody is let in. If that is one too many, the one that has stood there longest leaves. It is one of the same name if
//! that name has too many, and else one of the name with the most. So somebody who crowds in pushes itself out.

use ledger_base::invariant;
use std::collections::{BTreeMap, HashMap};
use std::future::poll_fn;
use std::hash::Hash;
use std::pin::Pin;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll};
use tokio::sync::oneshot;

/// The places of one kind.
pub(crate) struct Crowd<N> {
    /// Most of all names together.
    all_max: usize,
    /// Most of one name.
    each_max: usize,
    standing: Mutex<Standing<N>>,
}

struct Standing<N> {
    /// By the number of its coming.
    guests: BTreeMap<u64, Guest<N>>,
    /// How many there are of each name.
    counts: HashMap<N, usize>,
    next: u64,
}

struct Guest<N> {
    name: N,
    /// Dropped, it tells the guest to leave.
    _stay: oneshot::Sender<()>,
}

/// A place, until it is dropped.
pub(crate) struct Stay<N: Clone + Eq + Hash> {
    crowd: Arc<Crowd<N>>,
    number: u64,
    told: oneshot::Receiver<()>,
    over: bool,
}

impl<N: Clone + Eq + Hash> Crowd<N> {
    /// So many at most together, and of each name.
    pub(crate) fn new(all_max: usize, each_max: usize) -> Arc<Self> {
        let standing = Standing { guests: BTreeMap::new(), counts: HashMap::new(), next: 0 };
        Arc::new(Self { all_max, each_max, standing: Mutex::new(standing) })
    }

    /// A place for one of this name, and the name of the one that leaves for it.
    pub(crate) fn enter(self: &Arc<Self>, name: N) -> (Stay<N>, Option<N>) {
        let mut standing = self.lock();
        let leaves = match standing.counts.get(&name).is_some_and(|count| *count >= self.each_max) {
            true => Some(name.clone()),
            false if standing.guests.len() >= self.all_max => {
                standing.counts.iter().max_by_key(|(_, count)| **count).map(|(most, _)| most.clone())
            }
            false => None,
        };
        let oldest = leaves.as_ref().and_then(|leaves| {
            standing.guests.iter().find(|(_, guest)| guest.name == *leaves).map(|(number, _)| *number)
        });
        if let Some(oldest) = oldest {
            standing.remove(oldest);
        }
        let (stay, told) = oneshot::channel();
        let number = standing.next;
        standing.next += 1;
        *standing.counts.entry(name.clone()).or_default() += 1;
        standing.guests.insert(number, Guest { name, _stay: stay });
        let (guests, places) = (standing.guests.len(), self.all_max.max(1));
        invariant!(guests <= places, "no more stand at the door than there are places", "{guests} of {places}");
        (Stay { crowd: Arc::clone(self), number, told, over: false }, leaves)
    }

    /// Tells all of these names to leave.
    pub(crate) fn end(&self, which: impl Fn(&N) -> bool) {
        let mut standing = self.lock();
        let numbers: Vec<u64> =
            standing.guests.iter().filter(|(_, guest)| which(&guest.name)).map(|(number, _)| *number).collect();
        numbers.into_iter().for_each(|number| standing.remove(number));
    }

    fn lock(&self) -> MutexGuard<'_, Standing<N>> {
        self.standing.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl<N: Clone + Eq + Hash> Standing<N> {
    fn remove(&mut self, number: u64) {
        let Some(guest) = self.guests.remove(&number) else { return };
        if let Some(count) = self.counts.get_mut(&guest.name) {
            *count -= 1;
            if *count == 0 {
                self.counts.remove(&guest.name);
            }
        }
    }
}

impl<N: Clone + Eq + Hash> Stay<N> {
    /// Ready once this one has to leave.
    pub(crate) fn poll_over(&mut self, context: &mut Context<'_>) -> Poll<()> {
        self.over = self.over || Pin::new(&mut self.told).poll(context).is_ready();
        if self.over { Poll::Ready(()) } else { Poll::Pending }
    }

    /// Waits until this one has to leave.
    pub(crate) async fn over(&mut self) {
        poll_fn(|context| self.poll_over(context)).await;
    }
}

impl<N: Clone + Eq + Hash> Drop for Stay<N> {
    fn drop(&mut self) {
        self.crowd.lock().remove(self.number);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use futures::FutureExt;

    fn is_over(stay: &mut Stay<&'static str>) -> bool {
        stay.over().now_or_never().is_some()
    }

    #[test]
    fn whoever_comes_too_often_pushes_out_its_own_oldest() {
        let crowd = Crowd::new(10, 2);
        let (mut other, _) = crowd.enter("other");
        let (mut first, _) = crowd.enter("busy");
        let (mut second, left) = crowd.enter("busy");
        assert_eq!(left, None);
        let (mut third, left) = crowd.enter("busy");
        assert_eq!(left, Some("busy"));
        assert!(is_over(&mut first) && is_over(&mut first), "it is told as often as it asks");
        assert!(!is_over(&mut second) && !is_over(&mut third) && !is_over(&mut other));
    }

    #[test]
    fn where_all_places_are_taken_one_of_the_most_frequent_leaves() {
        let crowd = Crowd::new(3, 3);
        let (mut rare, _) = crowd.enter("rare");
        let (mut first, _) = crowd.enter("busy");
        let (mut second, _) = crowd.enter("busy");
        let (mut new, left) = crowd.enter("new");
        assert_eq!(left, Some("busy"));
        assert!(is_over(&mut first));
        assert!(!is_over(&mut rare) && !is_over(&mut second) && !is_over(&mut new));
    }

    #[test]
    fn a_place_that_is_given_up_is_free_and_names_are_forgotten() {
        let crowd = Crowd::new(2, 1);
        let (stay, _) = crowd.enter("one");
        drop(stay);
        let (_one, left) = crowd.enter("one");
        let (_two, left_again) = crowd.enter("two");
        assert_eq!((left, left_again), (None, None));
        assert_eq!(crowd.lock().counts.len(), 2);
        drop((_one, _two));
        assert!(crowd.lock().counts.is_empty() && crowd.lock().guests.is_empty());
    }

    #[test]
    fn all_of_a_name_can_be_told_to_leave() {
        let crowd = Crowd::new(10, 10);
        let (mut gone, _) = crowd.enter("gone");
        let (mut stays, _) = crowd.enter("stays");
        crowd.end(|name| *name == "gone");
        assert!(is_over(&mut gone) && !is_over(&mut stays));
    }
}
