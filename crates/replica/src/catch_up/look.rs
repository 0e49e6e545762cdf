//! The question with which a node starts: what do the others have, and what do they know it to have had?
//!
//! **Its purpose.** A voter that has lost blocks which it acknowledged must not vote: with its vote the others could
//! elect a leader that lacks what was promised. It cannot tell by itself; the leader and the attestations can.
//!
//! **How long it takes.** A node that refuses a connection has answered. The node waits for silent ones until
//! [`ASK_TIME_MAX`] as long as a majority of the voters has not been heard, for then nothing can be ordered anyway. So it
//! does if there is nothing in the log, which looks like a lost disk. Otherwise silence costs [`PATIENCE`], and ordering
//! begins while the question is still open. Until it is closed this node gives no vote. It asks for none either, as its own
//! election timeout is longer. Everything that it acknowledges is on its disk. An answer that comes in that time and says
//! that blocks were lost ends the node as it would have before.

use super::{Holding, Who};
use crate::REJOIN;
use ledger_invariant::invariant;
use ledger_mutation::Mutation;
use ledger_raft::{PeerMessage, RaftKind};
use ledger_rejection::{Code, Rejection};
use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Time that the others have to say what they have, microseconds.
pub const ASK_TIME_MAX: u64 = 1_000_000;
/// Time that silent nodes cost a start when they are not needed, microseconds.
const PATIENCE: u64 = 200_000;

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
            && !ledger_mutation::active(Mutation::VoteBeforeTheAnswers)
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

/// The question of one start. Times: microseconds since any moment.
pub struct Look {
    me: u64,
    voters: BTreeSet<u64>,
    /// The last block of the log.
    last: u64,
    heard: BTreeSet<u64>,
    /// How many have not answered.
    silent: usize,
    asked_at: u64,
    election_time: u64,
    stage: Stage,
    ballot: Ballot,
}

impl Look {
    /// A node with this log asks so many others. `election_time`: it does not stand for election for so long.
    pub fn new(
        (now, me): (u64, u64),
        voters: BTreeSet<u64>,
        last: u64,
        asked: usize,
        election_time: u64,
        ballot: Ballot,
    ) -> Self {
        ballot.held.store(true, Ordering::Release);
        let (heard, stage) = (BTreeSet::new(), Stage::Asking);
        let mut look = Self { me, voters, last, heard, silent: asked, asked_at: now, election_time, stage, ballot };
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
                tracing::info!(silent = self.silent, "begins without the answer of silent nodes");
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
        let known = self.voters.iter().filter(|voter| **voter == self.me || self.heard.contains(voter)).count();
        self.last > 0 && (!self.voters.contains(&self.me) || known > self.voters.len() / 2)
    }

    /// Refuses if this node votes and another knows it to have had more than it has.
    fn check_kept(&self, who: &Who, has: &Holding) -> Result<(), Rejection> {
        if !has.you_vote || has.yours <= self.last {
            return Ok(());
        }
        Err(Rejection::new(Code::DiskFailed, "this voter has lost blocks that it had before")
            .found(format!("blocks up to height {}", self.last))
            .wanted(format!("at least height {}, which {} knows it to have had", has.yours, who.name))
            .next(format!("{REJOIN}: it comes back as a new node, because this one must not vote any more")))
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use ledger_raft::RaftMessage;

    fn look(me: u64, voters: u64, last: u64, asked: usize) -> Look {
        Look::new((0, me), (1..=voters).collect(), last, asked, 300_000, Ballot::default())
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

    #[test]
    fn a_voter_that_has_lost_blocks_is_told_so_even_by_a_late_answer() {
        let mut look = look(1, 3, 9, 2);
        hear(&mut look, 2);
        look.step(PATIENCE, Heard::Time).unwrap();
        let who = Who { id: 3, name: "Org2/node3".into(), ..Who::default() };
        let kept = Holding { yours: 9, you_vote: true, ..Holding::default() };
        let learner = Holding { yours: 10, you_vote: false, ..Holding::default() };
        let lost = Holding { yours: 10, you_vote: true, ..Holding::default() };
        look.step(PATIENCE, Heard::Answer(&who, &kept)).unwrap();
        look.step(PATIENCE, Heard::Answer(&who, &learner)).unwrap();
        let refused = look.step(PATIENCE, Heard::Answer(&who, &lost)).unwrap_err();
        assert!(refused.code == Code::DiskFailed && refused.wanted.contains("Org2/node3"), "{refused}");
    }
}
