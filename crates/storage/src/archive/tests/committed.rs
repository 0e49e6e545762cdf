//! All that is committed is archived when one asks for it, and nothing else.

use super::*;

fn copy_committed(source: &SimDisk, target: &SimDisk, executed: u64) -> Result<Copied, Rejection> {
    copy_upto(source, target, Upto::Committed(executed))
}

fn append(store: &BlockStore, indexes: std::ops::RangeInclusive<u64>, term: u64, commit: u64) {
    let entry = |index| Entry { index, term, kind: EntryKind::Normal, data: vec![term as u8; 50].into() };
    let entries: Vec<_> = indexes.map(entry).collect();
    store.append(&entries, Some(&HardState { term, vote: 0, commit })).unwrap();
    store.flush().unwrap();
}

fn bytes(disk: &SimDisk, name: &str) -> Vec<u8> {
    let file = disk.open(name).unwrap();
    let mut bytes = vec![0; file.len().unwrap() as usize];
    file.read_at(&mut bytes, 0).unwrap();
    bytes
}

#[test]
fn each_run_replaces_the_unfinished_segment_by_a_longer_one_and_then_by_the_finished_one() {
    let (node, archive) = (SimDisk::new(1), SimDisk::new(2));
    let blocks = store(&node);
    for last in 1..=40 {
        fill(&blocks, last);
        let copied = copy_committed(&node, &archive, last).unwrap();
        assert_eq!((copied.first_height, copied.next_height), (1, last + 1));
        assert!((1..=2).contains(&copied.segments), "block {last}: {copied:?}");
        check(&archive, &blocks, &copied);
        assert_eq!(store(&archive.copy(1)).hard_state().commit, last);
        assert_eq!(copy_committed(&node, &archive, last).unwrap(), Copied { segments: 0, bytes: 0, ..copied });
        // What the node archives by itself leaves it alone.
        assert_eq!(copy(&node, &archive).unwrap().segments, 0);
        assert_eq!(segments(&archive), segments(&node));
    }
    let names = segments(&node);
    assert!(names.len() > 4);
    for name in &names[..names.len() - 1] {
        let archived = bytes(&archive, name);
        assert_eq!(archived, bytes(&node, name)[..archived.len()], "{name}");
    }
    // A run for finished segments only replaces it, too.
    let finished = names.len();
    while segments(&node).len() == finished {
        fill(&blocks, blocks.last_index() + 1);
    }
    let copied = copy(&node, &archive).unwrap();
    assert_eq!(copied.segments, 1);
    check(&archive, &blocks, &copied);
}

#[test]
fn what_is_not_committed_for_good_is_not_archived() {
    let (node, archive) = (SimDisk::new(1), SimDisk::new(2));
    let blocks = store(&node);
    fill(&blocks, 2);
    append(&blocks, 3..=5, 1, 2);
    let copied = copy_committed(&node, &archive, 0).unwrap();
    assert_eq!(copied.next_height, 3, "the rest may be superseded");
    check(&archive, &blocks, &copied);
    append(&blocks, 3..=3, 2, 3);
    // That word itself may be lost in a crash.
    assert_eq!(copy_committed(&node, &archive, 0).unwrap().next_height, 3);
    let copied = copy_committed(&node, &archive, 3).unwrap();
    assert_eq!(copied.next_height, 4, "executed is committed");
    check(&archive, &blocks, &copied);
    assert_eq!(store(&archive.copy(1)).entries(3..4, usize::MAX).unwrap()[0].term, 2);
    // The archive itself remembers.
    assert_eq!(copy_committed(&node, &archive, 0).unwrap(), Copied { segments: 0, bytes: 0, ..copied });
    let fresh = SimDisk::new(3);
    append(&blocks, 4..=4, 2, 3);
    let copied = copy_committed(&node, &fresh, 0).unwrap();
    assert_eq!(copied.next_height, 4, "the log proves it now");
    check(&fresh, &blocks, &copied);
}

#[test]
fn all_that_is_committed_is_archived_while_the_node_writes_and_drops() {
    let (node, archive) = (SimDisk::new(1), SimDisk::new(2));
    let blocks = store(&node);
    fill(&blocks, 20);
    std::thread::scope(|scope| {
        scope.spawn(|| fill(&blocks, 400));
        loop {
            let executed = blocks.durable_index();
            let copied = copy_committed(&node, &archive, executed).unwrap();
            assert!(copied.next_height > executed, "{copied:?}, executed {executed}");
            check(&archive, &blocks, &copied);
            // As the node does it itself.
            blocks.prune(copy(&node, &archive).unwrap().next_height).unwrap();
            if executed == 400 {
                break;
            }
        }
    });
    assert_eq!(store(&archive.copy(1)).last_index(), 400);
}

#[test]
fn a_damaged_record_of_a_committed_block_is_named_and_the_archive_stays_as_it_was() {
    let (node, archive) = (SimDisk::new(1), SimDisk::new(2));
    let blocks = store(&node);
    fill(&blocks, 3);
    copy_committed(&node, &archive, 3).unwrap();
    fill(&blocks, 5);
    let name = segments(&node).remove(0);
    let before = bytes(&archive, &name);
    // Up to the end of the last block's record: 96 bytes of header, 141 for each block with its hard state.
    for bit in (96 * 8..(96 + 4 * 141 + 92) * 8).step_by(97) {
        let (node, archive) = (node.copy(3), archive.copy(3));
        node.flip(&name, bit);
        let refused = copy_committed(&node, &archive, 5).unwrap_err();
        assert_eq!(refused.code, Code::Corrupt, "{refused}");
        assert!(refused.message.contains("the node") && refused.message.contains(&name), "{refused}");
        assert_eq!((archive.list().unwrap(), bytes(&archive, &name)), (vec![name.clone()], before.clone()));
    }
    for bit in (0..before.len() as u64 * 8).step_by(97) {
        let archive = archive.copy(3);
        archive.flip(&name, bit);
        let refused = copy_committed(&node, &archive, 5).unwrap_err();
        assert_eq!(refused.code, Code::Corrupt, "{refused}");
        assert!(refused.message.contains("the archive") && refused.message.contains(&name), "{refused}");
    }
}

#[test]
fn a_node_that_does_not_continue_the_archive_is_refused() {
    let (node, archive) = (SimDisk::new(1), SimDisk::new(2));
    let blocks = store(&node);
    fill(&blocks, 2);
    let fork = node.copy(1);
    fill(&blocks, 3);
    copy_committed(&node, &archive, 3).unwrap();
    let refused = copy_committed(&fork, &archive, 2).unwrap_err();
    assert!(refused.code == Code::Corrupt && refused.message.contains("block 3 was committed"), "{refused}");
    append(&store(&fork), 3..=4, 2, 3);
    let refused = copy_committed(&fork, &archive, 3).unwrap_err();
    assert!(refused.code == Code::ChainInvalid && refused.message.contains("different blocks"), "{refused}");
    // It was not finished when it was archived, and the node has dropped it since: at its very end as well.
    for last in 3..=6 {
        let (node, archive) = (node.copy(1), archive.copy(1));
        let blocks = store(&node);
        fill(&blocks, last);
        copy_committed(&node, &archive, last).unwrap();
        fill(&blocks, 12);
        let second = blocks.prune(10).unwrap();
        assert!((7..=8).contains(&second), "{second}");
        let refused = copy_committed(&node, &archive, 12).unwrap_err();
        assert!(refused.code == Code::BadFile && refused.message.contains("oldest block are missing"), "{refused}");
    }
}

#[test]
fn a_crash_while_the_unfinished_segment_is_replaced_leaves_the_one_before() {
    let node = SimDisk::new(1);
    let blocks = store(&node);
    fill(&blocks, 2);
    let begun = SimDisk::new(2);
    copy_committed(&node, &begun, 2).unwrap();
    fill(&blocks, 4);
    let faults: [fn(&SimDisk); 3] =
        [|disk| disk.fail_write(1, Fault::Short(300)), |disk| disk.fail_sync(1), |disk| disk.fail_dir_sync()];
    for fault in faults {
        for seed in 0..10 {
            let archive = begun.copy(seed);
            fault(&archive);
            copy_committed(&node, &archive, 4).unwrap_err();
            archive.crash();
            let archive = archive.copy(seed);
            assert!([2, 4].contains(&store(&archive.copy(1)).last_index()));
            let copied = copy_committed(&node, &archive, 4).unwrap();
            assert_eq!(copied.next_height, 5);
            check(&archive, &blocks, &copied);
            assert_eq!(archive.list().unwrap(), segments(&archive));
        }
    }
}

/// The same, on a real disk, with large blocks: what is read may be half written.
#[test]
fn all_that_is_committed_is_archived_beside_a_writer_on_a_real_disk() {
    let root = tempfile::tempdir().unwrap();
    let (data, to) = (root.path().join("data"), root.path().join("archive"));
    fs::create_dir_all(&data).unwrap();
    fs::write(data.join(GENESIS_FILE), b"fleet").unwrap();
    let network = network_of(b"fleet").unwrap();
    let mut options = Options::new(network.0, || 77);
    options.segment_bytes = 4 << 20;
    let disk = Arc::new(RealDisk::open(data.join(BLOCKS_DIRECTORY)).unwrap());
    let blocks = BlockStore::open(disk, options).unwrap().0;
    let last = 100;
    let write = || {
        for index in 1..=last {
            let entry = Entry { index, term: 1, kind: EntryKind::Normal, data: vec![index as u8; 200_000].into() };
            blocks.append(&[entry], Some(&HardState { term: 1, vote: 0, commit: index })).unwrap();
            blocks.flush().unwrap();
            blocks.prepare().unwrap();
        }
    };
    std::thread::scope(|scope| {
        scope.spawn(write);
        loop {
            let durable = blocks.durable_index();
            let report = archive(&data, &to, Extent::Committed).unwrap();
            // The word that the last one is committed is proven by what is written next.
            assert!(report.last_height + 1 >= durable, "{report:?}, durable {durable}");
            if durable == last {
                break;
            }
        }
    });
    let copy = RealDisk::open(to.join(BLOCKS_DIRECTORY)).unwrap();
    let archived = open(Arc::new(copy), network.0, 1);
    assert_eq!((archived.first_index(), archived.last_index()), (1, last - 1));
    assert_eq!(archived.entries(1..last, usize::MAX).unwrap(), blocks.entries(1..last, usize::MAX).unwrap());
}
