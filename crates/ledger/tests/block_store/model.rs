//! Random histories against a vector: every flushed entry survives every crash, in order.

use ledger::disk::SimDisk;
use ledger::entry::{Entry, HardState};
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
        2 => Just(Step::Crash),
        1 => Just(Step::Kill),
    ]
}

/// What the store has to hold.
#[derive(Default)]
struct Model {
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
    /// Compares after a restart, and goes on from what is there.
    fn restarted(&mut self, store: &BlockStore) {
        let read = all(store);
        let possible = read == self.flushed || self.since.iter().any(|log| is_between(&self.flushed, log, &read));
        assert!(possible, "flushed {:?}, read {:?}", numbers(&self.flushed), numbers(&read));
        let hard_state = store.hard_state();
        assert!(hard_state == self.flushed_hard_state || hard_state == self.hard_state);
        assert!(hard_state.commit >= self.flushed_hard_state.commit && hard_state.commit <= read.len() as u64);
        assert!(store.durable_index() == read.len() as u64);
        self.log.clone_from(&read);
        self.flushed = read;
        self.since.clear();
        self.hard_state = hard_state;
        self.flushed_hard_state = hard_state;
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
                let from = (model.log.len() as u64 + 1).saturating_sub(back).max(committed + 1);
                if from <= model.log.len() as u64 {
                    model.term += 1;
                }
                let entries: Vec<Entry> = (from..)
                    .zip(sizes)
                    .map(|(index, size)| entry(index, model.term, &vec![(index + size as u64) as u8; size]))
                    .collect();
                store.append(&entries, None).unwrap();
                model.log.truncate(from as usize - 1);
                model.log.extend(entries);
                model.since.push(model.log.clone());
                assert_eq!(all(&store), model.log);
            }
            Step::Commit => {
                let commit = (model.hard_state.commit + 2).min(model.log.len() as u64);
                model.hard_state = HardState { term: model.term, vote: 1, commit };
                store.append(&[], Some(&model.hard_state)).unwrap();
            }
            Step::Flush => {
                assert_eq!(store.flush().unwrap(), model.log.len() as u64);
                model.flushed.clone_from(&model.log);
                model.since.clear();
                model.flushed_hard_state = model.hard_state;
            }
            Step::FailingFlush { sync } => {
                if sync {
                    disk.fail_sync(1);
                } else {
                    disk.fail_write(1, ledger::disk::Fault::Short(seed as usize % 700));
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
