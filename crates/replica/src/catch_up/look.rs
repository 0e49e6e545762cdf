//! The question with which a node starts: what do the others have, and what do they know it to have had?
//!
//! **Its purpose.** A voter that has lost blocks which it acknowledged must not vote: with its vote the others could
//! elect a leader that lacks what was promised. It cannot tell by itself; the others can.
//!
//! **Its proof.** One node that lies must not keep voters from starting. So a claim counts with a [`Receipt`] that the
//! starting node itself has made. It also counts if more than half of the voters say it, of two organisations if there are so
//! many. Any other claim is logged.
//!
//! **How long it takes.** A node that refuses a connection has answered. The node waits for silent ones until
//! [`ASK_TIME_MAX`] as long as a majority of the voters has not been heard, for then nothing can be ordered anyway. So it
//! does if there is nothing in the log, which looks like a lost disk. Otherwise silence costs [`PATIENCE`], and ordering
//! begins while the question is still open. Until it is closed this node gives no vote. It asks for none either, as its own
//! election timeout is longer. Everything that it acknowledges is on its disk. An answer that comes in that time and says
//! that blocks were lost ends the node as it would have before.

use super::{Holding, RECEIPTS_MAX, Who};
use crate::REJOIN;
use ledger_base::invariant;
use ledger_base::mutation::Mutation;
use ledger_base::rejection::{Code, Rejection};
use ledger_raft::{PeerMessage, RaftKind, Receipt, ReceiptKey};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Time that the others have to say what they have, microseconds.
pub const ASK_TIME_MAX: u64 = 1_000_000;
/// Time that silent nodes cost a start when they are not needed, microseconds.
const PATIENCE: u64 = 200_000;
/// Organisations whose voters must claim a loss, if voters are of so many.
const ORGANISATIONS_MIN: usize = 2;

/// Keeps a node from voting while the question is open. Clones share it.
#[derive(Clone, Default)]
pub struct Ballot {
    held: Arc<AtomicBool>,
}

impl Ballot {
    /// Is this a request for a vote that must not be given now? It is lost then, as on a bad network: who stands for
    /// election asks again.
    pub fn withholds(&self, message: &PeerMessage) -> bool {
        let votes = [RaftKind::Vote, RaftKind::PreVote].map(|kind| kind as i32);
        self.held.load(Ordering::Acquire)
            && !ledger_base::mutation::active(Mutation::VoteBeforeTheAnswers)
            && matches!(message, PeerMessage::Raft(message) if votes.contains(&message.kind))
    }
}

/// How far the question is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Stage {
    /// The node waits for answers.
    Asking,
    /// The node may begin, but not vote.
    Open,
    /// Nobody is waited for any more.
    Closed,
}

/// An answer, or the lack of one.
#[derive(Clone, Copy, Debug)]
pub enum Heard<'a> {
    /// A node has answered.
    Answer(&'a Who, &'a Holding),
    /// A node has refused to.
    Refusal,
    /// Time has gone on.
    Time,
}

/// The knowledge of a node about itself when it starts.
pub struct Own {
    /// Its number.
    pub id: u64,
    /// The voters as it knows them, with their organisations.
    pub voters: BTreeMap<u64, String>,
    /// The term on its disk.
    pub term: u64,
    /// The last block of its log.
    pub last: u64,
    /// Knows its own receipts again.
    pub key: ReceiptKey,
}

/// The question of one start. Times: microseconds since any moment.
pub struct Look {
    own: Own,
    heard: BTreeSet<u64>,
    /// Voters that say that this node had more than it has.
    claims: BTreeMap<u64, u64>,
    /// How many have not answered.
    silent: usize,
    asked_at: u64,
    election_time: u64,
    stage: Stage,
    ballot: Ballot,
}

impl Look {
    /// A node asks so many others. `election_time`: it does not stand for election for so long.
    pub fn new(now: u64, own: Own, asked: usize, election_time: u64, ballot: Ballot) -> Self {
        ballot.held.store(true, Ordering::Release);
        let (heard, claims, stage) = (BTreeSet::new(), BTreeMap::new(), Stage::Asking);
        let mut look = Self { own, heard, claims, silent: asked, asked_at: now, election_time, stage, ballot };
        look.move_on(now);
        look
    }

    /// Takes what happened, and says how far the question is.
    ///
    /// # Errors
    /// [`Code::DiskFailed`] if this node votes and has lost what it promised to keep.
    pub fn step(&mut self, now: u64, heard: Heard<'_>) -> Result<Stage, Rejection> {
        match heard {
            Heard::Answer(who, has) => {
                self.silent = self.silent.saturating_sub(1);
                self.check_kept(who, has)?;
                self.heard.insert(who.id);
            }
            Heard::Refusal => self.silent = self.silent.saturating_sub(1),
            Heard::Time => {}
        }
        self.move_on(now);
        Ok(self.stage)
    }

    /// How far the question is.
    pub fn stage(&self) -> Stage {
        self.stage
    }

    /// When it goes on although nobody answers; never, if it is closed.
    pub fn due(&self) -> Option<u64> {
        let after = match self.stage {
            Stage::Asking if self.is_enough() => PATIENCE,
            Stage::Asking => ASK_TIME_MAX,
            Stage::Open => ASK_TIME_MAX.min(PATIENCE + self.election_time),
            Stage::Closed => return None,
        };
        Some(self.asked_at + after)
    }

    fn move_on(&mut self, now: u64) {
        let is_due = self.due().is_some_and(|due| due <= now);
        let before = self.stage;
        self.stage = match before {
            _ if self.silent == 0 => Stage::Closed,
            Stage::Asking if is_due && self.is_enough() => {
                tracing::info!(silent = self.silent, "starting without the answer of unreachable nodes");
                Stage::Open
            }
            _ if is_due => Stage::Closed,
            stage => stage,
        };
        let after = self.stage;
        invariant!(after >= before, "a question that is closed stays closed", "{after:?} after {before:?}");
        if self.stage == Stage::Closed {
            self.ballot.held.store(false, Ordering::Release);
        }
    }

    /// Are those that were heard, with this node, a majority of the voters? A node without a vote needs nobody.
    fn is_enough(&self) -> bool {
        let Own { id, voters, last, .. } = &self.own;
        let known = voters.keys().filter(|voter| *voter == id || self.heard.contains(voter)).count();
        *last > 0 && (!voters.contains_key(id) || known > voters.len() / 2)
    }

    /// Refuses if this node votes and had more than it has.
    fn check_kept(&mut self, who: &Who, has: &Holding) -> Result<(), Rejection> {
        if !has.you_vote {
            return Ok(());
        }
        let Own { term, last, key, .. } = &self.own;
        let shown = has.receipts.iter().take(RECEIPTS_MAX).find(|receipt| key.shows_loss(receipt, *term, *last));
        let proof = match shown {
            Some(Receipt { index, .. }) => {
                Some((*index, format!("according to {}, which shows this node's own receipt", who.name)))
            }
            None => self.claimed(who, has.yours).map(|height| (height, "according to most voters".to_owned())),
        };
        let Some((height, proof)) = proof else { return Ok(()) };
        Err(Rejection::new(Code::DiskFailed, "this voter has lost blocks that it had before")
            .found(format!("blocks up to height {}", self.own.last))
            .wanted(format!("at least height {height}, {proof}"))
            .next(format!("{REJOIN}: it comes back as a new node, because this one must not vote any more")))
    }

    /// The height that this node has lost, if enough voters say so; `who` says that it had `height`.
    fn claimed(&mut self, who: &Who, height: u64) -> Option<u64> {
        let Own { voters, last, .. } = &self.own;
        if height <= *last {
            return None;
        }
        tracing::warn!(
            node = %who.name, height, last = *last,
            "a node reports that this voter had more blocks than now, without showing a receipt"
        );
        if who.id != self.own.id && voters.contains_key(&who.id) {
            self.claims.insert(who.id, height);
        }
        let organisations = |of: &mut dyn Iterator<Item = &String>| of.collect::<BTreeSet<_>>().len();
        let voices = organisations(&mut self.claims.keys().filter_map(|id| voters.get(id)));
        let enough = self.claims.len() * 2 > voters.len()
            && voices >= organisations(&mut voters.values()).min(ORGANISATIONS_MIN);
        self.claims.values().copied().min().filter(|_| enough)
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use ledger_raft::{RaftMessage, Secret};

    /// Voters with odd numbers are of Org1, the others of Org2.
    fn look(me: u64, voters: u64, last: u64, asked: usize) -> Look {
        let voters = (1..=voters).map(|id| (id, format!("Org{}", 2 - id % 2))).collect();
        let own = Own { id: me, voters, term: 4, last, key: key(me, 7) };
        Look::new(0, own, asked, 300_000, Ballot::default())
    }

    fn key(id: u64, secret: u8) -> ReceiptKey {
        ReceiptKey::new(id, &Secret([secret; 32]))
    }

    fn hear(look: &mut Look, id: u64) -> Stage {
        let who = Who { id, name: format!("node{id}"), ..Who::default() };
        look.step(1, Heard::Answer(&who, &Holding::default())).unwrap()
    }

    #[test]
    fn silence_of_those_that_a_majority_does_not_need_is_not_waited_for() {
        let patient = |me, voters, heard: &[u64]| {
            let mut look = look(me, voters, 9, 6);
            heard.iter().for_each(|id| assert_ne!(hear(&mut look, *id), Stage::Closed));
            look.due() == Some(ASK_TIME_MAX)
        };
        assert!(!patient(1, 1, &[]));
        assert!(!patient(4, 3, &[]), "a learner gives no vote");
        assert!(patient(1, 2, &[3]));
        assert!(patient(1, 3, &[4]));
        assert!(!patient(1, 3, &[2]));
        assert!(patient(1, 5, &[2]));
        assert!(!patient(1, 5, &[5, 2]));
    }

    #[test]
    fn an_empty_log_waits_for_everybody_as_it_looks_like_a_lost_disk() {
        let mut look = look(1, 3, 0, 2);
        assert_eq!(hear(&mut look, 2), Stage::Asking);
        assert_eq!(look.step(PATIENCE, Heard::Time).unwrap(), Stage::Asking);
        assert_eq!(look.step(ASK_TIME_MAX, Heard::Time).unwrap(), Stage::Closed);
    }

    #[test]
    fn no_vote_is_given_while_the_question_is_open() {
        let message = |kind: RaftKind| PeerMessage::Raft(RaftMessage { kind: kind as i32, ..RaftMessage::default() });
        let mut look = look(1, 3, 9, 2);
        let ballot = look.ballot.clone();
        hear(&mut look, 2);
        assert_eq!(look.step(PATIENCE, Heard::Time).unwrap(), Stage::Open);
        assert!(ballot.withholds(&message(RaftKind::Vote)) && ballot.withholds(&message(RaftKind::PreVote)));
        assert!(!ballot.withholds(&message(RaftKind::Append)) && !ballot.withholds(&message(RaftKind::Heartbeat)));
        assert_eq!(look.step(look.due().unwrap(), Heard::Time).unwrap(), Stage::Closed);
        assert!(!ballot.withholds(&message(RaftKind::Vote)));
    }

    fn claims(look: &mut Look, id: u64, has: Holding) -> Option<Rejection> {
        let who = Who { id, name: format!("node{id}"), ..Who::default() };
        look.step(PATIENCE, Heard::Answer(&who, &Holding { you_vote: true, ..has })).err()
    }

    fn shows(receipt: Receipt) -> Holding {
        Holding { yours: receipt.index, receipts: vec![receipt], ..Holding::default() }
    }

    #[test]
    fn a_voter_that_has_lost_blocks_is_shown_its_own_receipt_even_by_a_late_answer() {
        let mut look = look(1, 3, 9, 2);
        hear(&mut look, 2);
        look.step(PATIENCE, Heard::Time).unwrap();
        assert_eq!(claims(&mut look, 3, shows(key(1, 7).committed(9))), None, "it holds the block");
        let who = Who { id: 3, ..Who::default() };
        let learner = Holding { you_vote: false, ..shows(key(1, 7).committed(10)) };
        look.step(PATIENCE, Heard::Answer(&who, &learner)).unwrap();
        let refused = claims(&mut look, 3, shows(key(1, 7).committed(10))).unwrap();
        assert!(
            refused.code == Code::DiskFailed && refused.wanted.contains("height 10, according to node3"),
            "{refused}"
        );
    }

    #[test]
    fn one_node_that_lies_keeps_no_voter_from_starting() {
        let own = key(1, 7);
        let mut look = look(1, 3, 9, 9);
        let claim = Holding { yours: u64::MAX, ..Holding::default() };
        let forged = Receipt { index: 10, ..own.committed(9) };
        let other_term = Receipt { term: 9, ..own.committed(10) };
        let lies =
            [claim, shows(key(1, 8).committed(10)), shows(key(2, 7).committed(10)), shows(forged), shows(other_term)];
        for lie in lies {
            assert_eq!(claims(&mut look, 3, lie.clone()), None, "{lie:?}");
            assert_eq!(claims(&mut look, 7, lie.clone()), None, "no voter: {lie:?}");
        }
        let many =
            Holding { receipts: vec![Receipt::default(), Receipt::default(), own.committed(10)], ..Holding::default() };
        assert_eq!(claims(&mut look, 7, many), None, "more receipts than an honest node shows");
    }

    #[test]
    fn most_voters_of_two_organisations_are_believed_without_a_receipt() {
        let claim = || Holding { yours: 12, ..Holding::default() };
        let mut three = look(1, 3, 9, 2);
        assert_eq!(claims(&mut three, 3, claim()), None, "one of three");
        assert_eq!(claims(&mut three, 3, claim()), None, "the same again");
        assert!(claims(&mut three, 2, claim()).unwrap().wanted.contains("height 12, according to most voters"));
        let mut seven = look(2, 7, 9, 6);
        let one_organisation = [1, 3, 5, 7].map(|id| claims(&mut seven, id, claim()));
        assert_eq!(one_organisation, [const { None }; 4], "Org1 alone");
        assert!(claims(&mut seven, 4, claim()).is_some());
    }
}
