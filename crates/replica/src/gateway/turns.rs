//! Turns: who looks at transactions now, which mostly is verifying signatures.
//!
//! The lanes have turns of their own, so that control never waits until data is looked at. Within a lane identities take
//! turns, however many connections each has. Only so many of an identity hold a turn or stand in the queue of all. Its others
//! wait behind those.

use ledger_base::mutation::{Mutation, active};
use ledger_base::{costly_invariant, invariant};
use ledger_raft::Lane;
use std::collections::{HashMap, VecDeque};

/// Streams and calls that look at control transactions at a time. They are few, and quickly done.
const CONTROL_TURNS: usize = 1;

/// The turns of a node. `T` is told when somebody who waits has one.
pub struct Turns<T> {
    control: Queue<T>,
    data: Queue<T>,
    /// Number of the next turn.
    next: u64,
}

/// A turn, or a place among those who wait for one; until [`Turns::leave`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Turn {
    lane: Lane,
    /// Number of the identity.
    who: u64,
    number: u64,
}

/// The turns of one lane.
struct Queue<T> {
    /// Turns at a time, and so those of one identity that hold one or wait among all.
    turns: usize,
    /// Numbers of those who have a turn.
    held: Vec<u64>,
    /// Those who wait among all, with the numbers of their identities.
    waiting: VecDeque<(Turn, T)>,
    /// Identities of which somebody has a turn or waits.
    identities: HashMap<u64, Own<T>>,
}

/// Those of one identity.
struct Own<T> {
    /// How many have a turn, or wait among all.
    among_all: usize,
    /// The others.
    waiting: VecDeque<(Turn, T)>,
}

impl<T> Turns<T> {
    /// On a runtime of so many workers, of which one is always left for control.
    pub fn new(workers: usize) -> Self {
        let data = workers.saturating_sub(1).max(1);
        Self { control: Queue::new(CONTROL_TURNS), data: Queue::new(data), next: 0 }
    }

    /// A turn for an identity, if nobody is before it.
    pub fn take(&mut self, lane: Lane, who: u64) -> Option<Turn> {
        let turn = self.turn(lane, who);
        let queue = self.queue(lane);
        let own = queue.identities.get(&who).map_or(0, |own| own.among_all);
        if own >= queue.each_max() || queue.held.len() >= queue.turns {
            return None;
        }
        queue.own(who).among_all += 1;
        queue.held.push(turn.number);
        queue.check();
        Some(turn)
    }

    /// Waits for a turn, when there is none: after those of the own identity and then of all that wait already.
    pub fn wait(&mut self, lane: Lane, who: u64, waiter: T) -> Turn {
        let turn = self.turn(lane, who);
        let queue = self.queue(lane);
        let each_max = queue.each_max();
        let own = queue.own(who);
        if own.among_all < each_max {
            own.among_all += 1;
            queue.waiting.push_back((turn, waiter));
        } else {
            own.waiting.push_back((turn, waiter));
        }
        queue.check();
        turn
    }

    /// The turn is over, or is not waited for any more. Answers with who has one now because of that.
    pub fn leave(&mut self, turn: &Turn) -> Option<T> {
        let queue = self.queue(turn.lane);
        let next = queue.leave(turn);
        queue.check();
        next
    }

    fn turn(&mut self, lane: Lane, who: u64) -> Turn {
        self.next += 1;
        Turn { lane, who, number: self.next }
    }

    fn queue(&mut self, lane: Lane) -> &mut Queue<T> {
        match lane {
            Lane::Control => &mut self.control,
            Lane::Data => &mut self.data,
        }
    }
}

impl<T> Queue<T> {
    fn new(turns: usize) -> Self {
        Self { turns, held: Vec::with_capacity(turns), waiting: VecDeque::new(), identities: HashMap::new() }
    }

    /// How many of one identity have a turn or wait among all.
    fn each_max(&self) -> usize {
        if active(Mutation::IgnoreTheShare) { usize::MAX } else { self.turns }
    }

    fn own(&mut self, who: u64) -> &mut Own<T> {
        self.identities.entry(who).or_insert_with(|| Own { among_all: 0, waiting: VecDeque::new() })
    }

    fn leave(&mut self, turn: &Turn) -> Option<T> {
        let own = self.identities.get_mut(&turn.who)?;
        if let Some(held) = self.held.iter().position(|number| *number == turn.number) {
            self.held.swap_remove(held);
            own.among_all -= 1;
        } else if let Some(place) = position(&self.waiting, turn) {
            self.waiting.remove(place);
            own.among_all -= 1;
        } else if let Some(place) = position(&own.waiting, turn) {
            own.waiting.remove(place);
            return None;
        } else {
            return None;
        }
        match own.waiting.pop_front() {
            Some(next) => {
                own.among_all += 1;
                self.waiting.push_back(next);
            }
            None if own.among_all == 0 => drop(self.identities.remove(&turn.who)),
            None => {}
        }
        if self.held.len() >= self.turns {
            return None;
        }
        let (next, waiter) = self.waiting.pop_front()?;
        self.held.push(next.number);
        Some(waiter)
    }

    /// States that there are enough turns for those that have one, and that each of those before the queue is counted.
    fn check(&self) {
        let (held, turns) = (self.held.len(), self.turns);
        invariant!(held <= turns, "no more have a turn than there are turns", "{held} of {turns}");
        let standing = held + self.waiting.len();
        costly_invariant!(
            self.identities.values().map(|own| own.among_all).sum::<usize>() == standing,
            "an identity counts its turns and its places among all",
            "{standing} stand, {} are counted",
            self.identities.values().map(|own| own.among_all).sum::<usize>()
        );
    }
}

fn position<T>(waiting: &VecDeque<(Turn, T)>, turn: &Turn) -> Option<usize> {
    waiting.iter().position(|(other, _)| other == turn)
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    const FLOODER: u64 = 1;
    const OTHER: u64 = 2;

    #[test]
    fn control_has_turns_of_its_own() {
        let mut turns = Turns::<()>::new(2);
        turns.take(Lane::Data, FLOODER).unwrap();
        assert_eq!(turns.take(Lane::Data, OTHER), None);
        let control = turns.take(Lane::Control, OTHER).unwrap();
        assert_eq!(turns.leave(&control), None);
        turns.take(Lane::Control, FLOODER).unwrap();
    }

    #[test]
    fn identities_take_turns_however_many_connections_each_has() {
        let mut turns = Turns::new(2);
        let first = turns.take(Lane::Data, FLOODER).unwrap();
        let floods: Vec<_> = (0..100).map(|flood| turns.wait(Lane::Data, FLOODER, flood)).collect();
        let other = turns.wait(Lane::Data, OTHER, 1000);
        // One of the flooder's connections may be before; the others are not.
        assert_eq!(turns.leave(&first), Some(1000));
        assert_eq!(turns.leave(&other), Some(0));
        assert_eq!(turns.leave(floods.first().unwrap()), Some(1));
    }

    #[test]
    fn whoever_waits_no_longer_is_passed_over_and_leaves_nothing_behind() {
        let mut turns = Turns::new(2);
        let first = turns.take(Lane::Data, FLOODER).unwrap();
        let [gone, too, waits] = [0, 1, 2].map(|number| turns.wait(Lane::Data, OTHER, number));
        assert_eq!((turns.leave(&gone), turns.leave(&too)), (None, None));
        assert_eq!(turns.leave(&first), Some(2));
        assert_eq!((turns.leave(&waits), turns.leave(&waits)), (None, None), "it is over once");
        assert!(turns.data.identities.is_empty() && turns.data.held.is_empty());
    }

    #[test]
    fn as_many_look_at_data_as_there_are_workers_but_one() {
        let mut turns = Turns::<()>::new(4);
        let held: Vec<_> = std::iter::from_fn(|| turns.take(Lane::Data, FLOODER)).collect();
        assert_eq!(held.len(), 3);
        assert_eq!(std::iter::from_fn(|| Turns::<()>::new(1).take(Lane::Data, OTHER)).take(1).count(), 1);
    }

    #[test]
    #[should_panic(expected = "no more have a turn than there are turns")]
    fn a_turn_too_many_is_found() {
        let mut turns = Turns::<()>::new(2);
        let first = turns.take(Lane::Data, FLOODER).unwrap();
        turns.queue(Lane::Data).held.extend([77, 78, 79]);
        turns.leave(&first);
    }

    #[test]
    #[should_panic(expected = "an identity counts its turns and its places among all")]
    fn a_turn_that_no_identity_counts_is_found() {
        invariant::look_closely();
        let mut turns = Turns::<()>::new(8);
        let first = turns.take(Lane::Data, FLOODER).unwrap();
        turns.queue(Lane::Data).held.push(77);
        turns.leave(&first);
    }
}
