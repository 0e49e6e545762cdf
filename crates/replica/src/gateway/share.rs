//! Places: what one identity uses of a node at a time, so that nobody can use it up.
//!
//! A place is held from a transaction's arrival to its verdict. An identity holds at most as many as are free, so that there
//! are always some for others. The lanes count apart: who fills the data lane can still release.

use ledger_base::invariant;
use ledger_base::mutation::{Mutation, active};
use ledger_base::rejection::{Code, Rejection};
use ledger_raft::Lane;
use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError, Weak};

/// Most bytes of transactions of one identity and lane in flight.
const IN_FLIGHT_BYTES_MAX: usize = 64 * 1024 * 1024;

/// Urgent calls of one identity that overtake data, in a second; and how many may come at once. A bridge or a fleet's manager
/// renews hundreds of leases. Calls beyond that wait with the data, so that nobody can have everything done first.
const URGENT_PER_SECOND: u64 = 512;
const URGENT_AT_ONCE: u64 = 1024;

/// The places of a node and the identities that share them.
pub struct Shares {
    places: Arc<Places>,
    identities: Mutex<Identities>,
}

#[derive(Default)]
struct Identities {
    /// Number of the next identity.
    next: u64,
    known: HashMap<String, Weak<Share>>,
}

/// The places of a node.
struct Places {
    free: AtomicUsize,
    max: usize,
    /// The node stops.
    closed: AtomicBool,
}

/// The share of one identity; lives as long as one of its streams or transactions.
pub struct Share {
    name: String,
    number: u64,
    places: Arc<Places>,
    control: Used,
    data: Used,
    urgent: Mutex<Allowance>,
}

/// The rest of [`URGENT_AT_ONCE`], in millionths of a call.
struct Allowance {
    left: u64,
    /// Microseconds since the node started.
    since: u64,
}

impl Allowance {
    const FULL: u64 = URGENT_AT_ONCE * 1_000_000;

    /// One more call, if it is allowed.
    fn take(&mut self, elapsed: u64) -> bool {
        let more = elapsed.saturating_sub(self.since).saturating_mul(URGENT_PER_SECOND);
        self.since = self.since.max(elapsed);
        self.left = self.left.saturating_add(more).min(Self::FULL);
        let left = self.left.checked_sub(1_000_000);
        self.left = left.unwrap_or(self.left);
        left.is_some()
    }
}

/// The transactions of an identity in flight.
#[derive(Default)]
struct Used {
    transactions: AtomicUsize,
    bytes: AtomicUsize,
}

/// A place among the transactions in flight, until it is dropped.
pub struct InFlight {
    share: Arc<Share>,
    lane: Lane,
    bytes: usize,
}

impl Shares {
    /// So many transactions in flight.
    pub fn new(places_max: usize) -> Self {
        let (free, closed) = (AtomicUsize::new(places_max), AtomicBool::new(false));
        Self { places: Arc::new(Places { free, max: places_max, closed }), identities: Mutex::default() }
    }

    /// The share of an identity, e.g. `Org1/Salma`.
    pub fn of(&self, name: String) -> Arc<Share> {
        let mut identities = self.identities.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(share) = identities.known.get(&name).and_then(Weak::upgrade) {
            return share;
        }
        identities.known.retain(|_, share| share.strong_count() > 0);
        identities.next += 1;
        let share = Arc::new(Share {
            name: name.clone(),
            number: identities.next,
            places: Arc::clone(&self.places),
            control: Used::default(),
            data: Used::default(),
            urgent: Mutex::new(Allowance { left: Allowance::FULL, since: 0 }),
        });
        identities.known.insert(name, Arc::downgrade(&share));
        share
    }

    /// Transactions in flight.
    pub fn in_flight(&self) -> usize {
        self.places.max - self.places.free.load(Ordering::Relaxed)
    }

    /// The node stops: nobody gets a place any more.
    pub fn close(&self) {
        self.places.closed.store(true, Ordering::Relaxed);
    }
}

impl Share {
    /// The name of the identity, e.g. `Org1/Salma`.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Its number at this node, for [`crate::gateway::Turns`].
    pub fn number(&self) -> u64 {
        self.number
    }

    /// May one more urgent call overtake data, so long after the node's start (microseconds)? Then it is counted.
    pub(super) fn hurries(&self, elapsed: u64) -> bool {
        self.urgent.lock().unwrap_or_else(PoisonError::into_inner).take(elapsed)
    }

    /// How many transactions of a lane have a place.
    pub fn in_flight(&self, lane: Lane) -> usize {
        self.used(lane).transactions.load(Ordering::Relaxed)
    }

    /// A place for a transaction of so many bytes.
    ///
    /// # Errors
    /// [`Code::Overloaded`] beyond the identity's share, [`Code::ShuttingDown`].
    pub fn place(self: &Arc<Self>, lane: Lane, bytes: usize) -> Result<InFlight, Rejection> {
        let used = self.used(lane);
        let (transactions, held) = (used.transactions.load(Ordering::Relaxed), used.bytes.load(Ordering::Relaxed));
        let free = self.places.free.load(Ordering::Relaxed);
        if held > 0 && held.saturating_add(bytes) > IN_FLIGHT_BYTES_MAX {
            return Err(self
                .overloaded()
                .found(format!("{held} bytes without a verdict, and {bytes} more"))
                .wanted(format!("at most {IN_FLIGHT_BYTES_MAX} bytes of one identity")));
        }
        if self.places.closed.load(Ordering::Relaxed) {
            return Err(Rejection::new(Code::ShuttingDown, "the node is stopping"));
        }
        let within = transactions < free || active(Mutation::IgnoreTheShare);
        if !(within && self.places.take()) {
            let share = format!(
                "at most as many as there are places free, {free} of {} (limits.in_flight_max)",
                self.places.max
            );
            return Err(self.overloaded().found(format!("{transactions} without a verdict")).wanted(share));
        }
        used.transactions.fetch_add(1, Ordering::Relaxed);
        used.bytes.fetch_add(bytes, Ordering::Relaxed);
        Ok(InFlight { share: Arc::clone(self), lane, bytes })
    }

    fn overloaded(&self) -> Rejection {
        Rejection::new(Code::Overloaded, format!("{} has too much in flight at this node", self.name))
            .next("wait for verdicts before sending more; try again after 100 ms")
    }

    fn used(&self, lane: Lane) -> &Used {
        match lane {
            Lane::Control => &self.control,
            Lane::Data => &self.data,
        }
    }
}

impl Places {
    /// Takes one; false if there is none.
    fn take(&self) -> bool {
        self.free.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |free| free.checked_sub(1)).is_ok()
    }
}

impl InFlight {
    /// The name of the identity, e.g. `Org1/Salma`.
    pub fn name(&self) -> &str {
        &self.share.name
    }
}

impl Drop for InFlight {
    fn drop(&mut self) {
        let used = self.share.used(self.lane);
        let transactions = used.transactions.fetch_sub(1, Ordering::Relaxed);
        let bytes = used.bytes.fetch_sub(self.bytes, Ordering::Relaxed);
        invariant!(
            transactions > 0 && bytes >= self.bytes,
            "a share holds the places that come back",
            "{transactions} transactions of {bytes} bytes, one of {} comes back",
            self.bytes
        );
        let (free, max) = (self.share.places.free.fetch_add(1, Ordering::Relaxed), self.share.places.max);
        invariant!(free < max, "a place that comes back was taken", "{free} of {max} were free");
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    fn fill(share: &Arc<Share>, lane: Lane) -> Vec<InFlight> {
        std::iter::from_fn(|| share.place(lane, 100).ok()).collect()
    }

    #[test]
    fn one_identity_cannot_take_all_places() {
        let shares = Shares::new(120);
        let [flooder, second, third] = ["A/x", "A/y", "B/z"].map(|name| shares.of(name.into()));
        let floods = fill(&flooder, Lane::Data);
        assert_eq!(floods.len(), 60, "as many as are left");
        let refused = flooder.place(Lane::Data, 1).err().unwrap();
        assert_eq!(refused.code, Code::Overloaded);
        assert!(refused.to_string().contains("A/x") && refused.wanted.contains("in_flight_max"), "{refused}");
        let more = fill(&second, Lane::Data);
        assert_eq!(more.len(), 30);
        third.place(Lane::Data, 1).unwrap();
        drop(floods);
        assert_eq!(shares.in_flight(), 30, "places come back");
        flooder.place(Lane::Data, 1).unwrap();
    }

    #[test]
    fn who_fills_the_data_lane_can_still_release() {
        let shares = Shares::new(120);
        let flooder = shares.of("A/x".into());
        let _floods = fill(&flooder, Lane::Data);
        flooder.place(Lane::Control, 1).unwrap();
    }

    #[test]
    fn urgent_calls_of_one_identity_overtake_data_up_to_a_rate() {
        let shares = Shares::new(120);
        let [flooder, other] = ["A/x", "B/y"].map(|name| shares.of(name.into()));
        let hurrying = |share: &Share, elapsed: u64| (0..10_000).filter(|_| share.hurries(elapsed)).count() as u64;
        assert_eq!(hurrying(&flooder, 5_000_000), URGENT_AT_ONCE);
        assert_eq!(hurrying(&other, 5_000_000), URGENT_AT_ONCE, "each has its own");
        assert_eq!(hurrying(&flooder, 5_500_000), URGENT_PER_SECOND / 2);
        assert_eq!(hurrying(&flooder, 3_600_000_000), URGENT_AT_ONCE, "what was not used is not kept for ever");
    }

    #[test]
    fn an_identity_is_bounded_in_bytes_but_its_first_transaction_passes() {
        let shares = Shares::new(120);
        let share = shares.of("A/x".into());
        let first = share.place(Lane::Data, IN_FLIGHT_BYTES_MAX + 1).unwrap();
        assert_eq!(share.place(Lane::Data, 1).err().unwrap().code, Code::Overloaded);
        drop(first);
        share.place(Lane::Data, 1).unwrap();
    }

    #[test]
    fn the_share_of_who_is_gone_is_forgotten() {
        let shares = Shares::new(120);
        for number in 0..100 {
            drop(shares.of(number.to_string()));
        }
        assert!(shares.identities.lock().unwrap().known.len() <= 1);
    }

    #[test]
    fn a_node_that_stops_gives_no_places() {
        let shares = Shares::new(120);
        shares.close();
        assert_eq!(shares.of("A/x".into()).place(Lane::Control, 1).err().unwrap().code, Code::ShuttingDown);
    }

    #[test]
    #[should_panic(expected = "a share holds the places that come back")]
    fn a_place_that_comes_back_and_was_not_counted_is_found() {
        let share = Shares::new(120).of("A/x".into());
        let place = share.place(Lane::Data, 100).unwrap();
        share.used(Lane::Data).transactions.store(0, Ordering::Relaxed);
        drop(place);
    }

    #[test]
    #[should_panic(expected = "a place that comes back was taken; found 120 of 120 were free")]
    fn a_place_that_comes_back_twice_is_found() {
        let share = Shares::new(120).of("A/x".into());
        let place = share.place(Lane::Data, 100).unwrap();
        share.places.free.fetch_add(1, Ordering::Relaxed);
        drop(place);
    }
}
