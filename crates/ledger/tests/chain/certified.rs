//! The hashes that voters sign: a function of what executing gave, over restarts and snapshots.

use crate::world::{Caller, NOW, SECOND, World, block, entry};
use ledger::members::{Change, MembershipChange};
use ledger::{Ledger, Outcome};
use ledger_base::hash::Hash;
use ledger_identity::key::KeyKind;
use ledger_light::control::{self, Write};
use ledger_light::fact::{self, Fact};
use ledger_storage::disk::SimDisk;
use ledger_storage::entry::{Entry, EntryKind};
use ledger_storage::result::Roots;
use ledger_storage::results::ResultStore;
use ledger_storage::snapshot::Snapshots;
use ledger_storage::state::{MemoryState, State};
use std::sync::Arc;

fn roots(ledger: &Ledger, height: u64) -> Roots {
    ledger.block_hashes(height).unwrap().unwrap().roots.unwrap()
}

/// The next block: node 2 follows, or leaves.
fn membership(ledger: &Ledger, change: Change) -> Entry {
    let data = MembershipChange::new([change]).to_bytes();
    Entry { index: ledger.tip().height + 1, term: 1, kind: EntryKind::ConfChangeV2, data }
}

/// The results root as a reader computes it who was told the outcome and the control writes.
fn recomputed(outcome: &Outcome, [governing, control, previous]: [Hash; 3], writes: &[Write<'_>]) -> Hash {
    let mut facts = vec![Fact::Ground { governing, control, digest: outcome.digest, previous }];
    for (index, (id, result)) in outcome.ids.iter().zip(&outcome.results).enumerate() {
        let (index, response) = (index as u32, Hash::of(&[&result.response]));
        facts.push(Fact::Verdict { index, id: *id, code: result.code, response });
    }
    facts.extend(outcome.events.iter().map(|emitted| Fact::Event {
        index: emitted.index,
        chaincode: &emitted.event.chaincode,
        name: &emitted.event.name,
        subject: &emitted.event.subject,
        payload: Hash::of(&[&emitted.event.payload]),
    }));
    facts.extend(writes.iter().map(|write| Fact::Control { key: write.key, value: write.value }));
    fact::root(facts)
}

#[test]
fn a_reader_computes_the_roots_from_what_it_is_told_and_writes_that_govern_alone_move_the_governing_chain() {
    let world = World::new();
    let ledger = world.ledger();
    let salma = world.org1.user("Salma", "member", KeyKind::Ed25519);
    let (genesis, mut before) = (roots(&ledger, 0), roots(&ledger, 0));
    assert_ne!(genesis.governing, Hash::ZERO, "organisations, nodes and members govern");
    let put = |function: &str| salma.sign(&salma.body(world.network, function, &["a", "1"]));
    for height in 1..=6 {
        let (put, refused) = (put("put"), put("put-then-refuse"));
        let entry = match height {
            3 => membership(&ledger, Change::AddLearner(2)),
            _ => entry(&ledger, NOW + height * SECOND, &[&put, &refused]),
        };
        let outcome = ledger.apply(&entry).unwrap();
        let told = ledger.writes(height).unwrap();
        let control: Vec<_> = told.iter().filter(|write| &write.key[..] == b"msp\0members").collect();
        assert_eq!(control.len(), usize::from(height == 3), "{told:?}");
        let writes: Vec<_> = control.iter().map(|write| Write { key: &write.key, value: write.value }).collect();
        let chain = control::extend(before.governing, height, &writes).unwrap();
        let (found, governs) = (outcome.certifiable.unwrap(), outcome.governs);
        assert_eq!((found.governing, found.control), (chain, genesis.control), "{height}");
        let chains = [chain, genesis.control, before.results];
        assert_eq!(found.results, recomputed(&outcome, chains, &writes), "{height}");
        assert_eq!((governs, roots(&ledger, height)), (height == 3, found));
        before = found;
    }
    assert_ne!(before.governing, genesis.governing);
}

#[test]
fn blocks_with_control_writes_and_the_first_of_each_window_are_due() {
    let world = World::new();
    let ledger = world.ledger();
    let due = |outcome: &Outcome| outcome.certifiable.is_some();
    let at = |microseconds: u64| due(&block(&ledger, NOW + microseconds, &[]));
    let times = [(0, true), (0, false), (199_999, false), (200_000, true), (399_999, false), (SECOND, true)];
    for (time, wanted) in times {
        assert_eq!(at(time), wanted, "{time}");
    }
    assert!(due(&ledger.apply(&membership(&ledger, Change::AddLearner(2))).unwrap()), "at the same time");
    assert!(!at(SECOND + 1));
}

#[test]
fn a_restart_and_a_snapshot_go_on_with_the_same_roots() {
    let world = World::new();
    let salma = world.org1.user("Salma", "member", KeyKind::Ed25519);
    let without = world.ledger();
    let (place, results, snapshots) = (tempfile::tempdir().unwrap(), SimDisk::new(1), SimDisk::new(2));
    let kept = Snapshots::open(Arc::new(snapshots), world.network).unwrap();
    let mut entries = Vec::new();
    for height in 1..=23u64 {
        let put = salma.sign(&salma.body(world.network, "put", &["a", &height.to_string()]));
        let next = match height {
            4 => membership(&without, Change::AddLearner(2)),
            15 => membership(&without, Change::Remove(2)),
            _ => entry(&without, NOW + height * 10 * SECOND, &[&put]),
        };
        without.apply(&next).unwrap();
        entries.push(next);
        let restarted = world.ledger_on(place.path(), &results);
        restarted.apply(&entries[height as usize - 1]).unwrap();
        assert_eq!(roots(&restarted, height), roots(&without, height), "{height}");
        restarted.flush(Some(&kept)).unwrap();
    }
    let snapshot = kept.newest().unwrap();
    assert_eq!(snapshot.manifest().height, 20);
    let (store, filled) = (MemoryState::default(), Arc::new(ResultStore::in_memory()));
    snapshot.fill(&store, &filled).unwrap();
    let state = Arc::new(State::open(Box::new(store)).unwrap());
    let begun = world.try_ledger_on(state, filled).unwrap();
    for next in &entries[20..] {
        begun.apply(next).unwrap();
        assert_eq!(roots(&begun, next.index), roots(&without, next.index));
    }
}

#[test]
fn a_restart_between_two_certified_blocks_goes_on_from_the_one_before() {
    let world = World::new();
    let (without, place, results) = (world.ledger(), tempfile::tempdir().unwrap(), SimDisk::new(1));
    for height in 1..=9u64 {
        let time = NOW + SECOND + height * 100_000;
        let next = entry(&without, time, &[]);
        let outcome = without.apply(&next).unwrap();
        assert_eq!(outcome.certifiable.is_some(), height % 2 == 0 || height == 1, "{height}");
        let restarted = world.ledger_on(place.path(), &results);
        assert_eq!(restarted.apply(&next).unwrap().certifiable, outcome.certifiable, "{height}");
        restarted.flush(None).unwrap();
    }
}

/// `crates/light` makes the vectors without this crate, and other languages read them.
#[test]
fn a_genesis_of_the_vectors_governs_as_they_say() {
    let file = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../tests/fixtures/certified.json");
    let vectors: serde_json::Value = serde_json::from_slice(&std::fs::read(file).unwrap()).unwrap();
    let beginnings = vectors["beginnings"].as_object().unwrap().values();
    let mut founded = 0;
    for begin in beginnings.filter(|begin| begin["genesis"].is_string()) {
        let governance = ledger::network::Genesis::governance(begin["genesis"].as_str().unwrap().as_bytes()).unwrap();
        let hash = |field: &str| Hash::from_hex(begin[field].as_str().unwrap()).unwrap();
        assert_eq!((governance.network(), governance.chain()), (hash("network"), hash("governing")));
        assert_eq!(governance.time(), begin["time"].as_u64().unwrap());
        founded += 1;
    }
    assert!(founded > 2);
}
