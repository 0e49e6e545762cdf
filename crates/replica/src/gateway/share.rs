//! Places: the part of a node that one identity and one organisation use at a time, so that none uses it up.
//!
//! A place is held from a transaction's arrival to its verdict. The identities of an organisation together hold at most as
//! many as are free, so that there are always some for other organisations. One identity holds at most as many as its
//! organisation may still take, so that there are some for the others of it. The lanes count apart: who fills the data lane
//! can still release.

use super::turns::Applicant;
use ledger_base::invariant;
use ledger_base::mutation::{Mutation, active};
use ledger_base::rejection::{Code, Rejection};
use ledger_raft::Lane;
use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError, Weak};

/// Most bytes of transactions of one organisation and lane in flight. One identity has at most as many as are left of it,
/// which is half if it is alone.
const IN_FLIGHT_BYTES_MAX: usize = 128 * 1024 * 1024;

/// Urgent calls of one identity that overtake data, in a second; and how many may come at once. A bridge or a fleet's manager
/// renews hundreds of leases. Calls beyond that wait with the data, so that nobody can have everything done first.
const URGENT_PER_SECOND: u64 = 512;
const URGENT_AT_ONCE: u64 = 1024;
/// The identities of an organisation together have N times the urgent calls of one.
const URGENT_OF_ORGANISATION: u64 = 4;

/// The places of a node and the identities that share them.
pub struct Shares {
    places: Arc<Places>,
    identities: Mutex<Identities>,
}

#[derive(Default)]
struct Identities {
    /// Number of the next identity or organisation.
    next: u64,
    known: HashMap<String, Weak<Share>>,
    organisations: HashMap<String, Weak<Organisation>>,
}

/// The share of one organisation; lives as long as that of one of its identities.
struct Organisation {
    number: u64,
    control: Used,
    data: Used,
    urgent: Mutex<Allowance>,
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
    organisation: Arc<Organisation>,
    places: Arc<Places>,
    control: Used,
    data: Used,
    urgent: Mutex<Allowance>,
}

/// The rest of the urgent calls that may come at once, in millionths of a call.
struct Allowance {
    left: u64,
    /// Of how many identities.
    of: u64,
    /// Microseconds since the node started.
    since: u64,
}

impl Allowance {
    /// That of N identities.
    fn full(of: u64) -> Mutex<Self> {
        Mutex::new(Self { left: of * URGENT_AT_ONCE * 1_000_000, of, since: 0 })
    }

    /// One more call, if it is allowed.
    fn take(&mut self, elapsed: u64) -> bool {
        let more = elapsed.saturating_sub(self.since).saturating_mul(self.of * URGENT_PER_SECOND);
        self.since = self.since.max(elapsed);
        self.left = self.left.saturating_add(more).min(self.of * URGENT_AT_ONCE * 1_000_000);
        let left = self.left.checked_sub(1_000_000);
        self.left = left.unwrap_or(self.left);
        left.is_some()
    }
}

/// The transactions in flight of an identity, or of all of an organisation.
#[derive(Default)]
struct Used {
    transactions: AtomicUsize,
    bytes: AtomicUsize,
}

/// [`Used`] at one moment.
struct InUse {
    transactions: usize,
    bytes: usize,
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
        let organisation = identities.organisation(&name);
        identities.next += 1;
        let share = Arc::new(Share {
            name: name.clone(),
            number: identities.next,
            organisation,
            places: Arc::clone(&self.places),
            control: Used::default(),
            data: Used::default(),
            urgent: Allowance::full(1),
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

impl Identities {
    /// The organisation of an identity of this name.
    fn organisation(&mut self, identity: &str) -> Arc<Organisation> {
        let name = identity.split_once('/').map_or(identity, |(organisation, _)| organisation);
        if let Some(organisation) = self.organisations.get(name).and_then(Weak::upgrade) {
            return organisation;
        }
        self.organisations.retain(|_, organisation| organisation.strong_count() > 0);
        self.next += 1;
        let organisation = Arc::new(Organisation {
            number: self.next,
            control: Used::default(),
            data: Used::default(),
            urgent: Allowance::full(URGENT_OF_ORGANISATION),
        });
        self.organisations.insert(name.to_owned(), Arc::downgrade(&organisation));
        organisation
    }
}

impl Share {
    /// The name of the identity, e.g. `Org1/Salma`.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Its number at this node and that of its organisation, for [`crate::gateway::Turns`].
    pub fn applicant(&self) -> Applicant {
        Applicant { organisation: self.organisation.number, identity: self.number }
    }

    /// May one more urgent call overtake data, so long after the node's start (microseconds)? Then it is counted.
    pub(super) fn hurries(&self, elapsed: u64) -> bool {
        let take = |urgent: &Mutex<Allowance>| urgent.lock().unwrap_or_else(PoisonError::into_inner).take(elapsed);
        take(&self.urgent) && take(&self.organisation.urgent)
    }

    /// How many transactions of a lane have a place.
    pub fn in_flight(&self, lane: Lane) -> usize {
        self.used(lane).transactions.load(Ordering::Relaxed)
    }

    /// How many transactions of a lane have a place, of all identities of its organisation.
    pub fn in_flight_of_organisation(&self, lane: Lane) -> usize {
        self.organisation.used(lane).transactions.load(Ordering::Relaxed)
    }

    /// A place for a transaction of so many bytes.
    ///
    /// # Errors
    /// [`Code::Overloaded`] beyond the share of the identity or of its organisation, [`Code::ShuttingDown`].
    pub fn place(self: &Arc<Self>, lane: Lane, bytes: usize) -> Result<InFlight, Rejection> {
        let (used, together) = (self.used(lane), self.organisation.used(lane));
        let (own, all) = (used.read(), together.read());
        let free = self.places.free.load(Ordering::Relaxed);
        let bytes_left = IN_FLIGHT_BYTES_MAX.saturating_sub(all.bytes);
        if own.bytes > 0 && own.bytes.saturating_add(bytes) > bytes_left {
            return Err(self
                .overloaded()
                .found(format!("{} bytes without a verdict, and {bytes} more", own.bytes))
                .wanted(format!(
                    "at most {bytes_left} bytes, as its organisation has {} of {IN_FLIGHT_BYTES_MAX} in flight",
                    all.bytes
                )));
        }
        if self.places.closed.load(Ordering::Relaxed) {
            return Err(Rejection::new(Code::ShuttingDown, "the node is stopping"));
        }
        let left = free.saturating_sub(all.transactions);
        let within = own.transactions < left || active(Mutation::IgnoreTheShare);
        if !(within && self.places.take()) {
            return Err(self.overloaded().found(format!("{} without a verdict", own.transactions)).wanted(format!(
                "at most {left}: its organisation, with {} in flight, may have as many as there are free slots, \
                 {free} of {} (limits.in_flight_max)",
                all.transactions, self.places.max
            )));
        }
        used.add(bytes);
        together.add(bytes);
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

impl Organisation {
    fn used(&self, lane: Lane) -> &Used {
        match lane {
            Lane::Control => &self.control,
            Lane::Data => &self.data,
        }
    }
}

impl Used {
    fn read(&self) -> InUse {
        let (transactions, bytes) = (self.transactions.load(Ordering::Relaxed), self.bytes.load(Ordering::Relaxed));
        InUse { transactions, bytes }
    }

    fn add(&self, bytes: usize) {
        self.transactions.fetch_add(1, Ordering::Relaxed);
        self.bytes.fetch_add(bytes, Ordering::Relaxed);
    }

    fn remove(&self, bytes: usize) {
        let had = InUse {
            transactions: self.transactions.fetch_sub(1, Ordering::Relaxed),
            bytes: self.bytes.fetch_sub(bytes, Ordering::Relaxed),
        };
        invariant!(
            had.transactions > 0 && had.bytes >= bytes,
            "a share holds the places that come back",
            "{} transactions of {} bytes, one of {bytes} comes back",
            had.transactions,
            had.bytes
        );
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
        self.share.used(self.lane).remove(self.bytes);
        self.share.organisation.used(self.lane).remove(self.bytes);
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
    fn one_identity_cannot_take_all_places_nor_those_of_its_organisation() {
        let shares = Shares::new(120);
        let [flooder, second, third] = ["A/x", "A/y", "B/z"].map(|name| shares.of(name.into()));
        let floods = fill(&flooder, Lane::Data);
        assert_eq!(floods.len(), 40, "as many as are left to others, of them and of its own");
        let refused = flooder.place(Lane::Data, 1).err().unwrap();
        assert_eq!(refused.code, Code::Overloaded);
        assert!(refused.to_string().contains("A/x") && refused.wanted.contains("in_flight_max"), "{refused}");
        let more = fill(&second, Lane::Data);
        assert_eq!(more.len(), 14);
        third.place(Lane::Data, 1).unwrap();
        drop(floods);
        assert_eq!(shares.in_flight(), 14, "places come back");
        flooder.place(Lane::Data, 1).unwrap();
    }

    #[test]
    fn thirty_identities_of_one_organisation_leave_half_of_the_places_to_another() {
        let shares = Shares::new(1200);
        let crowd: Vec<_> = (0..30).map(|number| shares.of(format!("A/{number}"))).collect();
        let floods: Vec<_> = crowd.iter().flat_map(|share| fill(share, Lane::Data)).collect();
        assert!(floods.len() <= 600, "{}", floods.len());
        let one = fill(&shares.of("B/z".into()), Lane::Data);
        assert_eq!(one.len(), 200, "one identity alone has a third of what is free");
        drop(floods);
        assert_eq!(shares.in_flight(), one.len());
    }

    #[test]
    fn the_identities_of_an_organisation_together_hurry_up_to_a_rate() {
        let shares = Shares::new(120);
        let hurrying = |name: String| (0..2000).filter(|_| shares.of(name.clone()).hurries(0)).count() as u64;
        let keep: Vec<_> = (0..30).map(|number| shares.of(format!("A/{number}"))).collect();
        let crowd: u64 = (0..30).map(|number| hurrying(format!("A/{number}"))).sum();
        assert_eq!(crowd, URGENT_OF_ORGANISATION * URGENT_AT_ONCE);
        let other = shares.of("B/z".into());
        assert!(other.hurries(0), "another organisation's release");
        drop(keep);
    }

    #[test]
    fn the_bytes_of_thirty_identities_are_those_of_one_organisation() {
        let shares = Shares::new(10_000);
        let share = 1 << 20;
        let crowd: Vec<_> = (0..30).map(|number| shares.of(format!("A/{number}"))).collect();
        let places: Vec<_> = crowd
            .iter()
            .flat_map(|one| std::iter::from_fn(|| one.place(Lane::Data, share).ok()).collect::<Vec<_>>())
            .collect();
        // The first of each passes.
        assert!(places.len() <= IN_FLIGHT_BYTES_MAX / share + 30, "{}", places.len());
        shares.of("B/z".into()).place(Lane::Data, share).unwrap();
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
