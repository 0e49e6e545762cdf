//! Shares: what one identity uses of a node at a time, so that nobody can use it up.
//!
//! Two things are shared. *Places* are held from a transaction's arrival to its verdict; an identity holds at most as
//! many as are free, so that there are always some for others. *Turns* are for looking at transactions, which mostly is
//! verifying signatures. The lanes have turns of their own, so that control never waits until data is looked at. Within
//! a lane identities take turns, however many connections each has.

use ledger_raft::Lane;
use ledger_rejection::{Code, Rejection};
use std::collections::HashMap;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError, Weak};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, TryAcquireError};

/// Most bytes of transactions of one identity and lane in flight.
const IN_FLIGHT_BYTES_MAX: usize = 64 * 1024 * 1024;
/// Streams and calls that look at control transactions at a time. They are few, and quickly done.
const CONTROL_TURNS: usize = 1;

/// The part that all identities share.
pub(crate) struct Shares {
    places: Arc<Semaphore>,
    places_max: usize,
    turns: Turns,
    data_turns: usize,
    identities: Mutex<HashMap<String, Weak<Share>>>,
}

/// The share of one identity; lives as long as one of its streams or transactions.
pub(crate) struct Share {
    name: String,
    places: Arc<Semaphore>,
    places_max: usize,
    control: Used,
    data: Used,
    own_turns: Turns,
    all_turns: Turns,
}

/// The calls that an identity has in flight.
#[derive(Default)]
struct Used {
    transactions: AtomicUsize,
    bytes: AtomicUsize,
}

#[derive(Clone)]
struct Turns {
    control: Arc<Semaphore>,
    data: Arc<Semaphore>,
}

/// A place among the transactions in flight, until it is dropped.
pub(crate) struct Place {
    share: Arc<Share>,
    lane: Lane,
    bytes: usize,
    _permit: OwnedSemaphorePermit,
}

/// The right to look at transactions, until it is dropped. Its holder must not wait for anything.
pub(crate) struct Turn {
    _own: OwnedSemaphorePermit,
    _all: OwnedSemaphorePermit,
}

impl Shares {
    /// So many transactions in flight on a runtime of so many workers, of which one is always left for control.
    pub(crate) fn new(places_max: usize, workers: usize) -> Self {
        let places_max = places_max.min(Semaphore::MAX_PERMITS);
        let data_turns = workers.saturating_sub(1).max(1);
        Self {
            places: Arc::new(Semaphore::new(places_max)),
            places_max,
            turns: Turns::new(data_turns),
            data_turns,
            identities: Mutex::default(),
        }
    }

    /// The share of an identity, e.g. `Org1/Salma`.
    pub(crate) fn of(&self, name: String) -> Arc<Share> {
        let mut identities = self.identities.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(share) = identities.get(&name).and_then(Weak::upgrade) {
            return share;
        }
        identities.retain(|_, share| share.strong_count() > 0);
        let share = Arc::new(Share {
            name: name.clone(),
            places: Arc::clone(&self.places),
            places_max: self.places_max,
            control: Used::default(),
            data: Used::default(),
            own_turns: Turns::new(self.data_turns),
            all_turns: self.turns.clone(),
        });
        identities.insert(name, Arc::downgrade(&share));
        share
    }

    /// Transactions in flight.
    pub(crate) fn in_flight(&self) -> usize {
        self.places_max - self.places.available_permits()
    }

    /// The node stops: nobody gets a place any more.
    pub(crate) fn close(&self) {
        self.places.close();
    }
}

impl Share {
    /// Its owner.
    pub(crate) fn name(&self) -> &str {
        &self.name
    }

    /// A place for a transaction of so many bytes.
    ///
    /// # Errors
    /// [`Code::Overloaded`] beyond the identity's share, [`Code::ShuttingDown`].
    pub(crate) fn place(self: &Arc<Self>, lane: Lane, bytes: usize) -> Result<Place, Rejection> {
        let used = self.used(lane);
        let (transactions, held) = (used.transactions.load(Ordering::Relaxed), used.bytes.load(Ordering::Relaxed));
        let free = self.places.available_permits();
        if held > 0 && held.saturating_add(bytes) > IN_FLIGHT_BYTES_MAX {
            return Err(self
                .overloaded()
                .found(format!("{held} bytes without a verdict, and {bytes} more"))
                .wanted(format!("at most {IN_FLIGHT_BYTES_MAX} bytes of one identity")));
        }
        let permit = match Arc::clone(&self.places).try_acquire_owned() {
            Err(TryAcquireError::Closed) => return Err(Rejection::new(Code::ShuttingDown, "the node is stopping")),
            Ok(permit) if transactions < free => permit,
            _ => {
                let share = format!(
                    "at most as many as there are places free, {free} of {} (limits.in_flight_max)",
                    self.places_max
                );
                return Err(self.overloaded().found(format!("{transactions} without a verdict")).wanted(share));
            }
        };
        used.transactions.fetch_add(1, Ordering::Relaxed);
        used.bytes.fetch_add(bytes, Ordering::Relaxed);
        Ok(Place { share: Arc::clone(self), lane, bytes, _permit: permit })
    }

    /// A turn, if nobody is before us.
    pub(crate) fn try_turn(&self, lane: Lane) -> Option<Turn> {
        let own = Arc::clone(self.own_turns.of(lane)).try_acquire_owned().ok()?;
        let all = Arc::clone(self.all_turns.of(lane)).try_acquire_owned().ok()?;
        Some(Turn { _own: own, _all: all })
    }

    /// A turn, after those of the own identity and then of all that wait already.
    pub(crate) async fn turn(&self, lane: Lane) -> Option<Turn> {
        let own = Arc::clone(self.own_turns.of(lane)).acquire_owned().await.ok()?;
        let all = Arc::clone(self.all_turns.of(lane)).acquire_owned().await.ok()?;
        Some(Turn { _own: own, _all: all })
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

impl Place {
    /// Its owner.
    pub(crate) fn name(&self) -> &str {
        &self.share.name
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        let used = self.share.used(self.lane);
        used.transactions.fetch_sub(1, Ordering::Relaxed);
        used.bytes.fetch_sub(self.bytes, Ordering::Relaxed);
    }
}

impl Turns {
    fn new(data: usize) -> Self {
        Self { control: Arc::new(Semaphore::new(CONTROL_TURNS)), data: Arc::new(Semaphore::new(data)) }
    }

    fn of(&self, lane: Lane) -> &Arc<Semaphore> {
        match lane {
            Lane::Control => &self.control,
            Lane::Data => &self.data,
        }
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use futures::FutureExt;

    fn fill(share: &Arc<Share>, lane: Lane) -> Vec<Place> {
        std::iter::from_fn(|| share.place(lane, 100).ok()).collect()
    }

    #[test]
    fn one_identity_cannot_take_all_places() {
        let shares = Shares::new(120, 2);
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
        let shares = Shares::new(120, 2);
        let flooder = shares.of("A/x".into());
        let _floods = fill(&flooder, Lane::Data);
        flooder.place(Lane::Control, 1).unwrap();
    }

    #[test]
    fn an_identity_is_bounded_in_bytes_but_its_first_transaction_passes() {
        let shares = Shares::new(120, 2);
        let share = shares.of("A/x".into());
        let first = share.place(Lane::Data, IN_FLIGHT_BYTES_MAX + 1).unwrap();
        assert_eq!(share.place(Lane::Data, 1).err().unwrap().code, Code::Overloaded);
        drop(first);
        share.place(Lane::Data, 1).unwrap();
    }

    #[test]
    fn control_has_turns_of_its_own() {
        let shares = Shares::new(120, 2);
        let [flooder, other] = ["A/x", "B/z"].map(|name| shares.of(name.into()));
        let _turn = flooder.try_turn(Lane::Data).unwrap();
        assert!(other.try_turn(Lane::Data).is_none());
        other.try_turn(Lane::Control).unwrap();
        flooder.try_turn(Lane::Control).unwrap();
    }

    #[test]
    fn identities_take_turns_however_many_connections_each_has() {
        let shares = Shares::new(120, 2);
        let [flooder, other] = ["A/x", "B/z"].map(|name| shares.of(name.into()));
        let first = flooder.try_turn(Lane::Data).unwrap();
        let mut floods: Vec<_> = (0..100).map(|_| Box::pin(flooder.turn(Lane::Data))).collect();
        for flood in &mut floods {
            assert!(flood.now_or_never().is_none());
        }
        let mut turn = Box::pin(other.turn(Lane::Data));
        assert!((&mut turn).now_or_never().is_none());
        drop(first);
        // One of the flooder's connections may have been before; the hundred others are not.
        let second = floods.iter_mut().find_map(FutureExt::now_or_never).flatten();
        drop(second);
        assert!(turn.now_or_never().flatten().is_some());
    }

    #[test]
    fn the_share_of_who_is_gone_is_forgotten() {
        let shares = Shares::new(120, 2);
        for number in 0..100 {
            drop(shares.of(number.to_string()));
        }
        assert!(shares.identities.lock().unwrap().len() <= 1);
    }

    #[test]
    fn a_node_that_stops_gives_no_places() {
        let shares = Shares::new(120, 2);
        shares.close();
        assert_eq!(shares.of("A/x".into()).place(Lane::Control, 1).err().unwrap().code, Code::ShuttingDown);
    }
}
