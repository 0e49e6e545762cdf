//! The world state is a cache: lost or damaged, it is made again from the blocks, to the same digest.

use crate::support::directory::copy;
use crate::support::network::{message, register_robots};
use crate::support::{Dice, Fleet, Process, connect, until};
use bytes::Bytes;
use ledger_api::{Client, Context};
use ledger_identity::Role;
use std::fs;
use std::path::{Path, PathBuf};

/// A stopped node with some history.
struct Stopped {
    fleet: Fleet,
    owner: Context,
    /// A height, and block hash and state digest there.
    height: u64,
    link: (Bytes, Bytes),
}

impl Stopped {
    async fn new() -> Self {
        let fleet = Fleet::found(1);
        let owner = fleet.owner();
        let salma = fleet.issue("Org1", "Salma", Role::Member, &["Turtlebot4", "Husky"]);
        let mut node = fleet.nodes[0].start();
        register_robots(&connect(&owner).await, "exclusive").await;
        let client = connect(&salma).await;
        client.invoke("abac", "acquire", vec!["Turtlebot4".into(), "600000".into()]).await.unwrap();
        for seq in 0..30 {
            client.invoke("abac", "set", message(1, seq, &[0; 200])).await.unwrap();
        }
        client.invoke("abac", "set", message(1, 3, &[])).await.unwrap_err();
        let height = client.status().await.unwrap().height;
        let link = link(&client, height).await;
        node.interrupt();
        Self { fleet, owner, height, link }
    }

    fn data(&self) -> &Path {
        &self.fleet.nodes[0].data
    }

    /// The node starts, and has what it had.
    async fn comes_back(&self, how: &str) -> Process {
        let mut node = self.fleet.nodes[0].start();
        let client = connect(&self.owner).await;
        node.check();
        assert_eq!(link(&client, self.height).await, self.link, "{how}");
        let robot = client.query_at(self.height, "abac", "robot", vec!["Turtlebot4".into()]).await.unwrap().response;
        assert!(String::from_utf8_lossy(&robot).contains("\"owner\":\"Org1/Salma\""), "{how}: {robot:?}");
        node.no_panic();
        node
    }

    /// The node does not start, and says why.
    fn refuses(&self, words: &[&str]) {
        let mut node = self.fleet.nodes[0].start();
        let status = node.wait();
        assert_eq!(status.code(), Some(1), "{}", node.stderr());
        for word in words {
            assert!(node.stderr().contains(word), "{word:?} is missing in:\n{}", node.stderr());
        }
        node.no_panic();
    }
}

/// Waits for the block: after a start, the last ones are executed when the node leads again.
async fn link(client: &Client, height: u64) -> (Bytes, Bytes) {
    let block = until("the block is there", || async { client.block(height).await.ok() }).await;
    (block.hash, block.state_digest)
}

fn files(directory: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in fs::read_dir(directory).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() { found.extend(files(&path)) } else { found.push(path) }
    }
    found.retain(|path| fs::metadata(path).unwrap().len() > 0);
    found.sort();
    found
}

#[tokio::test]
async fn a_damaged_index_of_the_audit_is_rebuilt_and_the_log_says_so_in_a_line() {
    let stopped = Stopped::new().await;
    // The second start has written a snapshot of its store.
    stopped.comes_back("undamaged").await.interrupt();
    let audit = stopped.data().join("audit");
    for file in ["conf", "snap", "db"] {
        let files = fs::read_dir(&audit).unwrap().map(|entry| entry.unwrap().path());
        let named = |path: &PathBuf| path.file_name().unwrap().to_string_lossy().starts_with(file);
        let path = files.into_iter().find(named).expect(file);
        let bytes = fs::read(&path).unwrap();
        fs::write(&path, vec![0xff; bytes.len()]).unwrap();
        let before = stopped.fleet.nodes[0].logged().len();
        stopped.comes_back(&format!("damaged {file}")).await.interrupt();
        stopped.comes_back("once more").await.interrupt();
        let log = stopped.fleet.nodes[0].logged().split_off(before);
        assert_eq!(log.matches("audit index damaged; rebuilding it from the blocks").count(), 1, "{file}: {log}");
        for words in ["backtrace", "panicked", "delete"] {
            assert!(!log.contains(words), "{file}: {words:?} in {log}");
        }
    }
}

#[tokio::test]
async fn a_deleted_state_is_rebuilt_to_the_same_digest() {
    let stopped = Stopped::new().await;
    fs::remove_dir_all(stopped.data().join("state")).unwrap();
    let mut node = stopped.comes_back("without a state").await;
    node.interrupt();
    println!("rebuild: 1 state deleted");
}

#[tokio::test]
async fn a_damaged_state_is_set_aside_and_rebuilt_to_the_same_digest() {
    let stopped = Stopped::new().await;
    let state = stopped.data().join("state");
    let kept = stopped.fleet.path().join("kept");
    copy(&state, &kept);
    let mut dice = Dice::roll("rebuild");
    let mut faults = 0;
    for path in files(&kept) {
        let name = path.strip_prefix(&kept).unwrap();
        for how in [
            "a byte changed at the start",
            "many bytes changed",
            "cut in half",
            "emptied",
            "filled with noise",
            "missing",
        ] {
            let _none = fs::remove_dir_all(&state);
            copy(&kept, &state);
            let damaged = state.join(name);
            let mut bytes = fs::read(&damaged).unwrap();
            match how {
                "a byte changed at the start" => bytes[0] ^= 0xff,
                "many bytes changed" => {
                    // Databases are sparse: change what is not zero.
                    let full: Vec<_> = (0..bytes.len()).filter(|at| bytes[*at] != 0).collect();
                    for _ in 0..1 + full.len() / 20 {
                        let at = full[dice.below(full.len() as u64) as usize];
                        bytes[at] ^= 1 << dice.below(8);
                    }
                }
                "cut in half" => bytes.truncate(bytes.len() / 2),
                "emptied" => bytes.clear(),
                "filled with noise" => bytes = dice.bytes(bytes.len()),
                _ => {}
            }
            match how {
                "missing" => fs::remove_file(&damaged).unwrap(),
                _ => fs::write(&damaged, bytes).unwrap(),
            }
            let mut node = stopped.comes_back(&format!("{}: {how}", name.display())).await;
            node.kill();
            faults += 1;
        }
    }
    println!("rebuild: {faults} damaged states");
    assert!(faults >= 6);
}

#[tokio::test]
async fn a_log_that_has_lost_blocks_which_the_state_has_seen_is_refused() {
    let stopped = Stopped::new().await;
    // The log of the same network from before anything was promised: as after restoring an old copy.
    for segment in stopped.fleet.nodes[0].segments() {
        fs::remove_file(segment).unwrap();
    }
    stopped.refuses(&["LGR-5004", "the log has lost committed blocks", "blocks up to height 0", "restore"]);
    assert!(stopped.data().join("state").is_dir(), "the state must stay as the witness");
    stopped.refuses(&["LGR-5004"]);
    println!("rebuild: 1 log lost");
}
