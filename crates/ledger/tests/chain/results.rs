//! Results beside the chain: kept, found, cut, dropped, and what decides about duplicates.

use crate::world::{Caller, NOW, SECOND, User, World, block, codes, entry};
use ledger::transaction::Transaction;
use ledger::{Admission, Ledger};
use ledger_base::hash::Hash;
use ledger_base::rejection::Code;
use ledger_identity::key::KeyKind;
use ledger_storage::disk::{Disk, Fault, SimDisk};
use ledger_storage::entry::Entry;
use ledger_storage::results::RESULTS_FILE_BYTES_MAX;

/// Somebody who writes notes, and blocks of them.
struct Writer {
    world: World,
    user: User,
}

impl Writer {
    fn new() -> Self {
        let world = World::new();
        let user = world.org1.user("Salma", "member", KeyKind::Ed25519);
        Self { world, user }
    }

    fn call(&self, value: &str, not_after: u64) -> Transaction {
        let body = self.user.body(self.world.network, "put", &["a", value]);
        self.user.sign(&ledger::transaction::Body { not_after, ..body })
    }

    /// Executes blocks up to a height, one a second; answers with them and with the ids in them.
    fn write(&self, ledger: &Ledger, height: u64) -> (Vec<Entry>, Vec<Hash>) {
        let (mut entries, mut ids) = (Vec::new(), Vec::new());
        while ledger.tip().height < height {
            let time = NOW + (ledger.tip().height + 1) * SECOND;
            let call = self.call("x", time + 2 * SECOND);
            ids.push(call.id());
            entries.push(entry(ledger, time, &[&call]));
            ledger.apply(entries.last().unwrap()).unwrap();
        }
        (entries, ids)
    }
}

#[test]
fn a_result_and_a_transaction_are_found_in_memory_in_files_and_after_a_restart() {
    let (writer, results) = (Writer::new(), SimDisk::new(1));
    let directory = tempfile::tempdir().unwrap();
    let straight = writer.world.ledger();
    let ids = {
        let ledger = writer.world.ledger_on(directory.path(), &results);
        let (entries, ids) = writer.write(&ledger, 40);
        entries.iter().for_each(|entry| drop(straight.apply(entry).unwrap()));
        ledger.flush(None).unwrap();
        let (entries, more) = writer.write(&ledger, 60);
        entries.iter().for_each(|entry| drop(straight.apply(entry).unwrap()));
        let all = [ids.clone(), more].concat();
        check(&ledger, &straight, &all);
        ids
    };
    results.crash();
    let ledger = writer.world.ledger_on(directory.path(), &results);
    assert_eq!(ledger.tip().height, 40, "what was not flushed is to be executed again");
    check(&ledger, &straight, &ids);
    assert!(ledger.result(41).unwrap().is_none());
}

fn check(ledger: &Ledger, straight: &Ledger, ids: &[Hash]) {
    for (height, id) in (1..).zip(ids) {
        assert_eq!(ledger.result(height).unwrap(), straight.result(height).unwrap(), "height {height}");
        let record = ledger.transaction(id).unwrap().unwrap();
        assert_eq!((record.height, record.index, record.result.id()), (height, 0, *id));
    }
    assert_eq!(ledger.result(0).unwrap().unwrap().hash(), ledger.network());
    assert_eq!(ledger.transaction(&Hash::ZERO).unwrap(), None);
}

#[test]
fn nothing_is_stored_that_the_log_on_the_disk_does_not_have() {
    let (writer, results) = (Writer::new(), SimDisk::new(6));
    let directory = tempfile::tempdir().unwrap();
    {
        let ledger = writer.world.ledger_on(directory.path(), &results);
        writer.write(&ledger, 20);
        ledger.flush_up_to(20, None).unwrap();
        writer.write(&ledger, 30);
        ledger.flush_up_to(29, None).unwrap();
        assert_eq!((ledger.tip().height, ledger.results().next()), (30, 31));
    }
    results.crash();
    let ledger = writer.world.ledger_on(directory.path(), &results);
    assert_eq!((ledger.tip().height, ledger.results().next()), (20, 21));
}

#[test]
fn results_that_reach_beyond_the_savepoint_are_cut_off_and_made_again() {
    let (writer, results) = (Writer::new(), SimDisk::new(2));
    let directory = tempfile::tempdir().unwrap();
    let rest = {
        let ledger = writer.world.ledger_on(directory.path(), &results);
        writer.write(&ledger, 20);
        ledger.flush(None).unwrap();
        let (rest, _) = writer.write(&ledger, 30);
        // As if the node were killed between storing the results and the state.
        ledger.results().flush(30).unwrap();
        rest
    };
    results.crash();
    let ledger = writer.world.ledger_on(directory.path(), &results);
    assert_eq!((ledger.tip().height, ledger.results().next()), (20, 21));
    rest.iter().for_each(|entry| drop(ledger.apply(entry).unwrap()));
    ledger.flush(None).unwrap();
    assert_eq!(ledger.results().next(), 31);
}

#[test]
fn results_that_do_not_reach_the_savepoint_are_refused_so_that_all_is_rebuilt() {
    let writer = Writer::new();
    for damage in 0..3 {
        let (directory, results) = (tempfile::tempdir().unwrap(), SimDisk::new(3));
        {
            let ledger = writer.world.ledger_on(directory.path(), &results);
            writer.write(&ledger, 20);
            ledger.flush(None).unwrap();
        }
        let name = results.list().unwrap().pop().unwrap();
        match damage {
            0 => results.remove(&name).unwrap(),
            1 => assert!(results.flip(&name, 300 * 8)),
            _ => assert!(results.flip(&name, 20 * 8)),
        }
        let refused = writer.world.open_on(directory.path(), &results).map(drop).unwrap_err();
        assert_eq!(refused.code, Code::Corrupt, "{refused}");
    }
}

#[test]
fn a_full_disk_loses_nothing_and_a_failed_sync_is_final() {
    let (writer, results) = (Writer::new(), SimDisk::new(4));
    let directory = tempfile::tempdir().unwrap();
    let ledger = writer.world.ledger_on(directory.path(), &results);
    let (_, ids) = writer.write(&ledger, 5);
    results.fail_write(2, Fault::Full(17));
    assert_eq!(ledger.flush(None).unwrap_err().code, Code::DiskFull);
    assert_eq!(ledger.state().stored(), None, "the savepoint is never before the results");
    ledger.flush(None).unwrap();
    assert_eq!(ledger.transaction(&ids[0]).unwrap().unwrap().height, 1);
    writer.write(&ledger, 9);
    results.fail_sync(1);
    for _ in 0..2 {
        assert_eq!(ledger.flush(None).unwrap_err().code, Code::DiskFailed);
        assert_eq!(ledger.state().stored().unwrap().height, 5);
    }
    drop(ledger);
    results.crash();
    assert_eq!(writer.world.ledger_on(directory.path(), &results).tip().height, 5);
}

#[test]
fn files_are_finished_searched_reopened_cut_and_dropped() {
    let (writer, results) = (Writer::new(), SimDisk::new(5));
    let directory = tempfile::tempdir().unwrap();
    // A response as large as the value: some forty blocks fill a file.
    let value = "v".repeat(500_000);
    let mut entries = Vec::new();
    let mut ids = Vec::new();
    {
        let ledger = writer.world.ledger_on(directory.path(), &results);
        while results.list().unwrap().len() < 4 {
            let time = NOW + (ledger.tip().height + 1) * 10 * SECOND;
            let call = writer.call(&value, time + 2 * SECOND);
            ids.push(call.id());
            entries.push(entry(&ledger, time, &[&call]));
            ledger.apply(entries.last().unwrap()).unwrap();
            if ledger.tip().height % 8 == 0 {
                ledger.flush(None).unwrap();
            }
        }
        ledger.flush(None).unwrap();
    }
    let names = results.list().unwrap();
    let height = ids.len() as u64;
    let ledger = writer.world.ledger_on(directory.path(), &results);
    assert!(RESULTS_FILE_BYTES_MAX / 500_000 < height);
    for (height, id) in (1..).zip(&ids) {
        assert_eq!(ledger.transaction(id).unwrap().unwrap().height, height);
        assert_eq!(ledger.result(height).unwrap().unwrap().results.len(), 1);
    }
    drop(ledger);

    // The last finished file is damaged: what follows is no use either.
    let damaged = SimDisk::new(6);
    for name in &names {
        copy(&results, &damaged, name);
    }
    assert!(damaged.flip(&names[2], 8 * 100_000));
    let refused = writer.world.open_on(directory.path(), &damaged);
    let read = refused.and_then(|ledger| ledger.result(names[2][..20].parse().unwrap()));
    assert_eq!(read.unwrap_err().code, Code::Corrupt);

    // Dropped are whole files, and never the last seconds.
    let ledger = writer.world.ledger_on(directory.path(), &results);
    let second: u64 = names[1][..20].parse().unwrap();
    assert_eq!(ledger.prune_results(second).unwrap(), 1, "the result before the first block is needed");
    assert_eq!(ledger.prune_results(second + 1).unwrap(), second);
    let oldest = ledger.prune_results(u64::MAX).unwrap();
    assert!(oldest > second && ledger.result(height - 12).unwrap().is_some());
    assert_eq!(ledger.transaction(&ids[0]).unwrap(), None);
    assert_eq!(ledger.transaction(ids.last().unwrap()).unwrap().unwrap().height, height);
    drop(ledger);
    assert_eq!(writer.world.ledger_on(directory.path(), &results).results().first(), oldest);
}

fn copy(from: &SimDisk, to: &SimDisk, name: &str) {
    let (source, target) = (from.open(name).unwrap(), to.create(name).unwrap());
    let mut bytes = vec![0; usize::try_from(source.len().unwrap()).unwrap()];
    source.read_at(&mut bytes, 0).unwrap();
    target.write_at(&bytes, 0).unwrap();
}

#[test]
fn a_transaction_counts_once_until_it_expires_and_is_expired_afterwards_whatever_a_node_remembers() {
    let writer = Writer::new();
    let directory = tempfile::tempdir().unwrap();
    let results = SimDisk::new(7);
    let straight = writer.world.ledger();
    let call = writer.call("once", NOW + 5 * SECOND + 300);
    let mut entries = Vec::new();
    let mut apply = |ledger: &Ledger, time: u64| {
        let entry = entry(ledger, time, &[&call]);
        let outcome = ledger.apply(&entry).unwrap();
        assert_eq!(straight.apply(&entry).unwrap(), outcome);
        entries.push(entry);
        codes(&outcome)[0]
    };
    {
        let ledger = writer.world.ledger_on(directory.path(), &results);
        assert_eq!(apply(&ledger, NOW), Code::Ok);
        assert_eq!(apply(&ledger, NOW + 5 * SECOND + 300), Code::Duplicate);
        ledger.flush(None).unwrap();
    }
    // The window is what the results of the last 120 s say.
    let ledger = writer.world.ledger_on(directory.path(), &results);
    assert_eq!(apply(&ledger, NOW + 5 * SECOND + 300), Code::Duplicate);
    // The same second: the id is still in memory here, and not any more in a node that was started just now.
    assert_eq!(apply(&ledger, NOW + 5 * SECOND + 301), Code::Expired);
    ledger.flush(None).unwrap();
    drop(ledger);
    let ledger = writer.world.ledger_on(directory.path(), &results);
    assert_eq!(apply(&ledger, NOW + 5 * SECOND + 302), Code::Expired);
    // The first verdict is the verdict, however often it is ordered again.
    assert_eq!(ledger.transaction(&call.id()).unwrap().unwrap().height, 1);
    apply(&ledger, NOW + 1000 * SECOND);
    match ledger.admit(call.encoded().clone(), NOW + 1000 * SECOND).unwrap() {
        Admission::Known(id, record) => assert_eq!((id, record.height), (call.id(), 1)),
        other => panic!("{other:?}"),
    }
}

#[test]
fn what_nobody_known_has_signed_takes_no_id() {
    let writer = Writer::new();
    let ledger = writer.world.ledger();
    let stranger = World::new().org1.user("Salma", "member", KeyKind::Ed25519);
    let call = stranger.sign(&stranger.body(writer.world.network, "put", &["a", "1"]));
    assert_eq!(codes(&block(&ledger, NOW, &[&call])), [Code::Untrusted]);
    assert_eq!(ledger.transaction(&call.id()).unwrap(), None);
    assert_eq!(codes(&block(&ledger, NOW, &[&call])), [Code::Untrusted], "and not a duplicate");
}

#[test]
fn recent_writes_can_be_told() {
    let writer = Writer::new();
    let ledger = writer.world.ledger();
    let (_, ids) = writer.write(&ledger, 3);
    let writes = ledger.writes(3).unwrap();
    assert_eq!(writes.iter().map(|write| &write.key[..]).collect::<Vec<_>>(), [b"notes\0a"]);
    assert_eq!(writes[0].value, Some(Hash::of(&[b"x"])));
    assert!(ledger.writes(4).is_none() && ids.len() == 3);
}
