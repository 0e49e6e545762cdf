//! Turns: who looks at transactions now, which mostly is verifying signatures.
//!
//! The lanes have turns of their own, so that control never waits until data is looked at. Within a lane the organisations
//! take turns, and within an organisation its identities, however many connections each has. An organisation makes as many
//! identities as it likes, so their number gives it nothing.

use ledger_base::mutation::{Mutation, active};
use ledger_base::{costly_invariant, invariant};
use ledger_raft::Lane;
use std::collections::VecDeque;

/// Streams and calls that look at control transactions at a time. They are few, and quickly done.
const CONTROL_TURNS: usize = 1;

/// The turns of a node. `T` is notified when it waits and has a turn.
pub struct Turns<T> {
    control: Queue<T>,
    data: Queue<T>,
    /// Number of the next turn.
    next: u64,
}

/// An identity and its organisation, by their numbers at this node.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Applicant {
    /// Number of the organisation.
    pub organisation: u64,
    /// Number of the identity; no other organisation has one with the same.
    pub identity: u64,
}

/// A turn, or a position in the queue for one; until [`Turns::leave`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Turn {
    lane: Lane,
    who: Applicant,
    number: u64,
}

/// The turns of one lane.
struct Queue<T> {
    /// Turns at a time.
    turns: usize,
    /// Numbers of the turns that are held.
    held: Vec<u64>,
    /// Those that hold a turn or wait, in the order in which they take turns.
    organisations: Vec<Party<Identities<T>>>,
}

/// The identities of one organisation that hold a turn or wait, in the order in which they take turns.
type Identities<T> = Vec<Party<VecDeque<(u64, T)>>>;

/// An organisation or an identity.
struct Party<W> {
    number: u64,
    /// Turns that it holds.
    held: usize,
    /// How many wait.
    waits: usize,
    /// Its identities, or what waits of an identity with the numbers of the turns.
    parts: W,
}

impl<T> Turns<T> {
    /// On a runtime of so many workers, of which one is always left for control.
    pub fn new(workers: usize) -> Self {
        let data = workers.saturating_sub(1).max(1);
        Self { control: Queue::new(CONTROL_TURNS), data: Queue::new(data), next: 0 }
    }

    /// A turn for an identity, if one is free.
    pub fn take(&mut self, lane: Lane, who: Applicant) -> Option<Turn> {
        let turn = self.turn(lane, who);
        let queue = self.queue(lane);
        if queue.held.len() >= queue.turns {
            return None;
        }
        queue.hold(&turn);
        queue.check();
        Some(turn)
    }

    /// Waits for a turn, when none is free.
    pub fn wait(&mut self, lane: Lane, who: Applicant, waiter: T) -> Turn {
        let turn = self.turn(lane, who);
        let queue = self.queue(lane);
        queue.wait(&turn, waiter);
        queue.check();
        turn
    }

    /// The turn is over, or is not waited for any more. Answers with the waiter that has one now because of that.
    pub fn leave(&mut self, turn: &Turn) -> Option<T> {
        let queue = self.queue(turn.lane);
        let next = queue.leave(turn);
        queue.check();
        next
    }

    fn turn(&mut self, lane: Lane, who: Applicant) -> Turn {
        self.next += 1;
        let who = if active(Mutation::IgnoreTheShare) { Applicant::default() } else { who };
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
        Self { turns, held: Vec::with_capacity(turns), organisations: Vec::new() }
    }

    fn hold(&mut self, turn: &Turn) {
        let organisation = party(&mut self.organisations, turn.who.organisation);
        organisation.held += 1;
        party(&mut organisation.parts, turn.who.identity).held += 1;
        self.held.push(turn.number);
    }

    fn wait(&mut self, turn: &Turn, waiter: T) {
        let organisation = waiting(&mut self.organisations, turn.who.organisation);
        let identity = waiting(&mut organisation.parts, turn.who.identity);
        identity.parts.push_back((turn.number, waiter));
    }

    fn leave(&mut self, turn: &Turn) -> Option<T> {
        if let Some(held) = self.held.iter().position(|number| *number == turn.number) {
            // The one that leaves still counts its turn, so that another one is next.
            let next = self.next();
            self.held.swap_remove(held);
            self.release(turn.who, |party| party.held -= 1, |identity| identity.held -= 1);
            let (number, waiter) = next?;
            self.held.push(number);
            return Some(waiter);
        }
        let waits = |identity: &Party<VecDeque<(u64, T)>>| position(&identity.parts, turn.number);
        let organisation = self.organisations.iter().find(|party| party.number == turn.who.organisation)?;
        let place = organisation.parts.iter().find(|party| party.number == turn.who.identity).and_then(waits)?;
        let not_any_more = |identity: &mut Party<VecDeque<(u64, T)>>| {
            identity.waits -= 1;
            identity.parts.remove(place);
        };
        self.release(turn.who, |party| party.waits -= 1, not_any_more);
        None
    }

    /// Takes out who waits and is next: of the organisation that holds fewest turns, the first; and so within it.
    fn next(&mut self) -> Option<(u64, T)> {
        next(&mut next(&mut self.organisations)?.parts)?.parts.pop_front()
    }

    /// Changes what is counted of an identity and its organisation, and forgets them if nothing is left.
    fn release(
        &mut self,
        who: Applicant,
        of_organisation: impl FnOnce(&mut Party<Identities<T>>),
        of_identity: impl FnOnce(&mut Party<VecDeque<(u64, T)>>),
    ) {
        let organisation = party(&mut self.organisations, who.organisation);
        of_organisation(organisation);
        of_identity(party(&mut organisation.parts, who.identity));
        organisation.parts.retain(Party::is_active);
        self.organisations.retain(Party::is_active);
    }

    /// States that there are enough turns for those that have one, and that each is counted.
    fn check(&self) {
        let (held, turns) = (self.held.len(), self.turns);
        invariant!(held <= turns, "no more have a turn than there are turns", "{held} of {turns}");
        let identities = || self.organisations.iter().flat_map(|organisation| &organisation.parts);
        let counted = || identities().map(|identity| identity.held).sum::<usize>();
        costly_invariant!(counted() == held, "an identity counts its turns", "{held} held, {} counted", counted());
        let (wait, waits) = (
            || identities().map(|identity| identity.parts.len()).sum::<usize>(),
            || self.organisations.iter().map(|organisation| organisation.waits).sum::<usize>(),
        );
        costly_invariant!(
            wait() == waits() && (held == turns || wait() == 0),
            "an organisation counts who waits, and nobody waits for a turn that is free",
            "{} wait, {} are counted, {held} of {turns} turns are held",
            wait(),
            waits()
        );
    }
}

impl<W> Party<W> {
    fn is_active(&self) -> bool {
        self.held > 0 || self.waits > 0
    }
}

/// The party of this number; a new one is last.
fn party<W: Default>(parties: &mut Vec<Party<W>>, number: u64) -> &mut Party<W> {
    let place = parties.iter().position(|party| party.number == number).unwrap_or(parties.len());
    if place == parties.len() {
        parties.push(Party { number, held: 0, waits: 0, parts: W::default() });
    }
    #[expect(clippy::indexing_slicing, reason = "it was found there, or pushed")]
    &mut parties[place]
}

/// The party of this number, of which one more waits. If it is the first, the party is last.
fn waiting<W: Default>(parties: &mut Vec<Party<W>>, number: u64) -> &mut Party<W> {
    if let Some(place) = parties.iter().position(|party| party.number == number && party.waits == 0) {
        let party = parties.remove(place);
        parties.push(party);
    }
    let party = party(parties, number);
    party.waits += 1;
    party
}

/// The party whose turn it is, which holds one more and is last from now on.
fn next<W>(parties: &mut Vec<Party<W>>) -> Option<&mut Party<W>> {
    let waiting = parties.iter().enumerate().filter(|(_, party)| party.waits > 0);
    let (place, _) = waiting.min_by_key(|(_, party)| party.held)?;
    let mut party = parties.remove(place);
    party.held += 1;
    party.waits -= 1;
    parties.push(party);
    parties.last_mut()
}

fn position<T>(waiting: &VecDeque<(u64, T)>, turn: u64) -> Option<usize> {
    waiting.iter().position(|(number, _)| *number == turn)
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    const FLOODER: Applicant = Applicant { organisation: 1, identity: 1 };
    const OTHER: Applicant = Applicant { organisation: 2, identity: 2 };

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
    fn thirty_identities_of_one_organisation_leave_half_of_the_turns_to_the_one_of_another() {
        let mut turns = Turns::new(2);
        let crowd = |identity| Applicant { organisation: 1, identity };
        let mut held = turns.take(Lane::Data, crowd(100)).unwrap();
        // Three streams each. Number 1000 is the stream of the other one, which asks again after each turn.
        let mut of = std::collections::HashMap::new();
        for number in 0..90u64 {
            of.insert(number, turns.wait(Lane::Data, crowd(100 + number % 30), number));
        }
        of.insert(1000, turns.wait(Lane::Data, OTHER, 1000));
        let mut order = Vec::new();
        for _ in 0..60 {
            let next = turns.leave(&held).unwrap();
            held = of.remove(&next).unwrap();
            order.push(next);
            if next == 1000 {
                of.insert(1000, turns.wait(Lane::Data, OTHER, 1000));
            }
        }
        let other = order.iter().filter(|number| **number == 1000).count();
        assert_eq!(other, 30, "{order:?}");
        let crowd: std::collections::HashSet<_> = order.iter().filter(|number| **number != 1000).collect();
        assert_eq!(crowd.iter().map(|number| **number % 30).collect::<std::collections::HashSet<_>>().len(), 30);
    }

    #[test]
    fn an_organisation_that_comes_back_again_and_again_overtakes_none_that_waits() {
        let mut turns = Turns::new(2);
        let organisations: Vec<_> =
            (1..=3).map(|number| Applicant { organisation: number, identity: number }).collect();
        let mut held = turns.take(Lane::Data, Applicant { organisation: 9, identity: 9 }).unwrap();
        let mut of: Vec<_> = organisations.iter().map(|who| turns.wait(Lane::Data, *who, who.identity)).collect();
        for round in 0..5 {
            for number in 1..=3u64 {
                assert_eq!(turns.leave(&held), Some(number), "round {round}");
                let place = usize::try_from(number).unwrap() - 1;
                held = *of.get(place).unwrap();
                let who = *organisations.get(place).unwrap();
                *of.get_mut(place).unwrap() = turns.wait(Lane::Data, who, number);
            }
        }
    }

    #[test]
    fn whoever_waits_no_longer_is_passed_over_and_leaves_nothing_behind() {
        let mut turns = Turns::new(2);
        let first = turns.take(Lane::Data, FLOODER).unwrap();
        let [gone, too, waits] = [0, 1, 2].map(|number| turns.wait(Lane::Data, OTHER, number));
        assert_eq!((turns.leave(&gone), turns.leave(&too)), (None, None));
        assert_eq!(turns.leave(&first), Some(2));
        assert_eq!((turns.leave(&waits), turns.leave(&waits)), (None, None), "it is over once");
        assert!(turns.data.organisations.is_empty() && turns.data.held.is_empty());
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
    #[should_panic(expected = "an identity counts its turns")]
    fn a_turn_that_no_identity_counts_is_found() {
        invariant::look_closely();
        let mut turns = Turns::<()>::new(8);
        let first = turns.take(Lane::Data, FLOODER).unwrap();
        turns.queue(Lane::Data).held.push(77);
        turns.leave(&first);
    }
}
