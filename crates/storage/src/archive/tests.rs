//! An archive is whole and of one piece, whatever happens meanwhile.

mod committed;

use super::*;
use crate::block_store::{Base, BlockStore, Options};
use crate::disk::{Disk, Fault, SimDisk};
use crate::entry::{Entry, EntryKind, HardState};
use crate::segment::parse_name;
use std::sync::Arc;

const NETWORK: [u8; 32] = [7; 32];

fn open(disk: Arc<dyn Disk>, network: [u8; 32], salt: u64) -> BlockStore {
    let mut salt = salt;
    let mut options = Options::new(network, move || {
        salt = salt.wrapping_mul(0x5851_f42d_4c95_7f2d).wrapping_add(1);
        salt
    });
    options.segment_bytes = 1000;
    BlockStore::open(disk, options).unwrap().0
}

fn fill(store: &BlockStore, last: u64) {
    for index in store.last_index() + 1..=last {
        let data = bytes::Bytes::from(vec![index as u8; 50]);
        let entry = Entry { index, term: 1, kind: EntryKind::Normal, data };
        store.append(&[entry], Some(&HardState { term: 1, vote: 0, commit: index })).unwrap();
        store.flush().unwrap();
        store.prepare().unwrap();
    }
}

fn store(disk: &SimDisk) -> BlockStore {
    open(Arc::new(disk.clone()), NETWORK, 1)
}

fn copy(source: &SimDisk, target: &SimDisk) -> Result<Copied, Rejection> {
    copy_upto(source, target, Upto::Finished)
}

fn copy_upto(source: &SimDisk, target: &SimDisk, upto: Upto) -> Result<Copied, Rejection> {
    copy_segments((source, target), &NETWORK, upto, Watching { begin: &mut |_| Ok(()), tell: &mut |_| () })
}

fn segments(disk: &SimDisk) -> Vec<String> {
    disk.list().unwrap().into_iter().filter(|name| parse_name(name).is_some()).collect()
}

/// The content of a directory that opens as a store and holds the same as the node.
fn check(archive: &SimDisk, node: &BlockStore, copied: &Copied) {
    let archived = store(&archive.copy(1));
    assert_eq!((archived.first_index(), archived.last_index() + 1), (copied.first_height, copied.next_height));
    let range = copied.first_height.max(node.first_index())..copied.next_height;
    let wanted = node.entries(range.clone(), usize::MAX).unwrap();
    assert_eq!(archived.entries(range, usize::MAX).unwrap(), wanted);
}

#[test]
fn finished_segments_are_copied_and_a_second_run_continues() {
    let (node, archive) = (SimDisk::new(1), SimDisk::new(2));
    let blocks = store(&node);
    assert_eq!(copy(&node, &archive).unwrap(), Copied { first_height: 1, next_height: 1, ..Copied::default() });
    for last in [10, 40, 41, 80] {
        fill(&blocks, last);
        let finished = segments(&node).len() as u64 - 1;
        let copied = copy(&node, &archive).unwrap();
        assert_eq!(copied.segments, finished);
        assert!(copied.next_height <= last + 1 && copied.next_height + 10 > last);
        check(&archive, &blocks, &copied);
        assert_eq!(copy(&node, &archive).unwrap(), Copied { segments: 0, bytes: 0, ..copied });
        // Whatever was archived may go.
        assert_eq!(blocks.prune(copied.next_height).unwrap(), copied.next_height);
        assert_eq!(segments(&node).len(), 1);
    }
    assert_eq!(store(&archive.copy(1)).first_index(), 1);
}

#[test]
fn a_crash_or_a_full_disk_leaves_whole_segments_and_the_next_run_goes_on() {
    let node = SimDisk::new(1);
    let blocks = store(&node);
    fill(&blocks, 80);
    let faults: [fn(&SimDisk, u64); 4] = [
        |disk, nth| disk.fail_write(nth, Fault::Short(300)),
        |disk, nth| disk.fail_write(nth, Fault::Full(300)),
        |disk, nth| disk.fail_sync(nth),
        |disk, _| disk.fail_dir_sync(),
    ];
    for fault in faults {
        for seed in 0..20 {
            let archive = SimDisk::new(seed);
            fault(&archive, 1 + seed % 5);
            copy(&node, &archive).unwrap_err();
            if seed % 2 == 0 {
                archive.crash();
            } else {
                archive.kill();
            }
            let archive = archive.copy(seed);
            let names = segments(&archive);
            assert_eq!(names, segments(&node)[..names.len()], "seed {seed}");
            let copied = copy(&node, &archive).unwrap();
            check(&archive, &blocks, &copied);
            assert_eq!(archive.list().unwrap(), segments(&archive), "nothing is left over");
        }
    }
    let archive = SimDisk::new(1);
    archive.set_capacity(Some(2500));
    let full = copy(&node, &archive).unwrap_err();
    assert_eq!(full.code, Code::DiskFull);
    assert_eq!(archive.list().unwrap(), segments(&archive));
}

#[test]
fn a_damaged_segment_is_not_archived() {
    let node = SimDisk::new(1);
    fill(&store(&node), 40);
    let names = segments(&node);
    let damaged = names.get(1).unwrap();
    for bit in (97 * 8..800 * 8).step_by(331) {
        let (node, archive) = (node.copy(3), SimDisk::new(2));
        node.flip(damaged, bit);
        let refused = copy(&node, &archive).unwrap_err();
        assert_eq!(refused.code, Code::Corrupt);
        assert!(refused.message.contains(damaged), "{refused}");
        assert_eq!(archive.list().unwrap(), names[..1]);
    }
}

#[test]
fn what_does_not_belong_together_is_not_put_together() {
    let (node, archive) = (SimDisk::new(1), SimDisk::new(2));
    let blocks = store(&node);
    fill(&blocks, 40);
    copy(&node, &archive).unwrap();
    let other = SimDisk::new(3);
    fill(&open(Arc::new(other.clone()), NETWORK, 99), 60);
    let refused = copy(&other, &archive).unwrap_err();
    assert!(refused.code == Code::BadFile && refused.message.contains("another node"), "{refused}");
    fill(&blocks, 90);
    blocks.prune(70).unwrap();
    let refused = copy(&node, &archive).unwrap_err();
    assert!(refused.code == Code::BadFile && refused.message.contains("oldest block are missing"), "{refused}");
    let fresh = SimDisk::new(4);
    check(&fresh, &blocks, &copy(&node, &fresh).unwrap());
    blocks.begin_after(Base { index: 200, term: 1 }).unwrap();
    fill(&blocks, 240);
    assert!(copy(&node, &fresh).unwrap_err().message.contains("oldest block are missing"));
    let foreign = SimDisk::new(5);
    fill(&open(Arc::new(foreign.clone()), [8; 32], 1), 60);
    assert_eq!(copy(&foreign, &archive).unwrap_err().code, Code::Corrupt);
}

#[test]
fn archiving_goes_on_while_the_node_writes_and_drops() {
    let (node, archive) = (SimDisk::new(1), SimDisk::new(2));
    let blocks = store(&node);
    fill(&blocks, 100);
    std::thread::scope(|scope| {
        scope.spawn(|| fill(&blocks, 400));
        while blocks.last_index() < 400 {
            let copied = copy(&node, &archive).unwrap();
            blocks.prune(copied.next_height).unwrap();
        }
    });
    let copied = copy(&node, &archive).unwrap();
    check(&archive, &blocks, &copied);
    assert_eq!(store(&archive.copy(1)).first_index(), 1);
}

/// A genesis as this crate knows one: bytes that name a network.
fn network_of(genesis: &[u8]) -> Result<Hash, Rejection> {
    Ok(Hash::of(&[genesis]))
}

fn archive(data: &Path, to: &Path, extent: Extent) -> Result<Report, Rejection> {
    let mut told = Vec::new();
    let report = super::archive((data, to), extent, &network_of, &mut |reached| told.push(reached))?;
    for (before, after) in told.iter().zip(told.iter().skip(1)) {
        assert!(before.segments < after.segments && before.bytes <= after.bytes, "{told:?}");
    }
    let last = told.last().copied().unwrap_or_default();
    assert!(last.segments <= last.of_segments && last.bytes == report.bytes_copied, "{told:?}");
    Ok(report)
}

#[test]
fn an_archive_has_the_layout_of_a_data_directory_and_is_of_one_network() {
    let root = tempfile::tempdir().unwrap();
    let (data, to) = (root.path().join("data"), root.path().join("archive"));
    fs::create_dir_all(&data).unwrap();
    assert_eq!(archive(&data, &to, Extent::Finished).unwrap_err().code, Code::BadFile, "no genesis");
    fs::write(data.join(GENESIS_FILE), b"fleet").unwrap();
    let network = network_of(b"fleet").unwrap();
    let blocks = open(Arc::new(RealDisk::open(data.join(BLOCKS_DIRECTORY)).unwrap()), network.0, 1);
    fill(&blocks, 100);
    let report = archive(&data, &to, Extent::Finished).unwrap();
    assert_eq!((report.network, report.first_height, report.snapshot), (network, 1, None));
    assert!(report.last_height > 80 && report.segments_copied > 5);
    assert_eq!(fs::read(to.join(GENESIS_FILE)).unwrap(), b"fleet");
    let again = archive(&data, &to, Extent::Finished).unwrap();
    assert_eq!((again.segments_copied, again.last_height), (0, report.last_height));
    fs::write(to.join(GENESIS_FILE), b"other").unwrap();
    let refused = archive(&data, &to, Extent::Finished).unwrap_err();
    assert!(refused.code == Code::BadFile && refused.message.contains("another network"), "{refused}");
}

#[test]
fn blocks_that_do_not_begin_at_1_are_archived_with_the_snapshot_before_them() {
    let root = tempfile::tempdir().unwrap();
    let (data, to) = (root.path().join("data"), root.path().join("archive"));
    fs::create_dir_all(data.join(SNAPSHOTS_DIRECTORY)).unwrap();
    fs::write(data.join(GENESIS_FILE), b"fleet").unwrap();
    let network = network_of(b"fleet").unwrap();
    let blocks = open(Arc::new(RealDisk::open(data.join(BLOCKS_DIRECTORY)).unwrap()), network.0, 1);
    fill(&blocks, 100);
    let first = blocks.prune(60).unwrap();
    fs::write(data.join(SNAPSHOTS_DIRECTORY).join(snapshot_name(first - 2)), b"too old").unwrap();
    let refused = archive(&data, &to, Extent::Finished).unwrap_err();
    assert!(refused.code == Code::BadFile && refused.advice().contains("snapshot"), "{refused}");
    for height in [70, first - 1, 90] {
        fs::write(data.join(SNAPSHOTS_DIRECTORY).join(snapshot_name(height)), height.to_string()).unwrap();
    }
    let report = archive(&data, &to, Extent::Finished).unwrap();
    assert_eq!((report.first_height, report.snapshot), (first, Some(first - 1)));
    let kept: Vec<_> = fs::read_dir(to.join(SNAPSHOTS_DIRECTORY)).unwrap().map(|item| item.unwrap().path()).collect();
    assert_eq!(kept, [to.join(SNAPSHOTS_DIRECTORY).join(snapshot_name(first - 1))]);
    // The node has dropped that snapshot since; the archive has it.
    fs::remove_dir_all(data.join(SNAPSHOTS_DIRECTORY)).unwrap();
    fill(&blocks, 150);
    let again = archive(&data, &to, Extent::Finished).unwrap();
    assert!(again.segments_copied > 0 && again.snapshot == report.snapshot);
}
