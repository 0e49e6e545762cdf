//! Results that are kept beside their blocks: shorter, and the same for every reader.

use crate::world::{Caller, NOW, SECOND, User, World, entry};
use bytes::Bytes;
use ledger::Ledger;
use ledger_base::hash::Hash;
use ledger_base::rejection::Code;
use ledger_identity::key::KeyKind;
use ledger_storage::block_store::{BlockStore, Options};
use ledger_storage::disk::{Disk, SimDisk};
use ledger_storage::entry::{Entry, EntryKind, HardState};
use ledger_storage::results::ResultStore;
use ledger_storage::snapshot::Snapshots;
use ledger_storage::state::{SledStore, State};
use std::path::Path;
use std::sync::Arc;

/// A node without a node: its log, and its ledger with results beside it.
struct Beside {
    blocks: Arc<BlockStore>,
    ledger: Ledger,
}

impl Beside {
    fn open(world: &World, directory: &Path, (blocks, results): (&SimDisk, &SimDisk)) -> Self {
        let (blocks, _) = BlockStore::open(Arc::new(blocks.clone()), Options::new(world.network.0, || 1)).unwrap();
        let blocks = Arc::new(blocks);
        let state = Arc::new(State::open(Box::new(SledStore::open(directory).unwrap())).unwrap());
        let results = ResultStore::open(Arc::new(results.clone()), world.network).unwrap().beside(Arc::clone(&blocks));
        Self { ledger: world.try_ledger_on(state, Arc::new(results)).unwrap(), blocks }
    }

    fn apply(&self, block: &Entry) {
        let committed = HardState { term: 1, vote: 1, commit: block.index };
        self.blocks.append(std::slice::from_ref(block), Some(&committed)).unwrap();
        self.blocks.flush().unwrap();
        self.ledger.apply(block).unwrap();
    }
}

/// Every kind of block, and every kind of outcome in it.
fn chain(world: &World, salma: &User) -> (Vec<Entry>, Vec<Hash>) {
    let ledger = world.ledger();
    let call = |function: &str, args: &[&str]| salma.sign(&salma.body(world.network, function, args));
    let (mut blocks, mut ids) = (Vec::new(), Vec::new());
    for round in 0..6u64 {
        let time = NOW + round * SECOND;
        let (first, second) = (call("foretold", &["a", "1"]), call("foretold", &["b", "2"]));
        let told_otherwise = call("foretold", &["otherwise", "3"]);
        let (plain, refused, panics) = (call("put", &["c", "3"]), call("put-then-refuse", &["k"]), call("gone", &[]));
        let alarm = call("put", &["alarm", ""]);
        for calls in [
            vec![&first],
            vec![&plain, &told_otherwise],
            vec![&second, &refused, &first, &panics, &call("foretold", &["d", "4"])],
            vec![],
            vec![&alarm],
        ] {
            blocks.push(entry(&ledger, time, &calls));
            ledger.apply(blocks.last().unwrap()).unwrap();
        }
        let bytes = ["no transaction".into(), first.encoded().clone()].to_vec();
        let data = ledger::block::Payload { time, transactions: bytes }.to_bytes();
        let rubbish = Bytes::from_static(&[0xff; 40]);
        for (kind, data) in [(EntryKind::Normal, data), (EntryKind::Normal, rubbish), (EntryKind::Normal, Bytes::new())]
        {
            let block = Entry { index: ledger.tip().height + 1, term: 1, kind, data };
            ledger.apply(&block).unwrap();
            blocks.push(block);
        }
        ids.extend([first.id(), plain.id(), told_otherwise.id(), second.id(), refused.id(), panics.id(), alarm.id()]);
    }
    (blocks, ids)
}

fn same(beside: &Beside, straight: &Ledger, ids: &[Hash]) {
    for height in 0..=beside.ledger.tip().height {
        let wanted = straight.result(height).unwrap().unwrap();
        assert_eq!(beside.ledger.result(height).unwrap().as_ref(), Some(&wanted), "height {height}");
        let hashes = beside.ledger.block_hashes(height).unwrap().unwrap();
        assert_eq!((hashes.time, hashes.hash, hashes.digest), (wanted.time, wanted.hash(), wanted.digest()));
        if let Some(block) = beside.blocks.entry(height).unwrap() {
            assert_eq!(beside.ledger.result_of(&block).unwrap(), Some(wanted));
        }
    }
    for id in ids {
        assert_eq!(beside.ledger.transaction(id).unwrap(), straight.transaction(id).unwrap(), "{id}");
    }
}

#[test]
fn results_beside_their_blocks_read_as_whole_ones_do() {
    let world = World::new();
    let salma = world.org1.user("Salma", "member", KeyKind::Ed25519);
    let (blocks, ids) = chain(&world, &salma);
    let straight = world.ledger();
    blocks.iter().for_each(|block| drop(straight.apply(block).unwrap()));
    assert!(blocks.iter().any(|block| straight.result(block.index).unwrap().unwrap().events.len() > 1));

    let (directory, log, results) = (tempfile::tempdir().unwrap(), SimDisk::new(1), SimDisk::new(2));
    let beside = Beside::open(&world, directory.path(), (&log, &results));
    for block in &blocks {
        beside.apply(block);
        if block.index == 20 {
            beside.ledger.flush(None).unwrap();
        }
    }
    same(&beside, &straight, &ids);
    beside.ledger.flush(None).unwrap();
    same(&beside, &straight, &ids);
    drop(beside);
    let beside = Beside::open(&world, directory.path(), (&log, &results));
    assert_eq!(beside.ledger.tip(), straight.tip());
    same(&beside, &straight, &ids);
    // What counts once is known without the blocks.
    let again = entry(&straight, NOW + 6 * SECOND, &[&salma.sign(&salma.body(world.network, "put", &["z", "z"]))]);
    beside.apply(&again);
    assert_eq!(straight.apply(&again).unwrap().digest, beside.ledger.tip().digest);
}

#[test]
fn a_call_that_came_out_as_foretold_takes_less_than_half_the_space() {
    let world = World::new();
    let salma = world.org1.user("Salma", "member", KeyKind::Ed25519);
    let size = |function: &str, beside: bool| {
        let (directory, log, results) = (tempfile::tempdir().unwrap(), SimDisk::new(1), SimDisk::new(2));
        let node = Beside::open(&world, directory.path(), (&log, &results));
        let whole = world.ledger_on(&directory.path().join("whole"), &results_of(beside, &results));
        for round in 0..50u64 {
            let call = salma.sign(&salma.body(world.network, function, &["Turtlebot4/cmd_vel", &"v".repeat(100)]));
            let block = entry(&node.ledger, NOW + round, &[&call]);
            node.apply(&block);
            whole.apply(&block).unwrap();
        }
        if beside {
            node.ledger.flush(None).unwrap()
        } else {
            whole.flush(None).unwrap()
        }
        bytes(&results)
    };
    let (told, plain, whole) = (size("foretold", true), size("put", true), size("put", false));
    assert!(told * 2 < whole && told < plain && plain < whole, "{told} {plain} {whole} bytes");
    // The block itself: its hash, its digest, and the hash of its writes.
    assert!(told < 128 + 50 * 139, "{told} bytes for 50 calls");
}

fn results_of(beside: bool, results: &SimDisk) -> SimDisk {
    if beside { SimDisk::new(9) } else { results.clone() }
}

fn bytes(disk: &SimDisk) -> u64 {
    disk.list().unwrap().iter().map(|name| disk.open(name).unwrap().len().unwrap()).sum()
}

#[test]
fn a_result_beside_another_block_is_not_taken_for_its_result() {
    let world = World::new();
    let salma = world.org1.user("Salma", "member", KeyKind::Ed25519);
    let (directory, log, results) = (tempfile::tempdir().unwrap(), SimDisk::new(1), SimDisk::new(2));
    let node = Beside::open(&world, directory.path(), (&log, &results));
    let call = |value: &str| salma.sign(&salma.body(world.network, "foretold", &["a", value]));
    let block = entry(&node.ledger, NOW, &[&call("1")]);
    node.apply(&block);
    for calls in [vec![call("2")], vec![], vec![call("1"), call("2")]] {
        let transactions = calls.iter().map(|call| call.encoded().clone()).collect();
        let other = Entry { data: ledger::block::Payload { time: NOW, transactions }.to_bytes(), ..block.clone() };
        assert_eq!(node.ledger.result_of(&other).unwrap_err().code, Code::Corrupt);
    }
    assert!(node.ledger.result_of(&block).unwrap().is_some());
}

#[test]
fn a_snapshot_is_the_same_whether_results_are_kept_short_or_whole() {
    let world = World::new();
    let salma = world.org1.user("Salma", "member", KeyKind::Ed25519);
    let (blocks, _) = chain(&world, &salma);
    let made = |beside: bool| {
        let (directory, log, results) = (tempfile::tempdir().unwrap(), SimDisk::new(1), SimDisk::new(2));
        let snapshots = Snapshots::open(Arc::new(SimDisk::new(3)), world.network).unwrap();
        let node = Beside::open(&world, directory.path(), (&log, &results));
        let whole = world.ledger_on(&directory.path().join("whole"), &SimDisk::new(4));
        let ledger = if beside { &node.ledger } else { &whole };
        for block in &blocks {
            if beside {
                node.apply(block)
            } else {
                drop(whole.apply(block).unwrap())
            }
            if block.index % 7 == 0 {
                ledger.flush(Some(&snapshots)).unwrap();
            }
        }
        ledger.flush(Some(&snapshots)).unwrap();
        let newest = snapshots.newest().unwrap();
        (newest.manifest().height, newest.content())
    };
    let short = made(true);
    assert_eq!(short, made(false));
    assert!(short.0 >= 40);
}
