//! What the other nodes say while this one runs: does it still belong to the network, and do they have the same chain?
//!
//! Every node asks the voters from time to time: their height, and the block hash and state digest at a height that both
//! have. Hash and digest cover everything before, so two nodes that differ once differ for ever. An answer, like an
//! attestation, is a claim: it is shown and logged, and nobody stops for it. A node stops on proof:
//!
//! | it finds | proof | what it is |
//! |---|---|---|
//! | another block at a height that it has committed | more than half of the voters have the same other one | two histories: a voter has forgotten what it acknowledged |
//! | the same block, another state | more than half of the voters, of two organisations if voters are of two, have the same other one | this node computes something else |
//! | it has no leader, and nodes do not know it | nodes of two organisations, or of its own, say so; then the blocks that removed it | it was removed while it was away |
//!
//! A node remembers the height that each voter has confirmed, also across restarts. One that holds less has lost its disk, or was set back to a
//! copy: it gets no vote, is told so when it asks, and is shown.

use crate::REJOIN;
use crate::catch_up::{Behind, Holding, Who};
use ledger::Ledger;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_raft::{Contradiction, PeerMessage, RaftKind, Receipt};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// Organisations that must say something, if there are so many.
const ORGANISATIONS_MIN: usize = 2;

/// A node's chain at a height.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Point {
    /// The height.
    pub height: u64,
    /// Hash of the block there.
    pub hash: Hash,
    /// State digest after it.
    pub digest: Hash,
}

/// A chain that others are compared with.
pub trait Chain {
    /// Its point at a height, or at its tip if that is lower; none if it is not known any more.
    ///
    /// # Errors
    /// A fault of the store.
    fn point(&self, height: u64) -> Result<Option<Point>, Rejection>;
}

impl Chain for Arc<Ledger> {
    fn point(&self, height: u64) -> Result<Option<Point>, Rejection> {
        let tip = self.tip();
        if height >= tip.height {
            return Ok(Some(Point { height: tip.height, hash: tip.hash, digest: tip.digest }));
        }
        let block = self.block_hashes(height)?;
        Ok(block.map(|block| Point { height, hash: block.hash, digest: block.digest }))
    }
}

/// The answer of a node.
#[derive(Clone, Debug)]
pub struct Said {
    /// The node that says so.
    pub who: Who,
    /// Its blocks.
    pub has: Holding,
    /// Its chain at the height that was asked for, or lower.
    pub at: Option<Point>,
    /// It does not know the asking node as a member.
    pub stranger: bool,
}

/// The place of a node in the network, as it knows it.
#[derive(Clone, Debug, Default)]
pub struct Place {
    /// All voters, this node among them if it votes, with their organisations.
    pub voters: BTreeMap<u64, String>,
    /// All members.
    pub members: BTreeSet<u64>,
    /// It reaches no leader.
    pub cut_off: bool,
}

/// The consequence of the answers.
#[derive(Clone, Debug, PartialEq)]
pub enum Follows {
    /// Nothing.
    Nothing,
    /// The same question is asked again, about this height.
    Ask(u64),
    /// This node cannot go on.
    Stop(Rejection),
    /// It was removed, as they say: it fetches the blocks that prove it.
    Fetch(Behind),
}

/// Another node that differs from this one.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Differs {
    name: String,
    height: u64,
    what: &'static str,
}

/// The knowledge of this node about the others.
#[derive(Debug)]
pub struct Company<C> {
    chain: C,
    /// Of this node.
    organisation: String,
    /// The greatest height that each voter has confirmed, with the receipt that it gave for it.
    confirmed: BTreeMap<u64, Receipt>,
    differing: BTreeMap<u64, Differs>,
    /// Voters that hold less than they had confirmed.
    lost: BTreeMap<u64, String>,
    /// Nodes whose log contradicts the one of this node, executed or not.
    contradicting: BTreeMap<u64, String>,
}

impl<C: Chain> Company<C> {
    /// Of a node with this chain and of this organisation, which remembers what voters have confirmed.
    pub fn new(chain: C, organisation: &str, confirmed: BTreeMap<u64, Receipt>) -> Self {
        let (differing, lost, contradicting) = Default::default();
        Self { chain, organisation: organisation.to_owned(), confirmed, differing, lost, contradicting }
    }

    /// The own chain at a height, or at its tip.
    ///
    /// # Errors
    /// A fault of the store.
    pub fn own(&self, height: u64) -> Result<Option<Point>, Rejection> {
        self.chain.point(height)
    }

    /// The heights that voters have confirmed, to be kept.
    pub fn confirmed(&self) -> &BTreeMap<u64, Receipt> {
        &self.confirmed
    }

    /// Is this a request for a vote by a node that holds less than it had confirmed?
    pub fn withholds(&self, from: u64, message: &PeerMessage) -> bool {
        let votes = [RaftKind::Vote, RaftKind::PreVote].map(|kind| kind as i32);
        let PeerMessage::Raft(message) = message else { return false };
        votes.contains(&message.kind) && self.confirmed.get(&from).is_some_and(|had| message.index < had.index)
    }

    /// A node told its own chain when it asked, or attested it. It is compared, shown and logged.
    ///
    /// # Errors
    /// A fault of the store.
    pub fn told(&mut self, id: u64, name: &str, point: Point) -> Result<(), Rejection> {
        let own = self.chain.point(point.height)?.filter(|own| own.height == point.height);
        let Some(own) = own.filter(|own| own.height > 0) else { return Ok(()) };
        let what = match (own.hash == point.hash, own.digest == point.digest) {
            (true, true) => {
                if self.differing.remove(&id).is_some() {
                    tracing::warn!(node = name, height = own.height, "this node and another one agree again");
                }
                return Ok(());
            }
            (false, _) => "another block",
            (true, false) => "another state",
        };
        if !self.differing.contains_key(&id) {
            tracing::error!(
                node = name, height = own.height, own = %own.digest, theirs = %point.digest, what,
                "this node and another one differ; it is not known yet which is correct"
            );
        }
        let differs = Differs { name: name.to_owned(), height: own.height, what };
        self.differing.entry(id).or_insert(differs);
        Ok(())
    }

    /// Ordering has found that the log of another node contradicts the one of this node, so that neither appends to the other.
    /// It is logged, and shown until this node starts again: people must decide.
    pub fn contradicted(&mut self, name: &str, found: &Contradiction) {
        let Contradiction { node, leads, term, height, own, other } = *found;
        let part = if leads { "leads" } else { "follows" };
        let text = format!("{name}, which {part} in term {term}, has another log from height {height} or before");
        if self.contradicting.get(&node) != Some(&text) {
            tracing::error!(
                node = name, leads, term, height, %own, %other,
                "log of another node contradicts the log of this node; appending nothing to it"
            );
            self.contradicting.insert(node, text);
        }
    }

    /// The nodes whose logs contradict the one of this node, as ordering has found.
    pub fn contradicting(&self) -> Vec<u64> {
        self.contradicting.keys().copied().collect()
    }

    /// Takes the answers of one round, and says what follows. `asked`: the height of the question, if it was asked again.
    ///
    /// # Errors
    /// A fault of the store.
    pub fn heard(&mut self, said: &[Said], place: &Place, asked: Option<u64>) -> Result<Follows, Rejection> {
        self.differing.retain(|id, _| place.members.contains(id));
        self.lost.retain(|id, _| place.voters.contains_key(id));
        self.contradicting.retain(|id, _| place.members.contains(id));
        self.confirmed.retain(|id, _| place.voters.contains_key(id));
        for Said { who, has, at, .. } in said {
            if place.voters.contains_key(&who.id) {
                self.note_height(who, has);
            }
            if let Some(at) = at {
                self.told(who.id, &who.name, *at)?;
            }
        }
        let tip = self.chain.point(u64::MAX)?.map_or(0, |tip| tip.height);
        if let Some(behind) = removed(said, place, &self.organisation, tip) {
            return Ok(Follows::Fetch(behind));
        }
        self.judge(said, place, asked)
    }

    fn note_height(&mut self, who: &Who, has: &Holding) {
        let height = has.height;
        let confirmed = self.confirmed.entry(who.id).or_default();
        if height >= confirmed.index {
            let receipt = has.receipt.as_ref().filter(|receipt| (receipt.term, receipt.index) == (0, height));
            *confirmed = receipt.cloned().unwrap_or(Receipt { index: height, ..Receipt::default() });
            self.lost.remove(&who.id);
            return;
        }
        if has.durable >= confirmed.index {
            // It has started again, and has not learned yet how far its log is committed. Another log would differ in its hashes.
            self.lost.remove(&who.id);
            return;
        }
        let had = confirmed.index;
        let text = format!("{} holds blocks up to height {height}, and had confirmed {had}", who.name);
        if self.lost.insert(who.id, text).is_none() {
            tracing::error!(voter = who.name, height, confirmed = had, "a voter has lost confirmed blocks");
        }
    }

    /// Is there proof against this node?
    fn judge(&self, said: &[Said], place: &Place, asked: Option<u64>) -> Result<Follows, Rejection> {
        let differing: Vec<_> = said
            .iter()
            .filter(|one| place.voters.contains_key(&one.who.id) && self.differing.contains_key(&one.who.id))
            .filter_map(|one| Some((&one.who, one.at?)))
            .collect();
        let Some(lowest) = differing.iter().map(|(_, at)| at.height).min() else { return Ok(Follows::Nothing) };
        // What they say must be about one height; and with the question they learn what this node has there.
        if asked.is_none() {
            return Ok(Follows::Ask(lowest));
        }
        let Some(own) = self.chain.point(lowest)?.filter(|own| own.height == lowest) else {
            return Ok(Follows::Nothing);
        };
        let others = differing.into_iter().filter(|(_, at)| at.height == lowest && *at != own);
        let others: Vec<_> = others
            .map(|(who, at)| (who.name.as_str(), place.voters.get(&who.id).map_or("", String::as_str), at))
            .collect();
        Ok(proof(own, &others, place).map_or(Follows::Nothing, Follows::Stop))
    }

    /// The nodes that differ from this one or have lost blocks, in words; empty if nobody.
    pub fn describe(&self) -> String {
        let differing = self
            .differing
            .values()
            .map(|Differs { name, height, what }| format!("{name} has {what} at height {height}"));
        let others = self.lost.values().chain(self.contradicting.values()).cloned();
        differing.chain(others).collect::<Vec<_>>().join(", ")
    }

    /// A node that differs, and the height at which that was noticed.
    pub fn differing(&self) -> Option<(&str, u64)> {
        self.differing.values().map(|differs| (differs.name.as_str(), differs.height)).next()
    }

    /// Does somebody differ, so that the others should be asked soon?
    pub fn is_in_doubt(&self) -> bool {
        !self.differing.is_empty()
    }
}

/// The refusal to go on, if enough voters have the same other thing at one height. `others`: name, organisation and chain of
/// the voters that differ there.
fn proof(own: Point, others: &[(&str, &str, Point)], place: &Place) -> Option<Rejection> {
    let organisations: BTreeSet<_> = place.voters.values().collect();
    let is_most = |count: usize| count * 2 > place.voters.len();
    let names = |of: &dyn Fn(&Point) -> bool| -> Vec<&str> {
        others.iter().filter(|(.., at)| of(at)).map(|(name, ..)| *name).collect()
    };
    let next = format!(
        "keep a copy of this data directory, then see \"Two histories\" in docs/operations.md; {REJOIN} adopts the \
         history of the others"
    );
    for (.., at) in others {
        let same_block = names(&|other| other.hash == at.hash);
        if at.hash != own.hash && is_most(same_block.len()) {
            return Some(
                Rejection::new(Code::Forked, "the history of most voters differs from this node's")
                    .found(format!("block {} at height {}", own.hash, own.height))
                    .wanted(format!("block {}, which {} have", at.hash, same_block.join(", ")))
                    .next(next),
            );
        }
        let same_state = names(&|other| other == at);
        let voices: BTreeSet<_> = others.iter().filter(|(.., other)| other == at).map(|(_, of, _)| *of).collect();
        if at.hash == own.hash
            && is_most(same_state.len())
            && voices.len() >= organisations.len().min(ORGANISATIONS_MIN)
        {
            return Some(
                Rejection::new(Code::Diverged, "the world state of this node differs from that of most voters")
                    .found(format!("digest {} at height {}", own.digest, own.height))
                    .wanted(format!("digest {}, which {} have", at.digest, same_state.join(", "))),
            );
        }
    }
    None
}

/// Do the answers say that this node was removed? Then it fetches the blocks that prove it.
fn removed(said: &[Said], place: &Place, own: &str, height: u64) -> Option<Behind> {
    let strangers: Vec<_> = said.iter().filter(|one| one.stranger && one.has.height > height).collect();
    let organisations: BTreeSet<_> = strangers.iter().map(|one| one.who.organisation.as_str()).collect();
    let all: BTreeSet<_> = place.voters.values().map(String::as_str).collect();
    let enough = organisations.contains(own) || organisations.len() >= all.len().min(ORGANISATIONS_MIN);
    let newest = strangers.iter().max_by_key(|one| one.has.height)?;
    (place.cut_off && enough).then_some(Behind { from: 0, first_index: newest.has.height + 1 })
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use ledger_raft::{RaftMessage, ReceiptKey, Secret};

    fn point(height: u64, hash: u8, digest: u8) -> Point {
        Point { height, hash: Hash([hash; 32]), digest: Hash([digest; 32]) }
    }

    /// A chain whose blocks have the hash 1 and the digest 1.
    struct Own(u64);

    impl Chain for Own {
        fn point(&self, height: u64) -> Result<Option<Point>, Rejection> {
            Ok(Some(point(height.min(self.0), 1, 1)))
        }
    }

    fn own(height: u64) -> Own {
        Own(height)
    }

    fn said(id: u64, organisation: &str, height: u64, at: Option<Point>) -> Said {
        let who = Who { id, organisation: organisation.into(), name: format!("{organisation}/{id}"), vouched: false };
        let has = Holding { height, receipt: Some(confirmed(height)), ..Holding::default() };
        Said { who, has, at, stranger: false }
    }

    fn confirmed(index: u64) -> Receipt {
        ReceiptKey::new(2, &Secret::default()).committed(index)
    }

    fn place(voters: &[(u64, &str)]) -> Place {
        let voters: BTreeMap<_, _> = voters.iter().map(|(id, of)| (*id, (*of).to_owned())).collect();
        Place { members: voters.keys().copied().collect(), voters, cut_off: false }
    }

    fn code(own: Point, others: &[(&str, &str, Point)], place: &Place) -> Option<Code> {
        proof(own, others, place).map(|refused| refused.code)
    }

    #[test]
    fn another_state_is_proved_by_most_voters_of_two_organisations_that_agree_with_each_other() {
        let (own, other) = (point(9, 1, 1), point(9, 1, 2));
        let place = place(&[(1, "Org1"), (2, "Org1"), (3, "Org1"), (4, "Org2"), (5, "Org2")]);
        let three = [("a", "Org1", other), ("b", "Org1", other), ("c", "Org2", other)];
        assert_eq!(code(own, &three, &place), Some(Code::Diverged));
        assert_eq!(code(own, &three[..2], &place), None, "two of five");
        let one_voice = [("a", "Org1", other), ("b", "Org1", other), ("c", "Org1", other)];
        assert_eq!(code(own, &one_voice, &place), None, "one organisation");
        let third = [("a", "Org1", other), ("b", "Org1", other), ("c", "Org2", point(9, 1, 3))];
        assert_eq!(code(own, &third, &place), None, "they do not agree");
    }

    #[test]
    fn what_one_node_says_is_shown_and_stops_nobody_until_voters_say_the_same_at_one_height() {
        let place = Place { members: (1..=9).collect(), ..place(&[(1, "Org1"), (2, "Org2"), (3, "Org1")]) };
        let mut company = Company::new(own(100), "Org1", BTreeMap::new());
        for id in 5..=9 {
            company.told(id, &format!("Org2/liar{id}"), point(50, 1, 7)).unwrap();
        }
        assert!(company.is_in_doubt() && company.describe().contains("Org2/liar5 has another state at height 50"));
        let right = [said(2, "Org2", 100, Some(point(100, 1, 1))), said(3, "Org1", 90, Some(point(90, 1, 1)))];
        assert_eq!(company.heard(&right, &place, None).unwrap(), Follows::Nothing);
        // Voters that differ are asked about one height.
        let wrong = [said(2, "Org2", 100, Some(point(100, 1, 7))), said(3, "Org1", 90, Some(point(90, 1, 7)))];
        assert_eq!(company.heard(&wrong, &place, None).unwrap(), Follows::Ask(90));
        let at = Some(point(90, 1, 7));
        let wrong = [said(2, "Org2", 100, at), said(3, "Org1", 90, at)];
        let follows = company.heard(&wrong, &place, Some(90)).unwrap();
        assert!(matches!(&follows, Follows::Stop(refused) if refused.code == Code::Diverged), "{follows:?}");
        // Who has left counts no longer, and is not shown.
        let place = Place { members: (1..=3).collect(), ..place };
        company.heard(&right, &place, None).unwrap();
        assert_eq!(company.describe(), "");
    }

    #[test]
    fn a_voter_that_holds_less_than_it_had_confirmed_is_shown_until_it_has_it_again() {
        let place = place(&[(1, "Org1"), (2, "Org2"), (3, "Org1")]);
        let mut company = Company::new(own(100), "Org1", BTreeMap::from([(7, confirmed(9))]));
        for (height, shown) in
            [(80, ""), (90, ""), (60, "Org2/2 holds blocks up to height 60, and had confirmed 90"), (95, "")]
        {
            let said = [said(2, "Org2", height, Some(point(height, 1, 1)))];
            assert_eq!(company.heard(&said, &place, None).unwrap(), Follows::Nothing);
            assert_eq!(company.describe(), shown, "{height}");
        }
        assert_eq!(company.confirmed(), &BTreeMap::from([(2, confirmed(95))]), "one that votes no longer is forgotten");
    }

    #[test]
    fn another_block_is_proved_by_most_voters() {
        let (own, other) = (point(9, 1, 1), point(9, 2, 2));
        let place = place(&[(1, "Org1"), (2, "Org1"), (3, "Org2")]);
        assert_eq!(code(own, &[("a", "Org1", other), ("b", "Org1", other)], &place), Some(Code::Forked));
        assert_eq!(code(own, &[("a", "Org1", other)], &place), None);
        let alone = self::place(&[(1, "Org1"), (2, "Org2")]);
        assert_eq!(code(own, &[("a", "Org1", other)], &alone), None, "one of two");
    }

    #[test]
    fn nodes_of_one_foreign_organisation_do_not_remove_another() {
        let said = |of: &str, height: u64| Said { stranger: true, ..said(9, of, height, None) };
        let place = Place { cut_off: true, ..place(&[(1, "Org1"), (2, "Org2"), (3, "Org3")]) };
        let behind = |said: &[Said], place: &Place| removed(said, place, "Org3", 10);
        assert_eq!(behind(&[said("Org1", 20), said("Org1", 20)], &place), None);
        let fetch = Some(Behind { from: 0, first_index: 21 });
        assert_eq!(behind(&[said("Org1", 20), said("Org2", 15)], &place), fetch);
        assert_eq!(behind(&[said("Org3", 20)], &place), fetch, "its own organisation");
        assert_eq!(behind(&[said("Org1", 10), said("Org2", 10)], &place), None, "there is nothing to fetch");
        let led = Place { cut_off: false, ..place };
        assert_eq!(behind(&[said("Org1", 20), said("Org2", 15)], &led), None, "who has a leader was not removed");
    }

    #[test]
    fn a_voter_that_has_started_again_has_lost_nothing_that_its_disk_still_holds() {
        let place = place(&[(1, "Org1"), (2, "Org1"), (3, "Org2")]);
        let mut company = Company::new(own(40), "Org1", BTreeMap::new());
        let mut heard = |height, durable| {
            let mut said = said(2, "Org1", height, None);
            said.has.durable = durable;
            company.heard(&[said], &place, None).unwrap();
            company.describe()
        };
        assert_eq!(heard(38, 38), "");
        assert_eq!(heard(37, 38), "", "it has not learned yet how far its log is committed");
        assert!(heard(37, 37).contains("holds blocks up to height 37, and had confirmed 38"));
        assert_eq!(heard(37, 39), "");
    }

    #[test]
    fn a_voter_that_holds_less_than_it_had_confirmed_gets_no_vote() {
        let confirmed = BTreeMap::from([(2, confirmed(200))]);
        let company = Company::new(own(9), "Org1", confirmed);
        let message = |kind: RaftKind, index| {
            PeerMessage::Raft(RaftMessage { kind: kind as i32, index, ..RaftMessage::default() })
        };
        assert!(
            company.withholds(2, &message(RaftKind::Vote, 199)) && company.withholds(2, &message(RaftKind::PreVote, 1))
        );
        assert!(
            !company.withholds(2, &message(RaftKind::Vote, 200)) && !company.withholds(3, &message(RaftKind::Vote, 1))
        );
        assert!(!company.withholds(2, &message(RaftKind::Append, 1)));
    }

    #[test]
    fn a_node_whose_log_contradicts_this_one_is_shown_as_long_as_it_is_a_member() {
        let mut company = Company::new(own(9), "Org1", BTreeMap::new());
        let (ours, other) = (Hash([1; 32]), Hash([2; 32]));
        let found = Contradiction { node: 3, leads: true, term: 4, height: 12, own: ours, other };
        company.contradicted("Org2/node3", &found);
        let shown = "Org2/node3, which leads in term 4, has another log from height 12 or before";
        assert_eq!(company.describe(), shown);
        let place = |members: &[u64]| Place { members: members.iter().copied().collect(), ..Place::default() };
        assert_eq!(company.heard(&[], &place(&[1, 2, 3]), None).unwrap(), Follows::Nothing);
        assert_eq!(company.describe(), shown, "a claim alone stops nobody");
        company.heard(&[], &place(&[1, 2]), None).unwrap();
        assert_eq!(company.describe(), "");
    }
}
