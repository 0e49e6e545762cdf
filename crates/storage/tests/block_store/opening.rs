//! Opening takes the word of each segment about the one before it, and reads only the newest.

use ledger_storage::segment::{HEADER_BYTES, LogPosition, RecordHeader, SegmentHeader};

use super::*;

const SEGMENT_BYTES: u64 = 900;

/// Everything that a log tells.
type Told = (Vec<Entry>, Vec<Option<u64>>, HardState, u64);

/// Segments with changes of term in them, and entries that supersede some of an older segment.
fn history(disk: &SimDisk) -> Told {
    let (store, _) = open_with(disk, SEGMENT_BYTES).unwrap();
    for index in 1..=60 {
        let term = index / 7 + 1;
        store.append(&[plain(index, term)], Some(&HardState { term, vote: 2, commit: index / 2 })).unwrap();
        store.flush().unwrap();
    }
    for index in 51..=80 {
        flush_entry(&store, plain(index, 20 + index / 9));
    }
    told(&store)
}

fn told(store: &BlockStore) -> Told {
    let terms = (0..=store.last_index() + 1).map(|index| store.term(index)).collect();
    (all(store), terms, store.hard_state(), store.durable_index())
}

#[test]
fn a_store_that_was_opened_by_its_seals_tells_what_it_told_before() {
    let disk = SimDisk::new(1);
    let before = history(&disk);
    let seals = scan(&disk, None)
        .unwrap()
        .map(Result::unwrap)
        .filter(|found| matches!(found, Found::Record { record: Record::Seal(_), .. }));
    let segments = segments(&disk).len();
    assert!(segments > 6);
    assert_eq!(seals.count(), segments - 1);
    disk.crash();
    for _ in 0..2 {
        let (store, recovery) = open_with(&disk, SEGMENT_BYTES).unwrap();
        assert_eq!((recovery.last_index, recovery.torn), (80, None));
        assert_eq!(told(&store), before);
        assert!(store.check_finished(|_| true).is_ok());
    }
}

#[test]
fn the_records_of_finished_segments_are_not_read_when_the_store_is_opened() {
    let disk = SimDisk::new(1);
    let expected = history(&disk);
    let names = segments(&disk);
    // Whoever read them would find these zeros.
    let damaged = disk.copy(7);
    let mut bytes = damaged.contents(&names[0]).unwrap();
    bytes[HEADER_BYTES as usize..].fill(0);
    damaged.set_contents(&names[0], &bytes);
    let (store, recovery) = open_with(&damaged, SEGMENT_BYTES).unwrap();
    assert_eq!((recovery.last_index, recovery.torn), (80, None));
    // They are not believed when they are wanted; all else is there.
    assert!(matches!(store.entry(1), Err(StoreError::Corrupt { file, .. }) if file == names[0]));
    assert!(matches!(store.check_finished(|_| true), Err(StoreError::Corrupt { file, .. }) if file == names[0]));
    assert_eq!(store.entry(80).unwrap().as_ref(), expected.0.last());
}

#[test]
fn another_file_in_the_place_of_a_finished_segment_is_noticed() {
    let (disk, other) = (SimDisk::new(1), SimDisk::new(1));
    history(&disk);
    // The same entries under the same names, but other salts.
    let mut options = options(SEGMENT_BYTES);
    options.salt = Box::new(|| 99);
    let (store, _) = BlockStore::open(Arc::new(other.clone()), options).unwrap();
    for index in 1..=60 {
        let term = index / 7 + 1;
        store.append(&[plain(index, term)], Some(&HardState { term, vote: 2, commit: index / 2 })).unwrap();
        store.flush().unwrap();
    }
    let name = segments(&disk)[2].clone();
    disk.set_contents(&name, &other.contents(&name).unwrap());
    assert!(matches!(open_with(&disk, SEGMENT_BYTES), Err(StoreError::Corrupt { .. })));
}

#[test]
fn a_seal_that_lies_with_good_checksums_is_not_followed_and_found_by_the_check() {
    let disk = SimDisk::new(1);
    let before = history(&disk);
    let name = segments(&disk)[3].clone();
    // All records are written again, as each names the one before; the seal with another term of its last run.
    let mut bytes = disk.contents(&name).unwrap();
    let (header, mut previous) = SegmentHeader::decode(&bytes).unwrap();
    let mut offset = HEADER_BYTES as usize;
    while let Some(rest) = bytes.get(offset..) {
        let position = LogPosition { sequence: header.sequence, offset: offset as u32 };
        let Ok(found) = RecordHeader::decode(rest, header.salt, position) else { break };
        let mut record = rest[..found.record_bytes()].to_vec();
        if record[24] == 3 {
            let runs = record[25 + 12] as usize;
            record[25 + 20 + runs * 16 - 8] += 1;
        }
        let payload_crc = crc32c::crc32c(&record[25..]);
        record[8..12].copy_from_slice(&payload_crc.to_le_bytes());
        record[12..16].copy_from_slice(&previous.to_le_bytes());
        let seed = [header.salt.to_le_bytes(), (offset as u64).to_le_bytes()].concat();
        previous = crc32c::crc32c_append(crc32c::crc32c(&seed), &record[4..25]);
        record[..4].copy_from_slice(&previous.to_le_bytes());
        bytes[offset..offset + record.len()].copy_from_slice(&record);
        offset += record.len();
    }
    disk.set_contents(&name, &bytes);
    let wrong = scan(&disk, None).unwrap().find_map(Result::err).unwrap();
    assert!(wrong.to_string().contains("the seal does not match"), "{wrong}");
    // It contradicts the header beside it.
    let (store, _) = open_with(&disk, SEGMENT_BYTES).unwrap();
    assert_eq!(told(&store), before);
    let found = store.check_finished(|_| true).unwrap_err();
    assert!(matches!(&found, StoreError::Corrupt { file, .. } if *file == name), "{found}");
}

#[test]
fn the_check_ends_when_it_is_told_to_and_goes_on_beside_dropping() {
    let disk = SimDisk::new(1);
    history(&disk);
    let (store, _) = open_with(&disk, SEGMENT_BYTES).unwrap();
    let mut records = 0;
    store
        .check_finished(|_| {
            records += 1;
            records < 5
        })
        .unwrap();
    assert_eq!(records, 5);
    store.set_committed(60);
    let mut dropped = false;
    store
        .check_finished(|_| {
            if !std::mem::replace(&mut dropped, true) {
                assert!(store.prune(30).unwrap() > 10);
            }
            true
        })
        .unwrap();
    let empty = open(&SimDisk::new(1)).0;
    assert!(empty.check_finished(|_| panic!("there is nothing to read")).is_ok());
}

#[test]
fn a_store_of_another_format_is_refused() {
    let disk = SimDisk::new(1);
    let (store, _) = open_with(&disk, SEGMENT_BYTES).unwrap();
    flush_entry(&store, plain(1, 1));
    drop(store);
    let name = segments(&disk)[0].clone();
    for version in [0, 2] {
        let mut other = disk.contents(&name).unwrap();
        other[8] = version;
        let crc = crc32c::crc32c(&other[..92]);
        other[92..96].copy_from_slice(&crc.to_le_bytes());
        disk.set_contents(&name, &other);
        assert!(open_with(&disk, SEGMENT_BYTES).err().unwrap().to_string().contains("use a newer program"));
    }
}
