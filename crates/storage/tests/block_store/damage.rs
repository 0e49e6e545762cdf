//! Cut files and flipped bits: the exact prefix, or a refusal that names the place; never wrong data, never a panic.

use ledger_storage::disk::{Disk as _, SimDisk};
use ledger_storage::entry::{Entry, HardState};
use ledger_storage::segment::{Found, LogPosition, scan};

use super::*;

/// Two segments; the last flush wrote entries 9 and 10 and a hard state, in the middle of the second.
fn small_store() -> (SimDisk, Vec<Entry>) {
    let disk = SimDisk::new(1);
    let (store, _) = open_with(&disk, 500).unwrap();
    for index in 1..=8 {
        flush_entry(&store, plain(index, 1));
    }
    store.append(&[plain(9, 1), plain(10, 2)], Some(&HardState { term: 2, vote: 1, commit: 8 })).unwrap();
    store.flush().unwrap();
    assert_eq!(segments(&disk).len(), 2);
    let entries = all(&store);
    (disk, entries)
}

/// Every record: file, start, end, and up to where the log was durable when it was written.
fn records(disk: &SimDisk) -> Vec<(String, u64, u64, LogPosition)> {
    scan(disk, None)
        .unwrap()
        .map(|found| match found.unwrap() {
            Found::Record { file, position, bytes, durable_upto, .. } => {
                let start = u64::from(position.offset);
                (file.to_string(), start, start + u64::from(bytes), durable_upto)
            }
            torn @ Found::Torn { .. } => panic!("{torn:?}"),
        })
        .collect()
}

/// Damage in a finished segment is not always refused when the store is opened. Then a reader finds it, who never gets
/// anything wrong, and the check finds it.
fn found_in_use(disk: &SimDisk, expected: &[Entry], context: &str) -> StoreError {
    let (store, _) = match open_with(disk, 500) {
        Err(error) => return error,
        Ok(opened) => opened,
    };
    for entry in expected {
        match store.entry(entry.index) {
            Ok(read) => assert_eq!(read.as_ref(), Some(entry), "{context}"),
            Err(error) => assert!(matches!(error, StoreError::Corrupt { .. }), "{context}: {error}"),
        }
    }
    store.check_finished(|_| true).err().unwrap_or_else(|| panic!("{context}: not found"))
}

/// The opened store holds a prefix of `expected` that has at least `durable` entries, and goes on working.
fn check_prefix(disk: &SimDisk, expected: &[Entry], durable: usize, context: &str) -> Recovery {
    let (store, recovery) = open_with(disk, 500).unwrap_or_else(|error| panic!("{context}: {error}"));
    let read = all(&store);
    assert!(read.len() >= durable && expected.starts_with(&read), "{context}: {read:?}");
    assert!(store.hard_state().commit <= store.last_index(), "{context}");
    flush_entry(&store, plain(store.last_index() + 1, 9));
    drop(store);
    disk.crash();
    let (again, second) = open_with(disk, 500).unwrap();
    assert_eq!((all(&again).len(), second.torn), (read.len() + 1, None), "{context}");
    recovery
}

#[test]
fn a_cut_at_any_byte_leaves_the_exact_prefix_or_is_refused() {
    let (disk, expected) = small_store();
    let records = records(&disk);
    let name = segments(&disk)[1].clone();
    let bytes = disk.contents(&name).unwrap();
    let newest = records.last().unwrap();
    let durable = u64::from(newest.3.offset);
    for cut in 0..bytes.len() {
        for zeros in [false, true] {
            let damaged = disk.copy(7);
            let mut cut_bytes = bytes[..cut].to_vec();
            if zeros {
                cut_bytes.resize(bytes.len() + 700, 0);
            }
            damaged.set_contents(&name, &cut_bytes);
            let context = format!("cut at {cut} of {} (last flush from {durable})", bytes.len());
            if cut < 96 {
                let error = open_with(&damaged, 500).err().unwrap_or_else(|| panic!("{context}"));
                assert!(matches!(error, StoreError::Corrupt { ref file, .. } if *file == name), "{context}: {error}");
                continue;
            }
            let whole = |(file, _, end, _): &&(String, u64, u64, LogPosition)| *file != name || *end <= cut as u64;
            // The second segment begins with a seal.
            let seal = usize::from(records.iter().filter(whole).any(|record| record.0 == name));
            let kept = (records.iter().filter(whole).count() - seal).min(expected.len());
            let recovery = check_prefix(&damaged, &expected, kept, &context);
            assert_eq!(recovery.last_index, kept as u64, "{context}");
        }
    }
}

#[test]
fn a_cut_in_a_finished_segment_is_refused_at_every_byte() {
    let (disk, _) = small_store();
    let name = segments(&disk)[0].clone();
    let bytes = disk.contents(&name).unwrap();
    let end = records(&disk).iter().filter(|record| record.0 == name).map(|record| record.2).max().unwrap();
    for cut in 0..end as usize {
        let damaged = disk.copy(7);
        damaged.set_contents(&name, &bytes[..cut]);
        let error = open_with(&damaged, 500).err().unwrap();
        assert!(
            matches!(error, StoreError::Corrupt { ref file, offset, .. } if *file == name && offset <= cut as u64),
            "{error}"
        );
    }
}

#[test]
fn a_flipped_bit_is_refused_with_its_place_or_was_in_the_last_flush() {
    let (disk, expected) = small_store();
    let records = records(&disk);
    let durable = records.last().unwrap().3;
    let acknowledged = records
        .iter()
        .filter(|record| LogPosition { offset: record.1 as u32, ..durable } < durable || record.0 == segments(&disk)[0])
        .count()
        - 1;
    for name in segments(&disk) {
        let bytes = disk.contents(&name).unwrap();
        for at in 0..bytes.len() {
            for mask in [1, 2, 4, 8, 16, 32, 64, 128, 255] {
                let damaged = disk.copy(7);
                let mut flipped = bytes.clone();
                flipped[at] ^= mask;
                damaged.set_contents(&name, &flipped);
                let context = format!("{name} byte {at} mask {mask}");
                let record =
                    records.iter().find(|record| record.0 == name && (record.1..record.2).contains(&(at as u64)));
                let last_flush = name == segments(&disk)[1] && at >= durable.offset as usize;
                if last_flush {
                    let recovery = check_prefix(&damaged, &expected, acknowledged, &context);
                    assert_eq!(recovery.torn.map(|torn| torn.offset), record.map(|record| record.1), "{context}");
                    continue;
                }
                let error = found_in_use(&damaged, &expected, &context);
                let StoreError::Corrupt { file, offset, .. } = &error else { panic!("{context}: {error}") };
                assert_eq!(*file, name, "{context}");
                assert!(*offset <= at as u64, "{context}: {error}");
                if let Some(record) = record {
                    assert_eq!(*offset, record.1, "{context}");
                }
                assert_eq!(damaged.contents(&name).unwrap(), flipped, "{context}: refused, yet changed");
            }
        }
    }
}

#[test]
fn a_lost_sector_that_had_been_durable_is_refused() {
    let disk = SimDisk::new(1);
    let (store, _) = open(&disk);
    for index in 1..=20 {
        flush_entry(&store, entry(index, 1, &[9; 300]));
    }
    drop(store);
    let name = segments(&disk)[0].clone();
    let mut bytes = disk.contents(&name).unwrap();
    bytes[1024..1536].fill(0);
    disk.set_contents(&name, &bytes);
    let error = open_with(&disk, 1 << 16).err().unwrap();
    assert!(matches!(error, StoreError::Corrupt { offset: 780..=1024, .. }), "{error}");
    let last = scan(&disk, None).unwrap().last().unwrap();
    assert!(matches!(last, Err(StoreError::Corrupt { .. })), "the offline scan says so too");
}

#[test]
fn a_gap_between_segments_and_a_renamed_or_doubled_one_are_refused() {
    let disk = SimDisk::new(1);
    let (store, _) = open_with(&disk, 300).unwrap();
    for index in 1..=12 {
        flush_entry(&store, plain(index, 1));
    }
    let names = segments(&disk);
    let (last, second) = (names.last().unwrap(), &names[1]);
    for change in 0..4 {
        let damaged = disk.copy(3);
        let contents = damaged.contents(last).unwrap();
        match change {
            0 => damaged.remove(second).unwrap(),
            1 => damaged.rename(last, "0000000099-00000000000000000007.seg").unwrap(),
            2 => damaged.set_contents("0000000002-00000000000000000099.seg", &contents),
            _ => damaged.set_contents("0000000099-00000000000000000013.seg", &contents),
        }
        assert!(matches!(open_with(&damaged, 300), Err(StoreError::Corrupt { .. })), "change {change}");
    }
}

#[test]
fn rot_that_appears_while_the_store_is_open_is_named_when_read() {
    let disk = SimDisk::new(1);
    let (store, _) = open(&disk);
    flush_entry(&store, plain(1, 1));
    flush_entry(&store, plain(2, 1));
    let file = disk.open(&segments(&disk)[0]).unwrap();
    file.write_at(&[0xff], 96 + 30).unwrap();
    let error = store.entry(1).unwrap_err();
    assert!(matches!(error, StoreError::Corrupt { offset: 96, index: 1, .. }), "{error}");
    assert_eq!(store.entry(2).unwrap(), Some(plain(2, 1)));
}

#[test]
fn what_another_attempt_left_behind_never_continues_the_log() {
    // Two histories with the same salts and sizes: the second record of one is valid by itself in the other.
    let [ours, other] = [b"ours_", b"other"].map(|data| {
        let disk = SimDisk::new(1);
        let (store, _) = open(&disk);
        flush_entry(&store, entry(1, 1, data));
        let end = disk.contents(&segments(&disk)[0]).unwrap().len();
        flush_entry(&store, plain(2, 1));
        (disk, end)
    });
    let name = segments(&ours.0)[0].clone();
    let mut bytes = ours.0.contents(&name).unwrap();
    bytes[ours.1..].copy_from_slice(&other.0.contents(&name).unwrap()[other.1..]);
    ours.0.set_contents(&name, &bytes);
    let (store, recovery) = open(&ours.0);
    assert_eq!((recovery.last_index, recovery.torn.unwrap().offset), (1, ours.1 as u64));
    assert_eq!(all(&store), [entry(1, 1, b"ours_")]);
}
