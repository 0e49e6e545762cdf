//! Votes without keys, and mandates of them.

use super::*;
use crate::message::{Mandate, SignedVote};

/// Signs by writing down what is voted, and the voter. Real keys are tested where they are used.
pub(super) struct Names(pub u64);

impl Ballots for Names {
    fn sign(&self, ballot: Ballot) -> Result<Bytes, Rejection> {
        assert_eq!(ballot.voter, self.0, "only its own votes");
        Ok(signed(ballot.term, ballot.candidate, ballot.voter))
    }

    fn check(&self, ballot: Ballot, found: &[u8], _now: u64) -> Result<(), Rejection> {
        let good = signed(ballot.term, ballot.candidate, ballot.voter)[..] == *found;
        good.then_some(()).ok_or_else(|| Rejection::new(Code::BadSignature, "not signed by it"))
    }
}

pub(super) fn signed(term: u64, candidate: u64, voter: u64) -> Bytes {
    [term, candidate, voter].map(u64::to_be_bytes).concat().into()
}

/// A leader shows a mandate of these voters.
pub(super) fn mandate(term: u64, leader: u64, voters: &[u64]) -> Input {
    let votes = voters.iter().map(|node| SignedVote { node: *node, signed: signed(term, leader, *node) });
    Input::Message { from: leader, message: PeerMessage::Mandate(Mandate { term, votes: votes.collect() }) }
}

/// Steps as with honest peers: all voters have elected whoever of them leads, and voters sign their votes.
pub(super) fn step(engine: &mut Engine, mut input: Input) -> Vec<Output> {
    if let Input::Message { from, message: PeerMessage::Raft(message) } = &mut input {
        let (from, leads) = (*from, matches!(message.kind(), RaftKind::Append | RaftKind::Heartbeat));
        let voters: Vec<u64> = engine.membership.voters.iter().copied().collect();
        if leads && voters.contains(&from) && message.term >= engine.raw.raft.term {
            bare_step(engine, mandate(message.term, from, &voters));
        }
        if message.kind() == RaftKind::VoteResponse && !message.reject {
            message.vote = signed(message.term, engine.config.id, from);
        }
    }
    bare_step(engine, input)
}
