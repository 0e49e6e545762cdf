//! The block store: what it keeps, in order, through restarts, damage and failing disks.

#![expect(clippy::unwrap_used, clippy::indexing_slicing, clippy::panic, reason = "tests")]

mod damage;
mod faults;
mod first;
mod model;
mod opening;

use std::sync::Arc;

use bytes::Bytes;
use ledger_storage::block_store::{BlockStore, Options, Recovery, STAGED_BYTES_MAX, StoreError};
use ledger_storage::disk::{RealDisk, SimDisk};
use ledger_storage::entry::{Entry, EntryKind, HardState};
use ledger_storage::segment::{ENTRY_BYTES_MAX, Found, Record, parse_name, scan};

const NETWORK: [u8; 32] = [7; 32];

fn options(segment_bytes: u64) -> Options {
    let mut salt = 0x5a17_u64;
    let mut options = Options::new(NETWORK, move || {
        salt = salt.wrapping_mul(0x5851_f42d_4c95_7f2d).wrapping_add(1);
        salt
    });
    options.segment_bytes = segment_bytes;
    options.cache_bytes = 0;
    options
}

fn open_with(disk: &SimDisk, segment_bytes: u64) -> Result<(BlockStore, Recovery), StoreError> {
    BlockStore::open(Arc::new(disk.clone()), options(segment_bytes))
}

fn open(disk: &SimDisk) -> (BlockStore, Recovery) {
    open_with(disk, 1 << 16).unwrap()
}

fn entry(index: u64, term: u64, data: &[u8]) -> Entry {
    Entry { index, term, kind: EntryKind::Normal, data: Bytes::copy_from_slice(data) }
}

/// An entry whose data tells its index and term.
fn plain(index: u64, term: u64) -> Entry {
    entry(index, term, format!("entry {index} of term {term}").as_bytes())
}

fn flush_entry(store: &BlockStore, entry: Entry) {
    store.append(&[entry], None).unwrap();
    store.flush().unwrap();
}

fn all(store: &BlockStore) -> Vec<Entry> {
    store.entries(1..u64::MAX, usize::MAX).unwrap()
}

fn segments(disk: &SimDisk) -> Vec<String> {
    use ledger_storage::disk::Disk as _;
    disk.list().unwrap().into_iter().filter(|name| parse_name(name).is_some()).collect()
}

#[test]
fn what_was_flushed_is_there_after_a_crash() {
    let disk = SimDisk::new(1);
    let (store, recovery) = open(&disk);
    assert_eq!((recovery.segments, recovery.first_index, recovery.last_index), (0, 1, 0));
    assert_eq!((store.first_index(), store.last_index()), (1, 0));
    let entries = [
        plain(1, 1),
        Entry { index: 2, term: 1, kind: EntryKind::ConfChange, data: Bytes::new() },
        Entry { index: 3, term: 2, kind: EntryKind::ConfChangeV2, data: Bytes::from(vec![0; 5000]) },
    ];
    let hard_state = HardState { term: 2, vote: 9, commit: 2 };
    store.append(&entries, Some(&hard_state)).unwrap();
    assert_eq!((store.last_index(), store.durable_index(), store.hard_state()), (3, 0, hard_state));
    assert_eq!(all(&store), entries);
    assert_eq!(store.flush().unwrap(), 3);
    store.append(&[plain(4, 2)], None).unwrap();
    disk.crash();
    let (store, recovery) = open(&disk);
    assert_eq!((recovery.segments, recovery.last_index, recovery.torn), (1, 3, None));
    assert_eq!((store.hard_state(), store.committed(), store.durable_index()), (hard_state, 2, 3));
    assert_eq!(all(&store), entries);
    assert_eq!([0, 1, 2, 3, 4].map(|index| store.term(index)), [Some(0), Some(1), Some(1), Some(2), None]);
    assert_eq!(store.entry(3).unwrap().as_ref(), entries.get(2));
    assert_eq!((store.entry(0).unwrap(), store.entry(4).unwrap()), (None, None));
}

#[test]
fn a_flush_is_one_write_and_one_sync() {
    let disk = SimDisk::new(1);
    let (store, _) = open(&disk);
    flush_entry(&store, plain(1, 1));
    let before = disk.counts();
    store.append(&[plain(2, 1), plain(3, 1)], None).unwrap();
    store.append(&[plain(4, 1)], Some(&HardState { term: 1, vote: 1, commit: 2 })).unwrap();
    assert_eq!(store.flush().unwrap(), 4);
    assert_eq!(disk.counts(), (before.0 + 1, before.1 + 1));
    assert_eq!(store.flush().unwrap(), 4);
    assert_eq!(disk.counts(), (before.0 + 1, before.1 + 1));
}

#[test]
fn the_newest_entries_are_read_from_memory() {
    let disk = SimDisk::new(1);
    let with_cache = Options { cache_bytes: 1 << 16, ..options(1 << 16) };
    let (store, _) = BlockStore::open(Arc::new(disk.clone()), with_cache).unwrap();
    let entries: Vec<_> = (1..=3).map(|index| plain(index, 1)).collect();
    store.append(&entries, None).unwrap();
    store.flush().unwrap();
    disk.fail_read(1);
    assert_eq!(store.entries(1..4, usize::MAX).unwrap(), entries);
    assert_eq!(store.entries(2..4, usize::MAX).unwrap(), entries[1..]);
}

#[test]
fn a_lower_index_supersedes_what_follows_it_on_disk_and_in_memory() {
    for flushed in [false, true] {
        let disk = SimDisk::new(1);
        let (store, _) = open_with(&disk, 300).unwrap();
        store.append(&[plain(1, 1), plain(2, 1), plain(3, 1), plain(4, 1)], None).unwrap();
        if flushed {
            store.flush().unwrap();
        }
        store.append(&[plain(3, 2)], None).unwrap();
        assert_eq!((store.last_index(), store.durable_index()), (3, if flushed { 2 } else { 0 }));
        assert_eq!(store.flush().unwrap(), 3);
        for store in [store, open_with(&disk, 300).unwrap().0] {
            assert_eq!(all(&store), [plain(1, 1), plain(2, 1), plain(3, 2)]);
            assert_eq!((store.term(3), store.term(4)), (Some(2), None));
        }
    }
}

#[test]
fn what_is_committed_is_never_superseded() {
    let disk = SimDisk::new(1);
    let (store, _) = open(&disk);
    store.append(&[plain(1, 1), plain(2, 1)], None).unwrap();
    store.set_committed(2);
    let refused = store.append(&[plain(2, 2)], None).unwrap_err();
    assert!(matches!(refused, StoreError::Violation(_)), "{refused}");
    assert!(store.append(&[plain(3, 2)], None).is_err(), "the store is poisoned");
    assert!(store.flush().is_err());
    assert_eq!(all(&store).len(), 2);
}

#[test]
fn broken_rules_of_the_log_poison_the_store() {
    type Rule = fn(&BlockStore) -> Result<(), StoreError>;
    let break_rule: [Rule; 6] = [
        |store| store.append(&[plain(2, 1)], None),
        |store| store.append(&[plain(2, 3), plain(3, 2)], None),
        |store| store.append(&[], Some(&HardState { term: 2, vote: 0, commit: 2 })),
        |store| {
            store.set_committed(2);
            store.append(&[], None)
        },
        |store| {
            store.append(&[], Some(&HardState { term: 2, vote: 1, commit: 0 })).unwrap();
            store.append(&[], Some(&HardState { term: 2, vote: 3, commit: 0 }))
        },
        |store| {
            store.append(&[], Some(&HardState { term: 2, vote: 0, commit: 1 })).unwrap();
            store.append(&[], Some(&HardState { term: 2, vote: 0, commit: 0 }))
        },
    ];
    for rule in break_rule {
        let (store, _) = open(&SimDisk::new(1));
        flush_entry(&store, plain(1, 2));
        assert!(matches!(rule(&store), Err(StoreError::Violation(_))));
        assert!(matches!(store.flush(), Err(StoreError::Violation(_))));
    }
}

#[test]
fn entries_that_do_not_fit_are_refused_and_nothing_is_staged() {
    let (store, _) = open(&SimDisk::new(1));
    assert!(matches!(store.append(&[plain(2, 1)], None), Err(StoreError::Gap { found: 2, wanted: 1 })));
    assert!(matches!(store.append(&[plain(0, 1)], None), Err(StoreError::Gap { found: 0, wanted: 1 })));
    assert!(matches!(store.append(&[plain(1, 1), plain(3, 1)], None), Err(StoreError::Gap { found: 3, wanted: 2 })));
    let large = entry(1, 1, &vec![1; ENTRY_BYTES_MAX + 1]);
    assert!(matches!(store.append(&[large], None), Err(StoreError::TooLarge { index: 1, .. })));
    let data = Bytes::from(vec![1; ENTRY_BYTES_MAX]);
    let count = (STAGED_BYTES_MAX / ENTRY_BYTES_MAX) as u64;
    let many: Vec<Entry> =
        (1..=count).map(|index| Entry { index, term: 1, kind: EntryKind::Normal, data: data.clone() }).collect();
    assert!(matches!(store.append(&many, None), Err(StoreError::StageFull { .. })));
    assert_eq!(store.last_index(), 0);
    flush_entry(&store, many.into_iter().next().unwrap());
    assert_eq!(store.durable_index(), 1);
}

#[test]
fn the_log_rolls_over_segments_and_each_continues_the_one_before() {
    for prepared in [false, true] {
        let disk = SimDisk::new(1);
        let (store, _) = open_with(&disk, 400).unwrap();
        let expected: Vec<Entry> = (1..=40).map(|index| plain(index, index / 7 + 1)).collect();
        for pair in expected.chunks(5) {
            while prepared && store.prepare().unwrap() {}
            store.append(pair, Some(&HardState { term: 9, vote: 0, commit: pair[0].index })).unwrap();
            store.flush().unwrap();
        }
        // Larger than a segment: gets one of its own.
        let large = entry(41, 9, &[3; 1000]);
        flush_entry(&store, large.clone());
        flush_entry(&store, plain(42, 9));
        assert!(segments(&disk).len() > 6);
        disk.crash();
        let (store, recovery) = open_with(&disk, 400).unwrap();
        assert_eq!((recovery.segments, recovery.last_index), (segments(&disk).len(), 42));
        let read = all(&store);
        assert_eq!(read[..40], expected);
        assert_eq!(read[40..], [large, plain(42, 9)]);
        flush_entry(&store, plain(43, 9));
    }
}

#[test]
fn entries_stop_at_the_limit_but_give_one_at_least() {
    for cache_bytes in [0, 1 << 20] {
        let mut options = options(1 << 16);
        options.cache_bytes = cache_bytes;
        let (store, _) = BlockStore::open(Arc::new(SimDisk::new(1)), options).unwrap();
        for index in 1..=10 {
            flush_entry(&store, entry(index, 1, &[1; 1000]));
        }
        assert_eq!(store.entries(1..11, 0).unwrap().len(), 1);
        assert_eq!(store.entries(1..11, 3500).unwrap().len(), 3);
        let some: Vec<u64> = store.entries(4..7, usize::MAX).unwrap().iter().map(|entry| entry.index).collect();
        assert_eq!(some, [4, 5, 6]);
        assert_eq!(store.entries(9..99, usize::MAX).unwrap().len(), 2);
        assert_eq!(store.entries(11..99, usize::MAX).unwrap(), []);
        assert_eq!(store.entries(0..2, usize::MAX).unwrap().len(), 1);
    }
}

#[test]
fn a_flush_into_prepared_space_does_not_grow_the_file() {
    let disk = SimDisk::new(1);
    let (store, _) = open_with(&disk, 64 << 20).unwrap();
    while store.prepare().unwrap() {}
    let prepared = disk.used_bytes();
    assert!(prepared >= 4 << 20);
    for index in 1..=100 {
        flush_entry(&store, entry(index, 1, &[1; 1000]));
    }
    assert_eq!((disk.used_bytes(), segments(&disk).len()), (prepared, 1));
    drop(store);
    assert_eq!(open(&disk).1.last_index, 100);
}

#[test]
fn a_store_of_another_network_is_refused() {
    let disk = SimDisk::new(1);
    flush_entry(&open(&disk).0, plain(1, 1));
    let mut options = options(1 << 16);
    options.network = [8; 32];
    let refused = BlockStore::open(Arc::new(disk), options).err().unwrap();
    assert!(matches!(refused, StoreError::WrongNetwork { found: NETWORK, .. }), "{refused}");
}

#[test]
fn foreign_files_are_left_alone_and_named() {
    let disk = SimDisk::new(1);
    flush_entry(&open(&disk).0, plain(1, 1));
    let foreign = ["0000000002.new.bak", "1-1.seg", "notes.txt", "x.new"];
    for name in foreign {
        disk.set_contents(name, b"garbage");
    }
    disk.set_contents("0000000002.new", b"left over");
    let (store, recovery) = open(&disk);
    assert_eq!(recovery.ignored, foreign);
    assert_eq!((all(&store), disk.contents("0000000002.new")), (vec![plain(1, 1)], None));
    assert!(foreign.iter().all(|name| disk.contents(name).is_some()));
}

#[test]
fn bytes_a_client_chose_are_never_taken_for_a_record() {
    let disk = SimDisk::new(1);
    let (store, _) = open(&disk);
    flush_entry(&store, plain(1, 1));
    flush_entry(&store, plain(2, 1));
    // Records of this very store, sent back as data, at another place: then the tail is torn in front of them.
    let copied = disk.contents(&segments(&disk)[0]).unwrap();
    store.append(&[plain(3, 1), entry(4, 1, &copied)], None).unwrap();
    store.flush().unwrap();
    drop(store);
    let name = &segments(&disk)[0];
    let mut bytes = disk.contents(name).unwrap();
    bytes[copied.len() + 30] ^= 1;
    disk.set_contents(name, &bytes);
    let (store, recovery) = open(&disk);
    assert_eq!((recovery.last_index, recovery.torn.unwrap().offset), (2, copied.len() as u64));
    assert_eq!(all(&store).len(), 2);
}

#[test]
fn a_real_directory_keeps_the_log_and_can_be_scanned_offline() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("blocks");
    let (store, _) = BlockStore::open(Arc::new(RealDisk::open(&path).unwrap()), options(1 << 12)).unwrap();
    for index in 1..=50 {
        store.prepare().unwrap();
        flush_entry(&store, entry(index, 1, &[index as u8; 300]));
    }
    assert!(RealDisk::open(&path).is_err(), "locked");
    drop(store);
    let disk = RealDisk::open_read_only(&path).unwrap();
    let mut records: Vec<Found> = scan(&disk, None).unwrap().collect::<Result<_, _>>().unwrap();
    records.retain(|found| matches!(found, Found::Record { record: Record::Entry(_), .. }));
    drop(disk);
    assert_eq!(records.len(), 50);
    assert!(matches!(&records[49], Found::Record { record: Record::Entry(entry), .. } if entry.index == 50));
    let (store, _) = BlockStore::open(Arc::new(RealDisk::open(&path).unwrap()), options(1 << 12)).unwrap();
    assert_eq!(all(&store).len(), 50);
}
