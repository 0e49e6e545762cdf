//! Disks that fail, fill up or lose what was not synced; flushing beside appending and reading.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};

use ledger_storage::disk::{Fault, SimDisk};
use ledger_storage::entry::HardState;

use super::*;

#[test]
fn after_a_failed_write_or_sync_nothing_is_acknowledged_but_reading_works() {
    let faults: [fn(&SimDisk); 4] = [
        |disk| disk.fail_write(1, Fault::Error),
        |disk| disk.fail_write(1, Fault::Short(13)),
        |disk| disk.fail_sync(1),
        |disk| {
            disk.fail_write(1, Fault::Full(13));
            disk.fail_write(2, Fault::Error);
        },
    ];
    for (number, fault) in faults.iter().enumerate() {
        for seed in 0..20 {
            let disk = SimDisk::new(seed);
            let (store, _) = open(&disk);
            while store.prepare().unwrap() {}
            flush_entry(&store, plain(1, 1));
            fault(&disk);
            store.append(&[plain(2, 1), plain(3, 1)], None).unwrap();
            let first = store.flush().unwrap_err().to_string();
            assert_eq!(store.flush().unwrap_err().to_string(), first, "fault {number}");
            assert_eq!(store.append(&[plain(4, 1)], None).unwrap_err().to_string(), first);
            assert_eq!(store.prepare().unwrap_err().to_string(), first);
            assert_eq!((store.durable_index(), store.entry(1).unwrap()), (1, Some(plain(1, 1))));
            disk.crash();
            let read = all(&open(&disk).0);
            assert!([plain(1, 1), plain(2, 1), plain(3, 1)].starts_with(&read) && !read.is_empty());
        }
    }
}

#[test]
fn what_a_restart_reports_is_on_disk_even_after_a_failed_sync() {
    for seed in 0..50 {
        let disk = SimDisk::new(seed);
        let (store, _) = open(&disk);
        flush_entry(&store, plain(1, 1));
        store.append(&[plain(2, 1)], None).unwrap();
        disk.fail_sync(1);
        store.flush().unwrap_err();
        // The process ends, the page cache still shows entry 2 although it is lost.
        disk.kill();
        let (store, recovery) = open(&disk);
        assert_eq!(recovery.last_index, 2);
        drop(store);
        disk.crash();
        assert_eq!(open(&disk).1.last_index, 2, "seed {seed}");
    }
}

#[test]
fn a_failed_read_is_told_and_changes_nothing() {
    let disk = SimDisk::new(1);
    let (store, _) = open_with(&disk, 300).unwrap();
    for index in 1..=12 {
        flush_entry(&store, plain(index, 1));
    }
    disk.fail_read(2);
    assert!(matches!(store.entries(1..13, usize::MAX), Err(StoreError::Io { operation: "read", .. })));
    assert_eq!(all(&store).len(), 12);
    flush_entry(&store, plain(13, 1));
    drop(store);
    let mut failed = 0;
    loop {
        let before = disk.contents(&segments(&disk)[0]);
        disk.fail_read(failed + 1);
        let Err(error) = open_with(&disk, 300) else { break };
        assert!(matches!(error, StoreError::Io { operation: "read", .. }), "{error}");
        assert_eq!(disk.contents(&segments(&disk)[0]), before);
        disk.crash();
        failed += 1;
    }
    assert!(failed >= 2 * segments(&disk).len() as u64, "{failed} reads");
    disk.crash();
    assert_eq!(all(&open_with(&disk, 300).unwrap().0).len(), 13);
}

#[test]
fn a_full_disk_is_told_and_forgotten_when_there_is_room_again() {
    for prepared in [false, true] {
        for room in 0..200 {
            let disk = SimDisk::new(room);
            let (store, _) = open_with(&disk, 600).unwrap();
            if prepared {
                store.prepare().unwrap();
            }
            flush_entry(&store, plain(1, 1));
            disk.set_capacity(Some(disk.used_bytes() + room));
            let mut index = 1;
            let full = loop {
                index += 1;
                store.append(&[plain(index, 1)], Some(&HardState { term: 1, vote: 0, commit: index })).unwrap();
                if let Err(error) = store.flush() {
                    break error;
                }
            };
            assert!(matches!(full, StoreError::DiskFull { .. }), "{full}");
            assert_eq!((store.durable_index(), store.last_index()), (index - 1, index));
            assert!(matches!(store.flush(), Err(StoreError::DiskFull { .. })));
            store.append(&[plain(index + 1, 1)], None).unwrap();
            if room % 2 == 0 {
                disk.set_capacity(None);
                assert_eq!(store.flush().unwrap(), index + 1, "staged entries were kept");
                index += 2;
            }
            disk.crash();
            disk.set_capacity(None);
            let (store, recovery) = open_with(&disk, 600).unwrap();
            assert_eq!((recovery.last_index, store.hard_state().commit < index), (index - 1, true), "room {room}");
            assert_eq!(all(&store), (1..index).map(|index| plain(index, 1)).collect::<Vec<_>>());
        }
    }
}

#[test]
fn a_full_disk_while_preparing_is_an_early_warning() {
    let disk = SimDisk::new(1);
    let (store, _) = open_with(&disk, 64 << 20).unwrap();
    while store.prepare().unwrap() {}
    flush_entry(&store, entry(1, 1, &[1; 2 << 20]));
    disk.set_capacity(Some(disk.used_bytes() + 100));
    assert!(matches!(store.prepare(), Err(StoreError::DiskFull { .. })));
    flush_entry(&store, plain(2, 1));
    disk.set_capacity(None);
    assert!(store.prepare().unwrap());
    disk.crash();
    assert_eq!(open(&disk).1.last_index, 2);
}

#[test]
fn a_failure_while_a_segment_is_begun_loses_nothing_acknowledged() {
    for seed in 0..60 {
        let disk = SimDisk::new(seed);
        let (store, _) = open_with(&disk, 300).unwrap();
        for index in 1..=4 {
            flush_entry(&store, plain(index, 1));
        }
        match seed % 3 {
            0 => disk.fail_dir_sync(),
            1 => disk.fail_sync(2),
            _ => disk.fail_write(2, Fault::Short(150)),
        }
        store.append(&(5..=14).map(|index| plain(index, 1)).collect::<Vec<_>>(), None).unwrap();
        store.flush().unwrap_err();
        let durable = store.durable_index();
        disk.crash();
        let (store, recovery) = open_with(&disk, 300).unwrap();
        assert!(recovery.last_index >= durable.max(4), "seed {seed}");
        assert_eq!(all(&store), (1..=recovery.last_index).map(|index| plain(index, 1)).collect::<Vec<_>>());
        flush_entry(&store, plain(recovery.last_index + 1, 2));
    }
}

#[test]
fn appending_reading_and_superseding_go_on_during_a_flush() {
    for (superseding, expected_durable) in [(4, 3), (3, 2), (2, 1), (1, 0)] {
        let disk = SimDisk::new(1);
        let store = Arc::new(OnceLock::new());
        assert!(store.set(open(&disk).0).is_ok());
        let during = Arc::clone(&store);
        let once = AtomicBool::new(false);
        flush_entry(store.get().unwrap(), plain(1, 1));
        disk.before_sync(move || {
            if !once.swap(true, Ordering::Relaxed) {
                let store: &BlockStore = during.get().unwrap();
                assert_eq!((store.durable_index(), store.last_index()), (1, 3));
                assert_eq!(store.entry(3).unwrap(), Some(plain(3, 1)));
                store.append(&[plain(superseding, 2)], None).unwrap();
            }
        });
        let store = store.get().unwrap();
        store.append(&[plain(2, 1), plain(3, 1)], None).unwrap();
        assert_eq!(store.flush().unwrap(), expected_durable);
        assert_eq!(store.flush().unwrap(), superseding);
        let expected: Vec<Entry> =
            (1..superseding).map(|index| plain(index, 1)).chain([plain(superseding, 2)]).collect();
        assert_eq!(all(store), expected);
        disk.kill();
        assert_eq!(all(&open(&disk).0), expected);
    }
}

#[test]
fn flushing_appending_preparing_and_reading_threads_agree() {
    const LAST: u64 = 3000;
    let disk = SimDisk::new(1);
    let (store, _) = open_with(&disk, 20_000).unwrap();
    std::thread::scope(|scope| {
        scope.spawn(|| {
            for index in 1..=LAST {
                store.append(&[plain(index, 1)], None).unwrap();
            }
        });
        for _ in 0..2 {
            scope.spawn(|| while store.flush().unwrap() < LAST {});
        }
        scope.spawn(|| {
            while store.durable_index() < LAST {
                store.prepare().unwrap();
            }
        });
        scope.spawn(|| {
            // Ends too when another thread found the store poisoned.
            while store.durable_index() < LAST && store.append(&[], None).is_ok() {
                let last = store.last_index();
                let read = store.entries(last.saturating_sub(50)..last + 1, usize::MAX).unwrap();
                assert!(read.iter().all(|entry| *entry == plain(entry.index, 1)));
            }
        });
    });
    disk.crash();
    let read = all(&open_with(&disk, 20_000).unwrap().0);
    assert_eq!(read, (1..=LAST).map(|index| plain(index, 1)).collect::<Vec<_>>());
}
