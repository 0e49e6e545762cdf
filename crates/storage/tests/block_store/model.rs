//! Random histories against a vector: every flushed entry survives every crash, in order.

use ledger_storage::block_store::Base;
use ledger_storage::disk::{Fault, SimDisk};
use ledger_storage::entry::{Entry, HardState};
use proptest::prelude::*;

use super::*;

#[derive(Debug, Clone)]
enum Step {
    /// Append entries of these sizes, this many below the end of the log.
    Append {
        back: u64,
        sizes: Vec<usize>,
    },
    Commit,
    Flush,
    FailingFlush {
        sync: bool,
    },
    Prepare,
    /// Drop what is this many entries below the newest committed one, and older.
    Prune {
        keep: u64,
        fails: bool,
    },
    /// Begin anew after a snapshot at this many entries above the newest committed one.
    BeginAfter {
        ahead: u64,
        fault: Option<u8>,
    },
    Crash,
    Kill,
}

fn step() -> impl Strategy<Value = Step> {
    prop_oneof![
        6 => (prop_oneof![3 => Just(0), 1 => 0_u64..6], prop::collection::vec(0_usize..900, 1..5))
            .prop_map(|(back, sizes)| Step::Append { back, sizes }),
        2 => Just(Step::Commit),
        5 => Just(Step::Flush),
        1 => any::<bool>().prop_map(|sync| Step::FailingFlush { sync }),
        2 => Just(Step::Prepare),
        3 => (0_u64..20, prop::bool::weighted(0.2)).prop_map(|(keep, fails)| Step::Prune { keep, fails }),
        1 => (1_u64..12, prop::option::of(0_u8..4)).prop_map(|(ahead, fault)| Step::BeginAfter { ahead, fault }),
        2 => Just(Step::Crash),
        1 => Just(Step::Kill),
    ]
}

/// The content that the store has to hold.
#[derive(Default)]
struct Model {
    /// The entry that the log follows.
    base: Base,
    /// The log as appended.
    log: Vec<Entry>,
    /// The log at the last successful flush.
    flushed: Vec<Entry>,
    /// Every state the log had since: any of them, or a part of the way between two, may be what a crash leaves.
    since: Vec<Vec<Entry>>,
    hard_state: HardState,
    flushed_hard_state: HardState,
    term: u64,
}

impl Model {
    fn last(&self) -> u64 {
        self.base.index + self.log.len() as u64
    }

    /// Compares a running store.
    fn check(&self, store: &BlockStore) {
        assert_eq!((store.first_index(), store.last_index()), (self.base.index + 1, self.last()));
        assert_eq!(store.term(self.base.index), Some(self.base.term));
        assert_eq!(all(store), self.log);
    }

    /// The log is cut to begin at `first`.
    fn cut(&mut self, first: u64) {
        assert!(first > self.base.index && first <= self.hard_state.commit + 1, "{first} above {:?}", self.hard_state);
        let Some(base) = self.log.iter().rfind(|entry| entry.index < first) else { return };
        self.base = Base { index: base.index, term: base.term };
        for log in [&mut self.log, &mut self.flushed].into_iter().chain(&mut self.since) {
            log.retain(|entry| entry.index >= first);
        }
    }

    fn begun(&mut self, base: Base) {
        let HardState { term, vote, .. } = self.hard_state;
        let hard_state =
            HardState { term: term.max(base.term), vote: if term >= base.term { vote } else { 0 }, commit: base.index };
        *self = Self { base, hard_state, flushed_hard_state: hard_state, term: self.term, ..Self::default() };
    }

    /// Compares after a restart, and goes on from what is there.
    fn restarted(&mut self, store: &BlockStore) {
        let first = store.first_index();
        let read = all(store);
        let possible = read == self.flushed || self.since.iter().any(|log| is_between(&self.flushed, log, &read));
        assert!(possible, "flushed {:?}, read {:?}", numbers(&self.flushed), numbers(&read));
        let hard_state = store.hard_state();
        let lifted = |state: HardState| HardState { commit: state.commit.max(first - 1), ..state };
        assert!([self.flushed_hard_state, self.hard_state].map(lifted).contains(&hard_state), "{hard_state:?}");
        assert!(hard_state.commit >= self.flushed_hard_state.commit && hard_state.commit <= store.last_index());
        assert_eq!(store.durable_index(), first - 1 + read.len() as u64);
        self.log.clone_from(&read);
        self.flushed = read;
        self.since.clear();
        self.hard_state = hard_state;
        self.flushed_hard_state = hard_state;
        self.check(store);
    }
}

fn numbers(log: &[Entry]) -> Vec<(u64, u64)> {
    log.iter().map(|entry| (entry.index, entry.term)).collect()
}

/// Whether `read` is what a cut-off write on the way from `flushed` to `later` leaves.
fn is_between(flushed: &[Entry], later: &[Entry], read: &[Entry]) -> bool {
    let common = flushed.iter().zip(later).take_while(|(one, other)| one == other).count();
    later.starts_with(read) && read.len() >= common
}

fn run(seed: u64, steps: Vec<Step>) {
    const SEGMENT_BYTES: u64 = 4000;
    let disk = SimDisk::new(seed);
    let mut store = open_with(&disk, SEGMENT_BYTES).unwrap().0;
    let mut model = Model { term: 1, ..Model::default() };
    for step in steps {
        match step {
            Step::Append { back, sizes } => {
                let committed = model.hard_state.commit;
                let from = (model.last() + 1).saturating_sub(back).max(committed + 1);
                if from <= model.last() {
                    model.term += 1;
                }
                let entries: Vec<Entry> = (from..)
                    .zip(sizes)
                    .map(|(index, size)| entry(index, model.term, &vec![(index + size as u64) as u8; size]))
                    .collect();
                store.append(&entries, None).unwrap();
                model.log.retain(|entry| entry.index < from);
                model.log.extend(entries);
                model.since.push(model.log.clone());
                model.check(&store);
            }
            Step::Commit => {
                let commit = (model.hard_state.commit + 2).min(model.last());
                model.hard_state = HardState { term: model.term, vote: 1, commit };
                store.append(&[], Some(&model.hard_state)).unwrap();
            }
            Step::Flush => {
                assert_eq!(store.flush().unwrap(), model.last());
                model.flushed.clone_from(&model.log);
                model.since.clear();
                model.flushed_hard_state = model.hard_state;
            }
            Step::FailingFlush { sync } => {
                if sync {
                    disk.fail_sync(1);
                } else {
                    disk.fail_write(1, Fault::Short(seed as usize % 700));
                }
                let failed = store.flush().is_err();
                disk.kill();
                // Faults that met nobody are forgotten with the crash.
                if !failed {
                    disk.crash();
                }
                store = open_with(&disk, SEGMENT_BYTES).unwrap().0;
                model.restarted(&store);
            }
            Step::Prepare => {
                store.prepare().unwrap();
            }
            Step::Prune { keep, fails } => {
                let keep_from = (model.hard_state.commit + 1).saturating_sub(keep);
                if fails {
                    disk.fail_dir_sync();
                }
                let pruned = store.prune(keep_from);
                let reached = store.first_index();
                assert!(reached <= keep_from.max(model.base.index + 1));
                if fails {
                    disk.crash();
                    store = open_with(&disk, SEGMENT_BYTES).unwrap().0;
                    assert!(store.first_index() <= reached);
                    model.cut(store.first_index());
                    model.restarted(&store);
                } else {
                    assert_eq!(pruned.unwrap(), reached);
                    model.cut(reached);
                    model.check(&store);
                }
            }
            Step::BeginAfter { ahead, fault } => {
                model.term += 1;
                let base = Base { index: model.hard_state.commit + ahead, term: model.term };
                match fault {
                    None => {}
                    Some(0) => disk.fail_write(1, Fault::Error),
                    Some(1) => disk.fail_write(1, Fault::Short(seed as usize % 150)),
                    Some(2) => disk.fail_sync(1),
                    Some(_) => disk.fail_dir_sync(),
                }
                let result = store.begin_after(base);
                assert_eq!(result.is_ok(), fault.is_none());
                if fault.is_some() {
                    disk.crash();
                    store = open_with(&disk, SEGMENT_BYTES).unwrap().0;
                    if store.first_index() == base.index + 1 && store.term(base.index) == Some(base.term) {
                        model.begun(base);
                    }
                    model.restarted(&store);
                } else {
                    model.begun(base);
                    model.check(&store);
                }
            }
            Step::Crash | Step::Kill => {
                if matches!(step, Step::Crash) {
                    disk.crash()
                } else {
                    disk.kill()
                }
                store = open_with(&disk, SEGMENT_BYTES).unwrap().0;
                model.restarted(&store);
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn every_flushed_entry_survives_in_order(seed in any::<u64>(), steps in prop::collection::vec(step(), 1..60)) {
        run(seed, steps);
    }
}
