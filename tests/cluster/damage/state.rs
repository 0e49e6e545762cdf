//! A state store that rots. The blocks are the truth: whatever the store says or loses, the node comes to the state that
//! executing the blocks gives.

use super::History;
use crate::rounds;
use crate::support::Dice;
use crate::support::directory::copy;
use bytes::Bytes;
use ledger::Ledger;
use ledger_base::hash::Hash;
use ledger_storage::block_store::{BlockStore, Options};
use ledger_storage::disk::RealDisk;
use ledger_storage::layout::{BLOCKS_DIRECTORY, GENESIS_FILE, STATE_DIRECTORY};
use ledger_storage::results::ResultStore;
use ledger_storage::state::{MemoryState, State};
use ledgerd::Node;
use ledgerd::config::Config;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Unit in which disks rot.
const SECTOR_BYTES: usize = 512;
/// Sectors that are damaged, spread over all files of the store; times the rounds.
const SECTORS: u64 = 30;

/// Everything in the world state, and the digest that led there.
type World = (Hash, Vec<(Bytes, Bytes)>);

/// The results of executing the blocks of a directory, at every height.
fn worlds(data: &Path, scratch: &Path) -> BTreeMap<u64, World> {
    copy(&data.join(BLOCKS_DIRECTORY), scratch);
    let genesis = fs::read(data.join(GENESIS_FILE)).unwrap();
    let (_, network) = ledger::network::Genesis::from_bytes(&genesis).unwrap();
    let disk = Arc::new(RealDisk::open(scratch).unwrap());
    let (store, recovery) = BlockStore::open(disk, Options::new(network.0, || 1)).unwrap();
    let state = Arc::new(State::open(Box::new(MemoryState::default())).unwrap());
    let ledger = Ledger::open(
        &genesis,
        Node::builder().registry().unwrap(),
        Arc::clone(&state),
        Arc::new(ResultStore::in_memory()),
    )
    .unwrap();
    let mut worlds = BTreeMap::new();
    for entry in store.entries(1..recovery.last_index + 1, usize::MAX).unwrap() {
        ledger.apply(&entry).unwrap();
        worlds.insert(entry.index, (ledger.tip().digest, state.world(None, usize::MAX).unwrap()));
    }
    worlds
}

/// Files of a directory with something in them.
pub fn files(directory: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in fs::read_dir(directory).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            found.extend(files(&path));
        } else if fs::metadata(&path).unwrap().len() > 0 {
            found.push(path);
        }
    }
    found.sort();
    found
}

/// Sectors of a file in which something is written.
fn sectors(content: &[u8]) -> Vec<usize> {
    let written = content.chunks(SECTOR_BYTES).enumerate().filter(|(_, sector)| sector.iter().any(|byte| *byte != 0));
    written.map(|(at, _)| at * SECTOR_BYTES).collect()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_state_store_with_damage_in_any_sector_leads_to_the_state_that_the_blocks_give() {
    let mut dice = Dice::roll("damaged states");
    let history = History::killed(0).await;
    let place = &history.cluster.fleet.nodes[1];
    let worlds = worlds(&place.data, &history.cluster.fleet.path().join("executed"));
    for (height, (digest, _)) in &worlds {
        if let Some(link) = history.chain.links.get(*height as usize - 1) {
            assert_eq!(link.digest, digest.0.to_vec(), "height {height}");
        }
    }
    let mut config = Config::load(&place.config).unwrap();
    config.listen = "127.0.0.1:0".into();
    config.data = history.cluster.fleet.path().join("damaged");
    let names: Vec<_> = files(&place.data.join(STATE_DIRECTORY));
    let places: Vec<(PathBuf, usize)> = names
        .iter()
        .flat_map(|path| sectors(&fs::read(path).unwrap()).into_iter().map(|sector| (path.clone(), sector)))
        .collect();
    let step = (places.len() as u64).div_ceil(SECTORS * rounds()).max(1) as usize;
    let (mut faults, mut rebuilt) = (0, 0);
    for (path, sector) in places.iter().skip(dice.below(step as u64) as usize).step_by(step) {
        copy(&place.data, &config.data);
        let damaged = config.data.join(path.strip_prefix(&place.data).unwrap());
        let mut content = fs::read(&damaged).unwrap();
        let byte = sector + dice.below(SECTOR_BYTES.min(content.len() - sector) as u64) as usize;
        let end = content.len().min(sector + SECTOR_BYTES);
        // Rot, or a write that never came.
        let how = if faults % 3 == 2 { "zeroed" } else { "flipped" };
        match how {
            "zeroed" => content[*sector..end].fill(0),
            _ => content[byte] ^= 1 << dice.below(8),
        }
        fs::write(&damaged, content).unwrap();
        let what = format!("{} byte {byte} {how}", path.file_name().unwrap().to_string_lossy());
        let node = Node::builder().start(&config).await.unwrap_or_else(|refused| panic!("{what}: {refused}"));
        let ledger = Arc::clone(node.ledger());
        let tip = ledger.tip();
        let (digest, world) = &worlds[&tip.height];
        assert_eq!(tip.digest, *digest, "{what}: digest at height {}", tip.height);
        assert!(ledger.state().world(None, usize::MAX).unwrap() == *world, "{what}: the state at {}", tip.height);
        drop(ledger);
        node.stop().await;
        faults += 1;
        rebuilt += u64::from(config.data.join(STATE_DIRECTORY).with_extension("damaged").exists());
        fs::remove_dir_all(&config.data).unwrap();
    }
    println!(
        "faults injected: {faults} flipped bits and zeroed sectors in {} files of state stores ({} sectors in use), {rebuilt} made anew \
         from the blocks",
        names.len(),
        places.len()
    );
    assert!(faults > 0);
}
