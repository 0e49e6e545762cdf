//! The work that the thread that orders may execute itself: a little, if nothing else is to be done, as waking the
//! other thread takes longer.

use ledger_storage::entry::Entry;

/// Bytes of blocks that are executed in place at most: some commands.
const BYTES_MAX: usize = 4096;
/// Microseconds that executing in place may take. Heartbeats and writes must not wait for a slow chaincode.
const TIME_MAX: u64 = 1_000;
/// Times that nothing is executed in place after it took longer.
const HANDED_OVER_AFTERWARDS: u32 = 1000;

/// The other work when blocks are to be executed.
#[derive(Clone, Copy, Debug)]
pub struct Circumstances {
    /// Inputs wait: they are to be ordered while the other thread executes.
    pub inputs_wait: bool,
    /// The other thread has executed everything it was given.
    pub other_is_idle: bool,
}

/// The limit of the work that the thread that orders executes itself.
#[derive(Default)]
pub(crate) struct InPlace {
    /// Times that it may not, since it took too long.
    not_before: u32,
}

impl InPlace {
    /// Are these blocks to be executed in place? `awaited`: somebody waits for what this thread does next, a leader for
    /// what a voter that follows writes.
    pub(crate) fn allows(&mut self, entries: &[Entry], awaited: bool, now: Circumstances) -> bool {
        if awaited {
            return false;
        }
        let quick = self.not_before == 0;
        self.not_before = self.not_before.saturating_sub(1);
        quick
            && !now.inputs_wait
            && now.other_is_idle
            && entries.iter().map(|entry| entry.data.len()).sum::<usize>() <= BYTES_MAX
    }

    /// Executing them took so many microseconds.
    pub(crate) fn took(&mut self, time: u64) {
        if time > TIME_MAX {
            self.not_before = HANDED_OVER_AFTERWARDS;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ledger_storage::entry::EntryKind;

    fn block(bytes: usize) -> Vec<Entry> {
        vec![Entry { index: 1, term: 1, kind: EntryKind::Normal, data: vec![0; bytes].into() }]
    }

    /// Nothing speaks against executing in place.
    const QUIET: Circumstances = Circumstances { inputs_wait: false, other_is_idle: true };

    #[test]
    fn nothing_is_executed_in_place_while_the_other_thread_executes() {
        let busy = Circumstances { other_is_idle: false, ..QUIET };
        assert!(!InPlace::default().allows(&block(400), false, busy));
    }

    #[test]
    fn a_voter_that_follows_writes_and_does_not_execute_in_place() {
        assert!(!InPlace::default().allows(&block(400), true, QUIET));
    }

    #[test]
    fn what_waits_is_ordered_before_anything_is_executed_in_place() {
        let inputs_wait = Circumstances { inputs_wait: true, ..QUIET };
        assert!(!InPlace::default().allows(&block(400), false, inputs_wait));
    }

    #[test]
    fn much_is_left_to_the_other_thread() {
        assert!(InPlace::default().allows(&block(BYTES_MAX), false, QUIET));
        assert!(!InPlace::default().allows(&block(BYTES_MAX + 1), false, QUIET));
    }

    #[test]
    fn a_slow_chaincode_leaves_the_next_blocks_to_the_other_thread() {
        let mut in_place = InPlace::default();
        assert!(in_place.allows(&block(400), false, QUIET));
        in_place.took(TIME_MAX);
        assert!(in_place.allows(&block(400), false, QUIET), "that was quick enough");
        in_place.took(TIME_MAX * 2);
        for left in (0..HANDED_OVER_AFTERWARDS).rev() {
            assert!(!in_place.allows(&block(400), false, QUIET), "{left} left");
        }
        assert!(in_place.allows(&block(400), false, QUIET));
    }
}
