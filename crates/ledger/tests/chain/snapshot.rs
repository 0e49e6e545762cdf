//! Snapshots: the same bytes on every node, and a ledger that goes on from them as the others do.

use crate::world::{Caller, NOW, SECOND, SNAPSHOT_EVERY, User, World, codes, entry};
use ledger::Ledger;
use ledger::transaction::{Body, Transaction};
use ledger_base::rejection::Code;
use ledger_identity::key::KeyKind;
use ledger_storage::disk::{Disk, SimDisk};
use ledger_storage::entry::Entry;
use ledger_storage::results::ResultStore;
use ledger_storage::snapshot::{Item, Manifest, Snapshot, Snapshots};
use ledger_storage::state::{MemoryState, State, Store};
use std::path::Path;
use std::sync::Arc;

struct Chain {
    world: World,
    salma: User,
    entries: Vec<Entry>,
    calls: Vec<Transaction>,
}

impl Chain {
    /// Blocks of several calls, some of them refused, ten seconds apart; large values, so that there are several chunks.
    fn new(height: u64) -> Self {
        Self::paced(height, 10 * SECOND, 40_000)
    }

    /// So much block time between two blocks; values of some such length.
    fn paced(height: u64, pace: u64, repeated: usize) -> Self {
        let world = World::new();
        let salma = world.org1.user("Salma", "member", KeyKind::Ed25519);
        let ledger = world.ledger();
        let (mut entries, mut calls) = (Vec::new(), Vec::new());
        for height in 1..=height {
            let time = NOW + height * pace;
            let value = height.to_string().repeat(repeated);
            let [put, refused] = [
                world_call(&world, &salma, time, "put", &[&format!("k{}", height % 37), &value]),
                world_call(&world, &salma, time, "put-then-refuse", &["k"]),
            ];
            entries.push(entry(&ledger, time, &[&put, &refused]));
            ledger.apply(entries.last().unwrap()).unwrap();
            calls.push(put);
        }
        Self { world, salma, entries, calls }
    }

    fn snapshots(&self, disk: &SimDisk) -> Snapshots {
        Snapshots::open(Arc::new(disk.clone()), self.world.network).unwrap()
    }

    /// Executes blocks up to a height and stores after every so many.
    fn run(&self, place: &Path, results: &SimDisk, snapshots: &SimDisk, height: u64, flush_every: u64) -> Ledger {
        let ledger = self.world.ledger_on(place, results);
        let snapshots = self.snapshots(snapshots);
        while ledger.tip().height < height {
            let next = ledger.tip().height + 1;
            ledger.apply(&self.entries[next as usize - 1]).unwrap();
            if next.is_multiple_of(flush_every) {
                ledger.flush(Some(&snapshots)).unwrap();
            }
        }
        ledger.flush(Some(&snapshots)).unwrap();
        ledger
    }

    /// A node's newest snapshot after a run.
    fn made(&self, height: u64, flush_every: u64) -> (SimDisk, Arc<Snapshot>) {
        let (place, disk) = (tempfile::tempdir().unwrap(), SimDisk::new(1));
        self.run(place.path(), &SimDisk::new(2), &disk, height, flush_every);
        let newest = self.snapshots(&disk).newest().unwrap();
        (disk, newest)
    }
}

fn world_call(world: &World, user: &User, time: u64, function: &str, args: &[&str]) -> Transaction {
    user.sign(&Body { not_after: time + 100 * SECOND, ..user.body(world.network, function, args) })
}

fn bytes(disk: &SimDisk, name: &str) -> Vec<u8> {
    let file = disk.open(name).unwrap();
    let mut bytes = vec![0; usize::try_from(file.len().unwrap()).unwrap()];
    file.read_at(&mut bytes, 0).unwrap();
    bytes
}

#[test]
fn nodes_make_the_same_bytes_whenever_they_store_and_restart() {
    let chain = Chain::new(57);
    let (disk, newest) = chain.made(57, 1);
    assert_eq!(disk.list().unwrap(), ["00000000000000000040.snap", "00000000000000000050.snap"], "the newest two");
    assert!(newest.manifest().chunks.len() > 1);
    for flush_every in [3, 7, 10, 1000] {
        let (other, _) = chain.made(57, flush_every);
        for name in disk.list().unwrap() {
            assert_eq!(bytes(&disk, &name), bytes(&other, &name), "{name}, stored every {flush_every} blocks");
        }
    }
    // With restarts in between, one of them before the cut at 50 was stored.
    let place = tempfile::tempdir().unwrap();
    let (results, other) = (SimDisk::new(5), SimDisk::new(6));
    for height in [13, 50, 57] {
        drop(chain.run(place.path(), &results, &other, height, 4));
        let lost = chain.world.ledger_on(place.path(), &results);
        lost.apply(&chain.entries[height as usize % 57]).map(drop).unwrap_or_default();
        drop(lost);
        results.crash();
        other.crash();
    }
    assert_eq!(bytes(&disk, "00000000000000000050.snap"), bytes(&other, "00000000000000000050.snap"));
}

#[test]
fn where_blocks_come_quickly_a_snapshot_is_made_once_in_a_period_and_by_all_nodes_alike() {
    // 12 ms for each block between two snapshots.
    let (period, pace) = (SNAPSHOT_EVERY * 12_000, 5_000);
    let chain = Chain::paced(200, pace, 1);
    let made = |restart_every: usize| {
        let (place, results, disk) = (tempfile::tempdir().unwrap(), SimDisk::new(1), SimDisk::new(2));
        let snapshots = chain.snapshots(&disk);
        let mut heights = Vec::new();
        for entries in chain.entries.chunks(restart_every) {
            let ledger = chain.world.ledger_on(place.path(), &results);
            for entry in entries {
                ledger.apply(entry).unwrap();
                ledger.flush(Some(&snapshots)).unwrap();
                heights.extend(snapshots.newest().map(|newest| newest.manifest().height));
            }
        }
        heights.dedup();
        heights
    };
    let heights = made(200);
    assert_eq!(made(7), heights, "with restarts");
    let periods: Vec<u64> = heights.iter().map(|height| (NOW + height * pace) / period).collect();
    assert!(periods.is_sorted_by(|one, next| one < next), "one in each period: {heights:?}");
    let all = (NOW + 200 * pace) / period - NOW / period;
    assert!(periods.len() as u64 + 1 >= all, "{heights:?}: one in each of {all} periods, but perhaps the last");
    assert!(heights.iter().all(|height| height.is_multiple_of(SNAPSHOT_EVERY)), "{heights:?}");
}

#[test]
fn a_pinned_snapshot_stays_beside_the_newest_ones_until_another_one_is_pinned() {
    let chain = Chain::paced(100, 10 * SECOND, 10);
    let (place, results, disk) = (tempfile::tempdir().unwrap(), SimDisk::new(1), SimDisk::new(2));
    let (ledger, snapshots) = (chain.world.ledger_on(place.path(), &results), chain.snapshots(&disk));
    let (mut made, mut kept) = (Vec::new(), Vec::new());
    for entry in &chain.entries {
        ledger.apply(entry).unwrap();
        ledger.flush(Some(&snapshots)).unwrap();
        let newest = snapshots.newest().map_or(0, |newest| newest.manifest().height);
        if newest == 0 || made.last() == Some(&newest) {
            continue;
        }
        made.push(newest);
        // The first one is pinned for a while.
        snapshots.pin(if made.len() < 5 { made[0] } else { 0 });
        kept.push(snapshots.oldest().unwrap().manifest().height);
    }
    assert!(made.len() > 6, "{made:?}");
    assert_eq!(kept[..5], [made[0]; 5], "{made:?}");
    assert_eq!(kept[5..], made[4..made.len() - 1]);
    assert_eq!(disk.list().unwrap().len(), 2);
}

#[test]
fn a_result_that_cannot_be_read_costs_a_snapshot_and_stops_nobody() {
    let chain = Chain::new(30);
    let (place, results, disk) = (tempfile::tempdir().unwrap(), SimDisk::new(1), SimDisk::new(2));
    let (ledger, snapshots) = (chain.world.ledger_on(place.path(), &results), chain.snapshots(&disk));
    let apply = |entries: &[Entry]| entries.iter().for_each(|entry| drop(ledger.apply(entry).unwrap()));
    apply(&chain.entries[..19]);
    ledger.flush(Some(&snapshots)).unwrap();
    // Whether a snapshot is due at 20 depends on the time of block 10.
    results.fail_read(1);
    apply(&chain.entries[19..20]);
    apply(&chain.entries[20..]);
    ledger.flush(Some(&snapshots)).unwrap();
    assert_eq!(disk.list().unwrap(), ["00000000000000000010.snap", "00000000000000000030.snap"]);
}

#[test]
fn a_snapshot_that_was_due_when_the_node_stopped_is_made_at_the_next_start() {
    let chain = Chain::new(20);
    let (place, results, disk) = (tempfile::tempdir().unwrap(), SimDisk::new(1), SimDisk::new(2));
    {
        let ledger = chain.world.ledger_on(place.path(), &results);
        chain.entries.iter().for_each(|entry| drop(ledger.apply(entry).unwrap()));
        // The state at 20 is stored; the process ends before the snapshot is written.
        ledger.flush(None).unwrap();
    }
    let snapshots = chain.snapshots(&disk);
    chain.world.ledger_on(place.path(), &results).flush(Some(&snapshots)).unwrap();
    let (_, wanted) = chain.made(20, 1000);
    assert_eq!(snapshots.newest().unwrap().content(), wanted.content());
}

#[test]
fn a_ledger_on_a_snapshot_goes_on_as_the_others_and_knows_the_same_duplicates() {
    let chain = Chain::new(55);
    let (_, snapshot) = chain.made(50, 6);
    let straight = chain.world.ledger();
    chain.entries[..50].iter().for_each(|entry| drop(straight.apply(entry).unwrap()));
    let (store, results) = (MemoryState::default(), SimDisk::new(9));
    let kept = Arc::new(ResultStore::open(Arc::new(results), chain.world.network).unwrap());
    snapshot.fill(&store, &kept).unwrap();
    let state = Arc::new(State::open(Box::new(store)).unwrap());
    let ledger = chain.world.try_ledger_on(state, kept).unwrap();
    assert_eq!(ledger.tip(), straight.tip());
    assert_eq!(ledger.state().world(None, 1000).unwrap(), straight.state().world(None, 1000).unwrap());
    assert_eq!(ledger.results().first(), 38, "blocks of the last 120 s");

    // What was executed before the snapshot is a duplicate after it; its first verdict is known.
    let [recent, old] = [&chain.calls[48], &chain.calls[10]];
    assert_eq!(ledger.transaction(&recent.id()).unwrap().unwrap().height, 49);
    assert_eq!(ledger.transaction(&old.id()).unwrap(), None);
    let again = entry(&ledger, NOW + 505 * SECOND, &[recent, old]);
    let (a, b) = (ledger.apply(&again).unwrap(), straight.apply(&again).unwrap());
    assert_eq!(codes(&a), [Code::Duplicate, Code::Expired]);
    assert_eq!(a, b);
    // Both make the same next snapshot.
    let more: Vec<_> = (0..9u64)
        .map(|i| {
            let time = NOW + (510 + i) * SECOND;
            entry_of(&chain, 52 + i, time)
        })
        .collect();
    let (one, two) = (SimDisk::new(11), SimDisk::new(12));
    let (place, results) = (tempfile::tempdir().unwrap(), SimDisk::new(13));
    let full = chain.run(place.path(), &results, &SimDisk::new(14), 50, 8);
    for entry in std::iter::once(&again).chain(&more) {
        assert_eq!(
            full.apply(entry).unwrap().hash,
            if entry.index == 51 { a.hash } else { ledger.apply(entry).unwrap().hash }
        );
    }
    ledger.flush(Some(&chain.snapshots(&one))).unwrap();
    full.flush(Some(&chain.snapshots(&two))).unwrap();
    let name = "00000000000000000060.snap";
    assert_eq!(bytes(&one, name), bytes(&two, name));
}

fn entry_of(chain: &Chain, index: u64, time: u64) -> Entry {
    let call = world_call(&chain.world, &chain.salma, time, "put", &["later", &index.to_string()]);
    let data = ledger::block::Payload { time, transactions: vec![call.encoded().clone()] }.to_bytes();
    Entry { index, term: 1, kind: ledger_storage::entry::EntryKind::Normal, data }
}

#[test]
fn a_snapshot_is_fetched_chunk_by_chunk_over_crashes_and_lies() {
    let chain = Chain::new(30);
    let (from, snapshot) = chain.made(30, 10);
    let manifest = Manifest::from_bytes(&snapshot.manifest().to_bytes()).unwrap();
    assert_eq!(manifest.content(), snapshot.content());
    let disk = SimDisk::new(3);
    let (mut crashes, mut puts) = (0, 0);
    let accepted = loop {
        let snapshots = chain.snapshots(&disk);
        assert!(snapshots.newest().is_none());
        let mut installer = snapshots.install(manifest.clone()).unwrap();
        let Some(wanted) = installer.wanted() else { break installer.accept().unwrap() };
        let chunk = snapshot.chunk(wanted).unwrap();
        let mut lie = chunk.to_vec();
        lie[17] ^= 1;
        assert_eq!(installer.put(&lie).unwrap_err().code, Code::Malformed);
        assert_eq!(installer.put(&chunk[1..]).unwrap_err().code, Code::Malformed);
        assert_eq!(installer.complete().map(drop).unwrap_err().code, Code::Internal);
        installer.put(&chunk).unwrap();
        puts += 1;
        drop(installer);
        drop(snapshots);
        if crashes < 3 {
            crashes += 1;
            disk.crash();
        } else {
            disk.kill();
        }
        assert!(puts < 100);
    };
    assert_eq!(accepted.content(), snapshot.content());
    let name = "00000000000000000030.snap";
    assert_eq!(disk.list().unwrap(), [name]);
    assert_eq!(bytes(&from, name), bytes(&disk, name));
    let other = Manifest { network: ledger_base::hash::Hash::ZERO, ..manifest };
    assert_eq!(chain.snapshots(&disk).install(other).map(drop).unwrap_err().code, Code::WrongNetwork);
}

#[test]
fn organisations_are_read_before_anything_is_installed() {
    let chain = Chain::new(10);
    let (_, snapshot) = chain.made(10, 10);
    let disk = SimDisk::new(3);
    let snapshots = chain.snapshots(&disk);
    let mut installer = snapshots.install(snapshot.manifest().clone()).unwrap();
    while let Some(wanted) = installer.wanted() {
        installer.put(&snapshot.chunk(wanted).unwrap()).unwrap();
    }
    let pairs = installer.complete().unwrap().pairs(b"msp\0organisation/", 10).unwrap();
    let keys: Vec<_> = pairs.iter().map(|(key, _)| &key[..]).collect();
    assert_eq!(keys, [&b"msp\0organisation/Org1"[..], b"msp\0organisation/Org2"]);
    assert!(snapshots.newest().is_none(), "not accepted yet");
    installer.discard().unwrap();
    assert_eq!(disk.list().unwrap(), Vec::<String>::new());
}

#[test]
fn every_flipped_bit_of_a_snapshot_is_noticed() {
    let chain = Chain::new(10);
    let (disk, snapshot) = chain.made(10, 10);
    let name = "00000000000000000010.snap";
    let length = bytes(&disk, name).len() as u64;
    let mut noticed = 0;
    for bit in (0..length * 8).step_by(length as usize * 8 / 150).chain(length * 8 - 300..length * 8) {
        assert!(disk.flip(name, bit));
        let found = chain.snapshots(&disk).newest();
        let whole = found.is_some_and(|snapshot| snapshot.items().all(|item| item.is_ok()));
        assert!(!whole, "bit {bit}");
        noticed += 1;
        assert!(disk.flip(name, bit));
    }
    assert!(noticed > 400);
    assert!(snapshot.items().all(|item| item.is_ok()));
    let heights: Vec<u64> = snapshot
        .items()
        .filter_map(|item| match item.unwrap() {
            Item::Result(height, result) => {
                assert!(result.events.is_empty() && result.results.iter().all(|result| result.message.is_empty()));
                Some(height)
            }
            Item::Pair(..) => None,
        })
        .collect();
    assert_eq!(heights, (1..=SNAPSHOT_EVERY).collect::<Vec<_>>());
}

#[test]
fn a_state_that_was_not_filled_to_the_end_is_refused() {
    let chain = Chain::new(20);
    let (_, snapshot) = chain.made(20, 10);
    let disk = SimDisk::new(8);
    // Results are written after the pairs and before the state becomes one.
    disk.fail_sync(1);
    let (store, results) = (Shared(Arc::default()), ResultStore::open(Arc::new(disk), chain.world.network).unwrap());
    assert_eq!(snapshot.fill(&store, &results).unwrap_err().code, Code::DiskFailed);
    assert_eq!(State::open(Box::new(store.clone())).map(drop).unwrap_err().code, Code::Corrupt);
    let results = ResultStore::in_memory();
    assert_eq!(snapshot.fill(&store, &results).unwrap_err().code, Code::BadFile, "only into an empty one");
}

/// A store that outlives its state.
#[derive(Clone)]
struct Shared(Arc<MemoryState>);

impl Store for Shared {
    fn get(&self, key: &[u8]) -> Result<Option<bytes::Bytes>, ledger_base::rejection::Rejection> {
        Store::get(&*self.0, key)
    }

    fn range(
        &self,
        prefix: &[u8],
        after: Option<&[u8]>,
        limit: usize,
    ) -> Result<Vec<(bytes::Bytes, bytes::Bytes)>, ledger_base::rejection::Rejection> {
        Store::range(&*self.0, prefix, after, limit)
    }

    fn write(
        &self,
        batch: &ledger_storage::state::WriteSet,
        tip: (&[u8], &[u8]),
    ) -> Result<(), ledger_base::rejection::Rejection> {
        self.0.write(batch, tip)
    }
}
