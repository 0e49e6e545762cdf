//! The promises of an engine that one step must not break; the crate that it is built on is not believed.

use super::Engine;
use ledger_base::{costly_invariant, invariant};

/// The state that only moves forward, as of the last step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Promised {
    term: u64,
    /// 0: none in this term.
    vote: u64,
    committed: u64,
    /// The last height handed out.
    emitted: u64,
    applied: u64,
}

impl Promised {
    fn of(engine: &Engine) -> Self {
        let raft = &engine.raw.raft;
        let (emitted, applied) = (engine.emitted, engine.applied);
        Self { term: raft.term, vote: raft.vote, committed: raft.raft_log.committed, emitted, applied }
    }

    /// Before anything was promised.
    pub(super) const NONE: Self = Self { term: 0, vote: 0, committed: 0, emitted: 0, applied: 0 };

    /// States that `now` may follow.
    fn check(&self, now: &Self) {
        let Self { term, vote, committed, emitted, applied } = *now;
        invariant!(term >= self.term, "the term never goes back", "term {term} after {}", self.term);
        invariant!(
            term > self.term || self.vote == 0 || vote == self.vote,
            "a vote is given once in a term",
            "a vote for {vote} after one for {} in term {term}",
            self.vote
        );
        invariant!(
            committed >= self.committed,
            "a committed block stays committed",
            "block {committed} after {}",
            self.committed
        );
        invariant!(
            emitted >= self.emitted && emitted <= committed,
            "only committed blocks are handed out, each once",
            "block {emitted} after {}, committed {committed}",
            self.emitted
        );
        invariant!(
            applied >= self.applied && applied <= emitted,
            "only blocks that were handed out are executed, each once",
            "block {applied} after {}, handed out {emitted}",
            self.applied
        );
    }
}

impl Engine {
    /// Looks whether the step kept every promise, before anybody learns of it.
    pub(super) fn keep_promises(&mut self) {
        let now = Promised::of(self);
        self.promised.check(&now);
        self.promised = now;
        let log = &self.raw.raft.raft_log;
        let (persisted, last) = (log.persisted, log.last_index());
        invariant!(
            persisted <= last,
            "the disk has nothing that the log lacks",
            "block {persisted}, the log ends at {last}"
        );
        invariant!(
            self.chain.last() == last,
            "the hash of every entry is known",
            "hashes up to {}, the log ends at {last}",
            self.chain.last()
        );
        costly_invariant!(
            self.waiting_bytes() == (self.unpersisted_bytes, self.unapplied_bytes),
            "counted bytes are those that wait",
            "{:?}, counted {} and {}",
            self.waiting_bytes(),
            self.unpersisted_bytes,
            self.unapplied_bytes
        );
    }

    /// Bytes that wait for the disk, and for execution.
    fn waiting_bytes(&self) -> (usize, usize) {
        let pending = self.pending.iter().map(|ready| ready.bytes);
        (pending.sum(), self.unapplied.iter().map(|(_, bytes)| bytes).sum())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::panic::catch_unwind;

    const BEFORE: Promised = Promised { term: 3, vote: 2, committed: 9, emitted: 8, applied: 7 };

    #[test]
    fn a_step_that_only_goes_on_is_believed() {
        BEFORE.check(&BEFORE);
        BEFORE.check(&Promised { term: 4, vote: 0, committed: 10, emitted: 10, applied: 10 });
        Promised { vote: 0, ..BEFORE }.check(&BEFORE);
    }

    #[test]
    fn a_step_that_takes_back_a_promise_is_found() {
        for (broken, found) in [
            (Promised { term: 2, ..BEFORE }, "term 2 after 3"),
            (Promised { vote: 1, ..BEFORE }, "a vote for 1 after one for 2 in term 3"),
            (Promised { vote: 0, ..BEFORE }, "a vote for 0 after one for 2 in term 3"),
            (Promised { committed: 8, ..BEFORE }, "block 8 after 9"),
            (Promised { emitted: 10, ..BEFORE }, "block 10 after 8, committed 9"),
            (Promised { emitted: 7, ..BEFORE }, "block 7 after 8, committed 9"),
            (Promised { applied: 9, ..BEFORE }, "block 9 after 7, handed out 8"),
            (Promised { applied: 6, ..BEFORE }, "block 6 after 7, handed out 8"),
        ] {
            let panic = catch_unwind(|| BEFORE.check(&broken)).err();
            let text = panic.and_then(|panic| panic.downcast::<String>().ok()).unwrap_or_default();
            assert!(text.ends_with(found), "{broken:?}: {text}");
        }
    }
}
