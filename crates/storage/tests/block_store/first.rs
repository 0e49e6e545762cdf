//! Logs that do not begin at 1: old segments dropped, or begun anew after a snapshot.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};

use ledger_storage::block_store::Base;
use ledger_storage::disk::{Disk as _, Fault};

use super::*;

const SEGMENT_BYTES: u64 = 600;

/// Entries 1 to `last`, one flush each, every one committed.
fn filled(disk: &SimDisk, last: u64) -> BlockStore {
    let (store, _) = open_with(disk, SEGMENT_BYTES).unwrap();
    for index in 1..=last {
        let term = index / 10 + 1;
        store.append(&[plain(index, term)], Some(&HardState { term, vote: 3, commit: index - 1 })).unwrap();
        store.flush().unwrap();
    }
    store.set_committed(last);
    store
}

fn numbers(store: &BlockStore) -> Vec<u64> {
    all(store).iter().map(|entry| entry.index).collect()
}

#[test]
fn old_segments_are_dropped_and_the_log_goes_on_where_it_was() {
    let disk = SimDisk::new(1);
    let store = filled(&disk, 60);
    let before = segments(&disk).len();
    let finished = store.finished();
    assert_eq!(finished.len(), before - 1);
    assert!(finished.windows(2).all(|pair| pair[0].next_index == pair[1].first_index));
    assert!(finished.iter().all(|segment| segment.bytes > 500 && segment.bytes <= SEGMENT_BYTES), "{finished:?}");
    assert_eq!(open_with(&disk.copy(7), SEGMENT_BYTES).unwrap().0.finished(), finished);
    let first = store.prune(31).unwrap();
    assert_eq!(store.finished()[..], finished[before - segments(&disk).len()..]);
    assert!(finished.iter().any(|segment| segment.next_index == first));
    assert!(first > 20 && first <= 31, "{first}");
    assert!(segments(&disk).len() < before);
    let term = |index: u64| index / 10 + 1;
    for restarted in [false, true] {
        let store = if restarted { &open_with(&disk, SEGMENT_BYTES).unwrap().0 } else { &store };
        assert_eq!((store.first_index(), store.last_index()), (first, 60));
        assert_eq!(numbers(store), (first..=60).collect::<Vec<_>>());
        assert_eq!((store.term(first - 1), store.term(first - 2)), (Some(term(first - 1)), None));
        assert_eq!(
            (store.entry(first - 1).unwrap(), store.entry(first).unwrap().unwrap()),
            (None, plain(first, term(first)))
        );
        assert!(matches!(store.append(&[plain(first - 1, 9)], None), Err(StoreError::Gap { wanted: 61, .. })));
    }
    assert_eq!(store.prune(31).unwrap(), first, "nothing more to drop");
    flush_entry(&store, plain(61, 9));
    disk.crash();
    let (store, recovery) = open_with(&disk, SEGMENT_BYTES).unwrap();
    assert_eq!((recovery.first_index, recovery.last_index, recovery.torn), (first, 61, None));
    assert_eq!(
        (recovery.hard_state.term, recovery.hard_state.vote),
        (7, 3),
        "kept although the first segments are gone"
    );
    assert!(store.committed() >= first - 1);
}

#[test]
fn what_is_not_committed_or_not_durable_or_being_written_is_not_dropped() {
    let disk = SimDisk::new(1);
    let (store, _) = open_with(&disk, SEGMENT_BYTES).unwrap();
    for index in 1..=30 {
        flush_entry(&store, plain(index, 1));
    }
    assert_eq!(store.prune(u64::MAX).unwrap(), 1, "nothing is committed");
    store.set_committed(12);
    let first = store.prune(u64::MAX).unwrap();
    assert!(first > 1 && first <= 13, "{first}");
    store.append(&[plain(31, 1)], None).unwrap();
    store.set_committed(31);
    let newest = store.prune(u64::MAX).unwrap();
    assert_eq!(segments(&disk).len(), 1);
    assert!(newest <= 30, "the segment being written stays");
    assert_eq!(numbers(&store), (newest..=31).collect::<Vec<_>>());
    disk.crash();
    let (store, recovery) = open_with(&disk, SEGMENT_BYTES).unwrap();
    // Nobody wrote down what is committed, but only what is was dropped.
    assert_eq!((store.committed(), recovery.hard_state.commit, recovery.last_index), (newest - 1, newest - 1, 30));
}

#[test]
fn entries_superseded_across_segments_stay_so_when_the_front_is_dropped() {
    for back in 1..40 {
        let disk = SimDisk::new(back);
        let (store, _) = open_with(&disk, SEGMENT_BYTES).unwrap();
        for index in 1..=40 {
            flush_entry(&store, plain(index, 1));
        }
        for index in 41 - back..=60 {
            flush_entry(&store, plain(index, 2));
        }
        store.set_committed(60);
        let expected = all(&store);
        for keep_from in 1..=61 {
            let first = store.prune(keep_from).unwrap();
            let (again, recovery) = open_with(&disk.copy(7), SEGMENT_BYTES).unwrap();
            assert_eq!(recovery.first_index, first);
            for store in [&store, &again] {
                assert_eq!(all(store), expected[first as usize - 1..], "back {back}, first {first}");
                let term = if first == 1 { 0 } else { expected[first as usize - 2].term };
                assert_eq!(store.term(first - 1), Some(term), "back {back}, first {first}");
            }
        }
        assert!(store.first_index() > 40);
    }
}

#[test]
fn a_crash_or_failure_while_segments_are_dropped_leaves_a_log_without_a_gap() {
    for seed in 0..100 {
        let disk = SimDisk::new(seed);
        let store = filled(&disk, 60);
        if seed % 2 == 0 {
            disk.fail_dir_sync();
            let error = store.prune(50).unwrap_err();
            assert_eq!(store.append(&[plain(61, 9)], None).unwrap_err().to_string(), error.to_string());
        } else {
            store.prune(50).unwrap();
        }
        disk.crash();
        let (store, recovery) = open_with(&disk, SEGMENT_BYTES).unwrap();
        assert!(recovery.first_index <= 50 && recovery.last_index == 60, "seed {seed}");
        assert_eq!(numbers(&store), (recovery.first_index..=60).collect::<Vec<_>>());
        flush_entry(&store, plain(61, 9));
    }
}

#[test]
fn readers_that_come_too_late_for_a_dropped_entry_get_none() {
    let disk = SimDisk::new(1);
    let store = Arc::new(filled(&disk, 300));
    std::thread::scope(|scope| {
        scope.spawn(|| {
            for keep_from in 1..=290 {
                store.prune(keep_from).unwrap();
            }
        });
        for _ in 0..2 {
            scope.spawn(|| {
                while store.first_index() < 280 {
                    let read = store.entries(1..40, usize::MAX).unwrap();
                    assert!(read.windows(2).all(|pair| pair[0].index + 1 == pair[1].index));
                    assert!(store.entry(295).unwrap().is_some());
                }
            });
        }
    });
}

#[test]
fn a_node_that_is_behind_goes_on_after_a_snapshot() {
    for entries in [0, 7] {
        let disk = SimDisk::new(1);
        let store = filled(&disk, entries);
        let base = Base { index: 5000, term: 40 };
        store.append(&[plain(entries + 1, 2)], None).unwrap();
        store.begin_after(base).unwrap();
        assert_eq!(segments(&disk).len(), 1);
        for restarted in [false, true] {
            let store = if restarted { &open_with(&disk, SEGMENT_BYTES).unwrap().0 } else { &store };
            assert_eq!((store.first_index(), store.last_index(), store.durable_index()), (5001, 5000, 5000));
            assert_eq!((store.committed(), store.hard_state()), (5000, HardState { term: 40, vote: 0, commit: 5000 }));
            assert_eq!((store.term(5000), store.term(4999), store.entry(5000).unwrap()), (Some(40), None, None));
            assert!(matches!(store.append(&[plain(1, 50)], None), Err(StoreError::Gap { found: 1, wanted: 5001 })));
            store.begin_after(base).unwrap();
        }
        for index in 5001..=5040 {
            flush_entry(&store, plain(index, 41));
        }
        disk.crash();
        let store = open_with(&disk, SEGMENT_BYTES).unwrap().0;
        assert_eq!(numbers(&store), (5001..=5040).collect::<Vec<_>>());
        store.set_committed(5040);
        assert!(store.prune(5030).unwrap() > 5010);
    }
}

#[test]
fn term_and_vote_outlive_a_beginning_after_a_snapshot() {
    for (base_term, vote) in [(1, 3), (2, 3), (3, 0)] {
        let disk = SimDisk::new(1);
        let (store, _) = open(&disk);
        store.append(&[plain(1, 1)], Some(&HardState { term: 2, vote: 3, commit: 0 })).unwrap();
        store.flush().unwrap();
        store.begin_after(Base { index: 9, term: base_term }).unwrap();
        drop(store);
        let recovered = open(&disk).1.hard_state;
        assert_eq!(recovered, HardState { term: base_term.max(2), vote, commit: 9 });
    }
}

#[test]
fn a_log_that_is_not_behind_a_snapshot_is_not_thrown_away() {
    let disk = SimDisk::new(1);
    let store = filled(&disk, 20);
    for index in 21..=30 {
        flush_entry(&store, plain(index, 3));
    }
    for base in [Base { index: 5, term: 1 }, Base { index: 20, term: 9 }, Base { index: 25, term: 3 }] {
        assert!(
            matches!(store.begin_after(base), Err(StoreError::NotBehind { last: 30, committed: 20, .. })),
            "{base:?}"
        );
    }
    assert_eq!(numbers(&store), (1..=30).collect::<Vec<_>>());
    // Entry 25 of another term was committed: then what this node has from there on never was.
    store.begin_after(Base { index: 25, term: 4 }).unwrap();
    assert_eq!((store.first_index(), store.last_index()), (26, 25));
}

#[test]
fn a_crash_while_the_log_begins_anew_leaves_the_old_or_the_new_one() {
    let faults: [fn(&SimDisk); 6] = [
        |_| {},
        |disk| disk.fail_write(1, Fault::Error),
        |disk| disk.fail_write(1, Fault::Short(50)),
        |disk| disk.fail_sync(1),
        |disk| disk.fail_dir_sync(),
        |disk| disk.fail_write(1, Fault::Full(10)),
    ];
    let (mut old, mut new) = (0, 0);
    for (number, fault) in faults.iter().enumerate() {
        for seed in 0..40 {
            let disk = SimDisk::new(seed);
            let store = filled(&disk, 20);
            fault(&disk);
            let result = store.begin_after(Base { index: 50, term: 9 });
            assert_eq!(result.is_ok(), number == 0, "{result:?}");
            if number == 5 {
                assert!(matches!(result, Err(StoreError::DiskFull { .. })));
                assert_eq!(numbers(&store), (1..=20).collect::<Vec<_>>());
                flush_entry(&store, plain(21, 3));
                continue;
            }
            disk.crash();
            let (store, recovery) = open_with(&disk, SEGMENT_BYTES).unwrap();
            match (recovery.first_index, recovery.last_index) {
                (1, 20) => old += 1,
                (51, 50) => new += 1,
                other => panic!("fault {number}, seed {seed}: {other:?}"),
            }
            assert!(number != 0 || recovery.first_index == 51);
            let next = store.last_index() + 1;
            flush_entry(&store, plain(next, 9));
            let ours = |name: &String| name == "oldest" || parse_name(name).is_some();
            assert!(disk.list().unwrap().iter().all(ours), "nothing is left over");
            drop(store);
            assert_eq!(open_with(&disk, SEGMENT_BYTES).unwrap().1.last_index, next);
        }
    }
    assert!(old > 40 && new > 40, "both were seen: {old}, {new}");
}

#[test]
fn a_flipped_bit_in_any_segment_that_is_left_is_noticed() {
    let disk = SimDisk::new(1);
    let store = filled(&disk, 60);
    let first = store.prune(40).unwrap();
    let expected = all(&store);
    let sealed = segments(&disk).len() - 1;
    for (number, name) in segments(&disk).iter().enumerate() {
        let bits = disk.contents(name).unwrap().len() as u64 * 8;
        for bit in (0..bits).step_by(13) {
            let damaged = disk.copy(7);
            assert!(damaged.flip(name, bit));
            match open_with(&damaged, SEGMENT_BYTES) {
                Err(StoreError::Corrupt { file, .. }) => assert!(file == *name || number < sealed, "{file}"),
                Err(other) => panic!("{name} bit {bit}: {other}"),
                // A finished segment is read later.
                Ok((store, _)) if number < sealed => {
                    for entry in &expected {
                        match store.entry(entry.index) {
                            Ok(read) => assert_eq!(read.as_ref(), Some(entry), "{name} bit {bit}"),
                            Err(error) => assert!(matches!(error, StoreError::Corrupt { .. }), "{error}"),
                        }
                    }
                    let found = store.check_finished(|_| true).unwrap_err();
                    assert!(matches!(found, StoreError::Corrupt { .. }), "{name} bit {bit}: {found}");
                }
                // What nothing vouches for yet: the last write, and zeros behind it.
                Ok((store, recovery)) => {
                    assert!(number == sealed && expected.starts_with(&all(&store)), "{name} bit {bit}");
                    assert!(recovery.first_index == first && recovery.last_index >= 59, "{name} bit {bit}");
                }
            }
        }
    }
    assert!(!disk.flip("no such file", 0));
}

#[test]
fn a_flush_under_way_and_dropping_do_not_disturb_each_other() {
    let disk = SimDisk::new(1);
    let store = Arc::new(OnceLock::new());
    assert!(store.set(filled(&disk, 60)).is_ok());
    let (during, begun) = (Arc::clone(&store), AtomicBool::new(false));
    disk.before_sync(move || {
        // Dropping writes, too.
        if !begun.swap(true, Ordering::Relaxed) {
            let store: &BlockStore = during.get().unwrap();
            store.prune(45).unwrap();
        }
    });
    let store: &BlockStore = store.get().unwrap();
    store.append(&(61..=80).map(|index| plain(index, 8)).collect::<Vec<_>>(), None).unwrap();
    assert_eq!(store.flush().unwrap(), 80);
    let first = store.first_index();
    assert!(first > 35, "{first}");
    disk.kill();
    assert_eq!(numbers(&open_with(&disk, SEGMENT_BYTES).unwrap().0), (first..=80).collect::<Vec<_>>());
}

#[test]
fn no_more_than_a_bounded_number_of_segments_is_open() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("blocks");
    let open_files = || {
        let here = std::fs::canonicalize(&path).unwrap();
        let links =
            std::fs::read_dir("/proc/self/fd").unwrap().filter_map(|fd| std::fs::read_link(fd.unwrap().path()).ok());
        links.filter(|link| link.starts_with(&here)).count()
    };
    let (store, _) = BlockStore::open(Arc::new(RealDisk::open(&path).unwrap()), options(600)).unwrap();
    for index in 1..=800 {
        flush_entry(&store, plain(index, 1));
    }
    assert_eq!(all(&store).len(), 800);
    // Some of those that are dropped are among those kept open.
    store.set_committed(800);
    assert!(store.prune(790).unwrap() > 780);
    assert!(open_files() <= 5, "{}", open_files());
    for index in 801..=1600 {
        flush_entry(&store, plain(index, 1));
    }
    assert_eq!(all(&store).len() as u64, 1601 - store.first_index());
    assert!(std::fs::read_dir(&path).unwrap().count() > 80);
    assert!(open_files() <= 70, "{}", open_files());
    drop(store);
    let (store, _) = BlockStore::open(Arc::new(RealDisk::open(&path).unwrap()), options(600)).unwrap();
    assert!(open_files() <= 70, "{}", open_files());
    assert_eq!(store.entry(800).unwrap(), Some(plain(800, 1)));
}

#[test]
fn a_deleted_oldest_segment_is_missed_at_the_next_start_and_dropped_ones_are_not() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("blocks");
    let open = || BlockStore::open(Arc::new(RealDisk::open(&path).unwrap()), options(600));
    let (store, _) = open().unwrap();
    for index in 1..=100 {
        flush_entry(&store, plain(index, 1));
    }
    store.set_committed(100);
    let first = store.prune(40).unwrap();
    assert!(first > 20, "{first}");
    drop(store);
    // What the store has dropped itself is not missed.
    assert_eq!(open().unwrap().0.first_index(), first);
    let oldest = on_disk(&path).into_iter().next().unwrap();
    std::fs::remove_file(path.join(&oldest)).unwrap();
    let Err(StoreError::Corrupt { index, what, .. }) = open().map(drop) else { panic!("{oldest} is not missed") };
    assert_eq!(index, first);
    assert!(what.contains("missing") && what.contains("their files were deleted"), "{what}");
    let again = open().map(drop).unwrap_err().to_string();
    assert!(again.contains("missing"), "it is refused again and again: {again}");
}

#[test]
fn the_first_segment_of_a_store_that_was_never_started_again_is_missed_too() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("blocks");
    let open = || BlockStore::open(Arc::new(RealDisk::open(&path).unwrap()), options(600));
    let (store, _) = open().unwrap();
    for index in 1..=100 {
        flush_entry(&store, plain(index, 1));
    }
    drop(store);
    std::fs::remove_file(path.join(on_disk(&path).into_iter().next().unwrap())).unwrap();
    assert!(matches!(open().map(drop), Err(StoreError::Corrupt { index: 1, .. })));
}

/// The names of the segments, oldest first.
fn on_disk(path: &std::path::Path) -> Vec<String> {
    let names = std::fs::read_dir(path).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap());
    let mut names: Vec<_> = names.filter(|name| name.ends_with(".seg")).collect();
    names.sort();
    names
}
