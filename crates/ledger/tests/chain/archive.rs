//! Archives and directories without their oldest blocks, verified.

use super::world::*;
use ledger::Registry;
use ledger::network::Genesis;
use ledger::verify::{Reached, Report, verify_directory};
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::key::KeyKind;
use ledger_storage::archive::{Extent, archive};
use ledger_storage::block_store::{BlockStore, Options};
use ledger_storage::disk::RealDisk;
use ledger_storage::entry::HardState;
use ledger_storage::layout::{BLOCKS_DIRECTORY, GENESIS_FILE};
use std::fs;
use std::path::Path;
use std::sync::Arc;

/// A node's data directory with `blocks` blocks of one transaction each.
fn node(world: &World, data: &Path, blocks: u64) -> BlockStore {
    fs::create_dir_all(data).unwrap();
    fs::write(data.join(GENESIS_FILE), &world.genesis).unwrap();
    let mut salt = 0;
    let mut options = Options::new(world.network.0, move || {
        salt += 1;
        salt
    });
    options.segment_bytes = 8 << 10;
    let disk = Arc::new(RealDisk::open(data.join(BLOCKS_DIRECTORY)).unwrap());
    let (store, _) = BlockStore::open(disk, options).unwrap();
    let (ledger, salma) = (world.ledger(), world.org1.user("Salma", "client", KeyKind::Ed25519));
    for height in 1..=blocks {
        let body = salma.body(world.network, "put", &["key", &height.to_string()]);
        let entry = entry(&ledger, NOW + height, &[&salma.sign(&body)]);
        ledger.apply(&entry).unwrap();
        store.append(&[entry], Some(&HardState { term: 1, vote: 1, commit: height - 1 })).unwrap();
        store.flush().unwrap();
    }
    store.set_committed(blocks);
    store
}

fn registry() -> Registry {
    let mut registry = Registry::new();
    registry.install(Arc::new(Notes)).unwrap();
    registry
}

/// Verifies a directory. The figures that it tells meanwhile only grow, and never say more than there is.
fn verify(directory: &Path) -> Result<Report, Rejection> {
    let mut told = vec![Reached::default()];
    let report = verify_directory(directory, &registry(), None, &mut |reached| told.push(reached))?;
    for (before, after) in told.iter().zip(told.iter().skip(1)) {
        assert!(before.height <= after.height && before.transactions <= after.transactions, "{told:?}");
        assert!(before.bytes < after.bytes && after.bytes <= after.of_bytes, "{told:?}");
    }
    let last = told.last().copied().unwrap_or_default();
    assert_eq!((last.height, last.transactions), (report.height, report.transactions));
    Ok(report)
}

#[test]
fn an_archive_verifies_alone_and_goes_on_when_the_node_has_dropped_what_it_holds() {
    let root = tempfile::tempdir().unwrap();
    let (data, to) = (root.path().join("data"), root.path().join("archive"));
    let world = World::new();
    let store = node(&world, &data, 100);
    let archived = archive((&data, &to), Extent::Finished, &Genesis::network_of, &mut |_| ()).unwrap();
    assert!(archived.last_height > 70 && archived.last_height < 100);
    assert_eq!(store.prune(archived.last_height + 1).unwrap(), archived.last_height + 1);
    let report = verify(&to).unwrap();
    assert_eq!((report.network, report.first_height, report.begun), (world.network, 1, None));
    // Whether its last block was committed is told by the next segment.
    assert_eq!(report.height + report.uncommitted, archived.last_height);
    assert_eq!((report.transactions, report.verdicts.get("OK")), (report.height, Some(&report.height)));
    assert_eq!(archive((&data, &to), Extent::Finished, &Genesis::network_of, &mut |_| ()).unwrap().segments_copied, 0);
    // What the node has left cannot be executed without the state before it.
    drop(store);
    let refused = verify(&data).unwrap_err();
    assert_eq!(refused.code, Code::BadFile);
    assert!(refused.message.contains(&(archived.last_height + 1).to_string()), "{refused}");
}

#[test]
fn a_byte_changed_in_an_archive_is_found_and_its_file_named() {
    let root = tempfile::tempdir().unwrap();
    let (data, to) = (root.path().join("data"), root.path().join("archive"));
    drop(node(&World::new(), &data, 60));
    archive((&data, &to), Extent::Finished, &Genesis::network_of, &mut |_| ()).unwrap();
    let name = "0000000002-";
    let mut files = fs::read_dir(to.join(BLOCKS_DIRECTORY)).unwrap().map(|item| item.unwrap().path());
    let file = files.find(|path| path.file_name().unwrap().to_string_lossy().starts_with(name)).unwrap();
    let right = fs::read(&file).unwrap();
    for at in (0..right.len()).step_by(401) {
        let mut wrong = right.clone();
        *wrong.get_mut(at).unwrap() ^= 0x10;
        fs::write(&file, wrong).unwrap();
        let refused = verify(&to).unwrap_err();
        assert!(refused.message.contains(name) && refused.message.contains("byte"), "byte {at}: {refused}");
    }
    fs::remove_file(&file).unwrap();
    assert_eq!(verify(&to).unwrap_err().code, Code::Corrupt, "a gap");
}

#[test]
fn an_archive_of_all_committed_blocks_verifies_up_to_the_last_of_them() {
    let root = tempfile::tempdir().unwrap();
    let (data, to) = (root.path().join("data"), root.path().join("archive"));
    let world = World::new();
    let store = node(&world, &data, 3);
    let archived = archive((&data, &to), Extent::Committed, &Genesis::network_of, &mut |_| ()).unwrap();
    // A block's commit is written with the next block, and proven by the one after that.
    assert_eq!((archived.first_height, archived.last_height, archived.blocks), (1, 1, 1));
    let report = verify(&to).unwrap();
    assert_eq!((report.first_height, report.height, report.uncommitted, report.torn_bytes), (1, 1, 0, 0));
    drop(store);
    fs::remove_dir_all(&data).unwrap();
    // Another network.
    drop(node(&World::new(), &data, 60));
    assert_eq!(
        archive((&data, &to), Extent::Committed, &Genesis::network_of, &mut |_| ()).unwrap_err().code,
        Code::BadFile
    );
    let to = root.path().join("another");
    let archived = archive((&data, &to), Extent::Committed, &Genesis::network_of, &mut |_| ()).unwrap();
    let report = verify(&to).unwrap();
    assert_eq!((archived.last_height, report.height, report.uncommitted), (58, 58, 0));
}
