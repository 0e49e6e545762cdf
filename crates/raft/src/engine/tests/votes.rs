//! Votes without keys, and mandates of them.

use super::*;
use crate::message::{Mandate, SignedVote};
use ledger::block::Header;
use ledger_storage::entry::Entry;

/// Only the genesis block is known: the links of these short logs stay in memory.
pub(super) struct Genesis;

impl ExecutedBlocks for Genesis {
    fn link(&self, height: u64) -> Option<Link> {
        (height == 0).then_some(Link { hash: Hash([7; 32]), time: 0 })
    }
}

/// Signs by writing down what is voted, and the voter. Real keys are tested where they are used.
pub(super) struct Names(pub u64);

impl Ballots for Names {
    fn sign(&self, ballot: Ballot) -> Result<Bytes, Rejection> {
        assert_eq!(ballot.voter, self.0, "only its own votes");
        Ok(signed(ballot.term, ballot.candidate, ballot.voter))
    }

    fn check(&self, ballot: Ballot, found: &[u8], _now: u64) -> Result<(), Rejection> {
        is_same(&signed(ballot.term, ballot.candidate, ballot.voter), found)
    }

    fn sign_handover(&self, handover: Handover) -> Result<Bytes, Rejection> {
        assert_eq!(handover.leader, self.0, "only its own word");
        Ok(signed_handover(handover))
    }

    fn check_handover(&self, handover: Handover, found: &[u8], _now: u64) -> Result<(), Rejection> {
        is_same(&signed_handover(handover), found)
    }

    fn sign_head(&self, head: LogHead) -> Result<(Bytes, Bytes), Rejection> {
        assert_eq!(head.leader, self.0, "only its own log");
        Ok((Bytes::new(), signed_head(head)))
    }

    fn check_head(&self, head: LogHead, vote: &[u8], found: &[u8], _now: u64) -> Result<(), Rejection> {
        is_same(&signed(head.term, head.leader, head.leader), vote)?;
        is_same(&signed_head(head), found)
    }
}

fn is_same(wanted: &[u8], found: &[u8]) -> Result<(), Rejection> {
    (wanted == found).then_some(()).ok_or_else(|| Rejection::new(Code::BadSignature, "not signed by it"))
}

/// The word of a leader that it hands over.
pub(super) fn signed_handover(handover: Handover) -> Bytes {
    [handover.term, handover.leader, handover.to].map(u64::to_be_bytes).concat().into()
}

/// The head of a leader's log.
pub(super) fn signed_head(head: LogHead) -> Bytes {
    [&[head.term, head.leader, head.height].map(u64::to_be_bytes).concat()[..], &head.hash.0].concat().into()
}

pub(super) fn signed(term: u64, candidate: u64, voter: u64) -> Bytes {
    [term, candidate, voter].map(u64::to_be_bytes).concat().into()
}

/// A leader shows a mandate of these voters.
pub(super) fn mandate(term: u64, leader: u64, voters: &[u64]) -> Input {
    let votes = voters.iter().map(|node| SignedVote { node: *node, signed: signed(term, leader, *node) });
    Input::Message { from: leader, message: PeerMessage::Mandate(Mandate { term, votes: votes.collect() }) }
}

/// Names the hash of the engine's own chain, and signs the head, as every honest peer does.
pub(super) fn name(engine: &Engine, from: u64, message: &mut RaftMessage) {
    let names = matches!(message.kind(), RaftKind::Append | RaftKind::AppendResponse) && !message.reject;
    let Some(link) = engine.chain.link(message.index).filter(|_| names && message.hash.is_empty()) else { return };
    message.hash = link.hash.0.to_vec().into();
    if message.kind() == RaftKind::Append {
        message.head = head(from, message, (link.hash, link.time));
    }
}

/// The signature of the head of an append after a block with this hash and time.
pub(super) fn head(from: u64, message: &RaftMessage, (mut hash, mut time): (Hash, u64)) -> Bytes {
    for WireEntry { index, term, kind, data } in &message.entries {
        let kind = EntryKind::from_code(u8::try_from(*kind).unwrap()).unwrap();
        let header = Header::following(hash, time, &Entry { index: *index, term: *term, kind, data: data.clone() });
        (hash, time) = (header.hash(), header.time);
    }
    let height = message.index + message.entries.len() as u64;
    signed_head(LogHead { term: message.term, leader: from, height, hash })
}

/// The same input, if it is a message, as an honest peer sends it.
pub(super) fn honest(engine: &Engine, mut input: Input) -> Input {
    if let Input::Message { from, message: PeerMessage::Raft(message) } = &mut input {
        name(engine, *from, message);
    }
    input
}

/// Steps as with honest peers: all voters have elected whoever of them leads, voters sign their votes, and chains agree.
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
        name(engine, from, message);
    }
    bare_step(engine, input)
}
