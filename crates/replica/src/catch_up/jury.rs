//! The nodes that must agree with the blocks that another one gives.

use super::Offer;
use ledger::members::Membership;
use ledger_base::hash::Hash;

/// Those who are asked about each batch, one after the other.
pub(super) struct Jury<P> {
    members: Vec<Offer<P>>,
    /// So many must agree.
    needed: usize,
    /// The giver and those who agree are most voters. Then nobody else can have ordered other blocks, and one that says so is
    /// passed over.
    is_majority: bool,
    asked: usize,
    agreed: usize,
}

/// The outcome of a question.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Verdict {
    /// Enough agree.
    Confirmed,
    /// Another one is to be asked.
    Open,
    /// The blocks are not believed: this node has another one.
    Refused {
        /// Its name.
        by: String,
    },
}

impl<P: Clone> Jury<P> {
    /// Nobody: the giver is believed by itself.
    pub(super) fn none() -> Self {
        Self { members: Vec::new(), needed: 0, is_majority: false, asked: 0, agreed: 0 }
    }

    /// Those who can confirm the block `next` of this one, of the nodes that have answered. One of another organisation than
    /// the giver's. Where no such one has the block, voters: together with the giver they must be a majority of `known`, the
    /// members that the asking node knows. None if nobody can.
    pub(super) fn of(giver: &Offer<P>, offers: &[Offer<P>], known: &Membership, next: u64) -> Option<Self> {
        let others = |counts: &dyn Fn(&Offer<P>) -> bool| -> Vec<Offer<P>> {
            offers.iter().filter(|other| other.who.id != giver.who.id && counts(other)).cloned().collect()
        };
        let members = others(&|other| other.who.organisation != giver.who.organisation);
        let one = Self { members, needed: 1, ..Self::none() };
        if one.limit() >= next {
            return Some(one);
        }
        let members = others(&|other| known.is_voter(other.who.id));
        let needed = (known.voters.len() / 2 + 1).saturating_sub(usize::from(known.is_voter(giver.who.id)));
        let majority = Self { members, needed, is_majority: true, ..Self::none() };
        let can = known.outgoing.is_empty() && needed > 0 && majority.limit() >= next;
        can.then_some(majority)
    }

    /// Is there anybody to ask?
    pub(super) fn is_none(&self) -> bool {
        self.needed == 0
    }

    /// The newest height that enough of them have.
    pub(super) fn limit(&self) -> u64 {
        let mut heights: Vec<u64> = self.members.iter().map(|member| member.has.height).collect();
        heights.sort_unstable_by(|one, other| other.cmp(one));
        self.needed.checked_sub(1).map_or(u64::MAX, |last| heights.get(last).copied().unwrap_or(0))
    }

    /// The next batch is to be confirmed.
    pub(super) fn begin(&mut self) {
        (self.asked, self.agreed) = (0, 0);
    }

    /// The next one to ask; none if all were asked, and too few agree.
    pub(super) fn next(&mut self) -> Option<P> {
        let member = self.members.get(self.asked)?;
        self.asked += 1;
        Some(member.peer.clone())
    }

    /// The name of the one that was asked last.
    pub(super) fn name(&self) -> &str {
        let last = self.asked.checked_sub(1).and_then(|last| self.members.get(last));
        last.map(|member| &*member.who.name).unwrap_or_default()
    }

    /// It has answered: with its block hash, or nothing if it does not have the block.
    pub(super) fn hear(&mut self, wanted: Hash, answer: Option<Hash>) -> Verdict {
        match answer {
            Some(hash) if hash == wanted => {
                self.agreed += 1;
                if self.agreed >= self.needed { Verdict::Confirmed } else { Verdict::Open }
            }
            Some(_) if !self.is_majority => Verdict::Refused { by: self.name().to_owned() },
            Some(_) => {
                tracing::warn!(node = self.name(), "a voter has another block than the fetched one");
                Verdict::Open
            }
            None => Verdict::Open,
        }
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::catch_up::{Holding, Who};

    const BLOCK: Hash = Hash([1; 32]);
    const OTHER: Hash = Hash([2; 32]);

    fn offer(id: u64, organisation: &str, height: u64) -> Offer<u64> {
        let who =
            Who { id, organisation: organisation.into(), name: format!("{organisation}/node{id}"), vouched: false };
        Offer { who, has: Holding { height, first_height: 1, ..Holding::default() }, peer: id }
    }

    /// Nodes of `Org1` with these heights have answered; the first one gives.
    fn of_one(heights: &[u64], voters: &[u64]) -> Option<Jury<u64>> {
        let offers: Vec<_> = (1..).zip(heights).map(|(id, height)| offer(id, "Org1", *height)).collect();
        Jury::of(offers.first().unwrap(), &offers, &Membership::new(voters.iter().copied(), []), 6)
    }

    /// The verdicts on a batch, as those who are asked answer.
    fn verdicts(jury: &mut Jury<u64>, answers: &[Option<Hash>]) -> Vec<Verdict> {
        jury.begin();
        let asked = answers.iter().map_while(|answer| {
            jury.next()?;
            Some(jury.hear(BLOCK, *answer))
        });
        asked.collect()
    }

    #[test]
    fn one_node_of_another_organisation_confirms_and_one_that_differs_refuses() {
        let offers = [offer(1, "Org1", 9), offer(2, "Org1", 9), offer(3, "Org2", 7), offer(4, "Org3", 8)];
        let mut jury = Jury::of(&offers[0], &offers, &Membership::new([1, 2, 3, 4, 5], []), 8).unwrap();
        assert_eq!(jury.limit(), 8, "one is enough");
        assert_eq!(verdicts(&mut jury, &[None, Some(BLOCK)]), [Verdict::Open, Verdict::Confirmed]);
        let refused = Verdict::Refused { by: "Org2/node3".into() };
        assert_eq!(verdicts(&mut jury, &[Some(OTHER)]), [refused]);
        assert_eq!(verdicts(&mut jury, &[None, None, Some(BLOCK)]), [Verdict::Open, Verdict::Open], "two can confirm");
    }

    #[test]
    fn where_one_organisation_answers_a_majority_of_the_known_voters_confirms_and_no_fewer() {
        let mut jury = of_one(&[9, 8, 7, 6], &[1, 2, 3, 4, 5]).unwrap();
        assert_eq!(jury.limit(), 7, "two besides the giver");
        let agree = verdicts(&mut jury, &[Some(BLOCK), Some(OTHER), Some(BLOCK)]);
        assert_eq!(agree, [Verdict::Open, Verdict::Open, Verdict::Confirmed]);
        let few = verdicts(&mut jury, &[Some(BLOCK), Some(OTHER), None, Some(BLOCK)]);
        assert_eq!(few, [Verdict::Open, Verdict::Open, Verdict::Open]);
        assert_eq!(verdicts(&mut jury, &[Some(BLOCK)]), [Verdict::Open], "each batch anew");
        assert!(of_one(&[9, 8], &[1, 2, 3, 4, 5]).is_none(), "too few have answered");
        assert!(of_one(&[9, 8, 7], &[2, 3, 4, 5, 6]).is_none(), "the giver has no vote");
        assert!(of_one(&[9, 8, 7, 6], &[2, 3, 4, 5, 6]).is_some());
        assert!(of_one(&[9, 8, 5, 5], &[1, 2, 3, 4, 5]).is_none(), "too few have the block that is missing");
    }

    #[test]
    fn nodes_of_another_organisation_that_lack_the_block_themselves_leave_it_to_the_voters() {
        let offers = [offer(1, "Org1", 9), offer(2, "Org1", 9), offer(3, "Org2", 3)];
        let mut jury = Jury::of(&offers[0], &offers, &Membership::new([1, 2, 3], []), 4).unwrap();
        assert_eq!((jury.limit(), jury.next()), (9, Some(2)));
    }

    #[test]
    fn voters_that_are_just_changing_confirm_nothing() {
        let offers = [offer(1, "Org1", 9), offer(2, "Org1", 9), offer(3, "Org1", 9)];
        let members = Membership { outgoing: [1, 2, 3, 4].into(), ..Membership::new([1, 2, 3], []) };
        assert!(Jury::of(&offers[0], &offers, &members, 1).is_none());
    }
}
