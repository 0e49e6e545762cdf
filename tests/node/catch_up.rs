//! Nodes that were away: they fetch what they missed from others, verified, also if some have dropped it.

use crate::support::directory::copy;
use crate::support::network::{NodePlace, NodeWish, free_address, message, now, register_robots};
use crate::support::process::Process;
use crate::support::wait::eventually;
use crate::support::{Fleet, connect, until};
use futures::future::join_all;
use ledger::block::Payload;
use ledger_api::v1::StatusResponse;
use ledger_api::{Client, Context};
use ledger_identity::Role;
use ledger_storage::block_store::{BlockStore, Options};
use ledger_storage::disk::RealDisk;
use ledger_storage::entry::{Entry, EntryKind};
use ledger_storage::snapshot::Snapshot;
use ledger_storage::state::Tip;
use rustix::process::Signal;
use std::net::TcpListener;
use std::sync::Arc;

/// More blocks than a node leaves to replication.
const BLOCKS: u64 = 1300;
/// Users who publish at the same time.
const USERS: u64 = 4;

fn wish(name: &str, organisation: &str, voter: bool) -> NodeWish {
    NodeWish { name: name.into(), organisation: organisation.into(), voter, address: free_address() }
}

/// A voter of each organisation and a learner of Org1, with small segments.
fn found() -> (Fleet, Context, Vec<Context>) {
    found_every(ledger::network::SNAPSHOT_EVERY_DEFAULT)
}

fn found_every(snapshot_every: u64) -> (Fleet, Context, Vec<Context>) {
    let wishes = [wish("node1", "Org1", true), wish("node2", "Org2", true), wish("node3", "Org1", false)];
    let fleet = Fleet::found_every(&wishes, now(), snapshot_every);
    for place in &fleet.nodes {
        place.configure("[storage]\nsegment_mib = 2");
    }
    let owner = fleet.owner();
    let person = |number| fleet.issue("Org1", &format!("User{number}"), Role::Member, &["Turtlebot4"]);
    let users = (0..USERS).map(person).collect();
    (fleet, owner, users)
}

async fn at(fleet: &Fleet, person: &Context, node: usize) -> Client {
    connect(&Context { nodes: vec![fleet.nodes[node].address.clone()], ..person.clone() }).await
}

/// Publishes until there are so many more blocks; answers with the height.
async fn blocks(fleet: &Fleet, users: &[Context], node: usize, more: u64) -> u64 {
    let clients = join_all(users.iter().map(|user| at(fleet, user, node))).await;
    let begun = clients[0].status().await.unwrap().height;
    let publish = clients.iter().map(|client| async move {
        let mut height = begun;
        let mut seq = begun * 10;
        while height < begun + more {
            seq += 1;
            // About a kilobyte each, so that segments fill.
            height = client.invoke("abac", "set", message(0, seq, &[7; 1000])).await.unwrap().height;
        }
        height
    });
    join_all(publish).await.into_iter().max().unwrap()
}

/// The nodes agree at a height of at least this.
async fn agree(one: &Client, other: &Client, height: u64) -> StatusResponse {
    until("both nodes are at the same height", || async {
        let (one, other) = (one.status().await.ok()?, other.status().await.ok()?);
        if one.height != other.height || one.height < height {
            return None;
        }
        assert_eq!(one.block_hash, other.block_hash, "height {}", one.height);
        assert_eq!(one.state_digest, other.state_digest, "height {}", one.height);
        Some(one)
    })
    .await
}

fn said(process: &Process, text: &str) -> usize {
    process.stderr().matches(text).count()
}

/// The log of a stopped node.
fn log(place: &NodePlace) -> BlockStore {
    let genesis = std::fs::read(place.data.join("genesis.json")).unwrap();
    let (_, network) = ledger::network::Genesis::from_bytes(&genesis).unwrap();
    let mut salt = now();
    let mut options = Options::new(network.0, move || {
        salt += 1;
        salt
    });
    options.segment_bytes = 2 << 20;
    BlockStore::open(Arc::new(RealDisk::open(place.data.join("blocks")).unwrap()), options).unwrap().0
}

/// Rewrites the chain of a stopped node: one block says something else, and there is one more at the end.
fn forge(place: &NodePlace) {
    let store = log(place);
    let last = store.last_index();
    let mut entries = store.entries(1..last + 1, usize::MAX).unwrap();
    let mut hard_state = store.hard_state();
    drop(store);
    let forged = entries.iter_mut().rev().find(|entry| entry.kind == EntryKind::Normal && !entry.data.is_empty());
    let forged = forged.unwrap();
    let mut payload = Payload::from_bytes(forged.data.clone()).unwrap();
    payload.time += 1;
    forged.data = payload.to_bytes();
    let more = Entry { index: last + 1, ..forged.clone() };
    entries.push(Entry { term: entries.last().unwrap().term, ..more });
    hard_state.commit = last + 1;
    for directory in ["blocks", "state"] {
        std::fs::remove_dir_all(place.data.join(directory)).unwrap();
    }
    let store = log(place);
    store.append(&entries, Some(&hard_state)).unwrap();
    store.flush().unwrap();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_voter_that_hears_a_majority_does_not_wait_for_a_silent_node() {
    let (fleet, owner, users) = found();
    // The system takes connections to the learner, and nobody answers.
    let _silent = TcpListener::bind(&fleet.nodes[2].address).unwrap();
    let (mut one, _other) = (fleet.nodes[0].start(), fleet.nodes[1].start());
    register_robots(&at(&fleet, &owner, 0).await, "open").await;
    one.interrupt();
    one = fleet.nodes[0].start();
    eventually("it orders before the learner has said anything", || {
        (said(&one, "starting without the answer of unreachable nodes") > 0).then_some(())
    });
    let height = blocks(&fleet, &users, 0, 3).await;
    agree(&at(&fleet, &owner, 0).await, &at(&fleet, &owner, 1).await, height).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_learner_that_was_away_fetches_blocks_and_goes_on_after_a_kill() {
    let (fleet, owner, users) = found();
    let mut voters = [fleet.nodes[0].start(), fleet.nodes[1].start()];
    register_robots(&at(&fleet, &owner, 0).await, "open").await;
    // It was never there.
    let height = blocks(&fleet, &users, 0, BLOCKS).await;
    let mut learner = fleet.nodes[2].start();
    eventually("the learner fetches blocks", || (said(&learner, "fetching blocks") > 0).then_some(()));
    learner.kill();
    learner = fleet.nodes[2].start();
    let (leader, follower) = (at(&fleet, &owner, 0).await, at(&fleet, &owner, 2).await);
    agree(&leader, &follower, height).await;

    // It was away for a while, and the node of its organisation has dropped what it needs: the other one has it still,
    // and the first confirms it.
    learner.interrupt();
    let height = blocks(&fleet, &users, 0, BLOCKS).await;
    voters[0].interrupt();
    let first = log(&fleet.nodes[0]).prune(height - 100).unwrap();
    assert!(first > 100, "something was dropped: the log begins at {first}");
    voters[0] = fleet.nodes[0].start();
    drop(at(&fleet, &owner, 0).await);
    learner = fleet.nodes[2].start();
    agree(&leader, &follower, height).await;
    until("the learner has caught up", || async { (follower.status().await.ok()?.catching_up_to == 0).then_some(()) })
        .await;
    let after = blocks(&fleet, &users, 2, 10).await;
    agree(&leader, &follower, after).await;

    // It slept while its leader went on and dropped what it needs: the running engine is told, and ends for another.
    learner.send(Signal::STOP);
    let height = blocks(&fleet, &users, 0, BLOCKS).await;
    voters[0].interrupt();
    log(&fleet.nodes[0]).prune(height - 100).unwrap();
    voters[0] = fleet.nodes[0].start();
    until("the node that has dropped blocks leads", || async {
        (leader.transfer_leadership(1).await.ok()?.leader == 1).then_some(())
    })
    .await;
    learner.send(Signal::CONT);
    agree(&leader, &follower, height).await;
    let after = blocks(&fleet, &users, 2, 10).await;
    agree(&leader, &follower, after).await;
    for process in voters.iter_mut().chain([&mut learner]) {
        process.check();
        process.interrupt();
    }
    // The first time it may have had all blocks when it was killed, without the time to say so.
    println!("catch_up: {} blocks, fetched {} times", after, said(&learner, "fetching blocks"));
    assert!(said(&learner, "fetching blocks") >= 3 && said(&learner, "up to date") >= 2, "{}", learner.stderr());
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_voter_that_has_lost_its_blocks_does_not_vote_any_more() {
    let (fleet, owner, users) = found();
    let mut voters = [fleet.nodes[0].start(), fleet.nodes[1].start()];
    register_robots(&at(&fleet, &owner, 0).await, "open").await;
    blocks(&fleet, &users, 0, 20).await;
    // A leader knows what it has acknowledged.
    let leader = at(&fleet, &owner, 0).await;
    until("the first node leads", || async {
        let leading = leader.transfer_leadership(1).await.ok()?.leader;
        let caught_up = leader.status().await.ok()?.peers.iter().any(|peer| peer.node_id == 2 && peer.matched > 20);
        (leading == 1 && caught_up).then_some(())
    })
    .await;
    // Where the leader steps down meanwhile, its next term knows by what it has asked the voter.
    let kept = fleet.nodes[0].data.join("confirmed.json");
    until("the leader keeps what the voter has confirmed", || async {
        let kept: serde_json::Value = serde_json::from_slice(&std::fs::read(&kept).ok()?).ok()?;
        (kept["2"]["height"].as_u64()? > 20).then_some(())
    })
    .await;
    voters[1].kill();
    for directory in ["blocks", "state"] {
        std::fs::remove_dir_all(fleet.nodes[1].data.join(directory)).unwrap();
    }
    let mut lost = fleet.nodes[1].start();
    let status = lost.wait();
    assert!(!status.success());
    let log = lost.stderr();
    assert!(log.contains("LGR-5003") && log.contains("ledgerd rejoin --config "), "{log}");
    voters[0].check();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn blocks_of_another_organisation_are_taken_only_if_a_second_one_has_them_too() {
    let (fleet, owner, users) = found();
    let mut voters = [fleet.nodes[0].start(), fleet.nodes[1].start()];
    register_robots(&at(&fleet, &owner, 0).await, "open").await;
    let height = blocks(&fleet, &users, 0, BLOCKS).await;
    let (one, other) = (at(&fleet, &owner, 0).await, at(&fleet, &owner, 1).await);
    agree(&one, &other, height).await;
    drop((one, other));
    // The forged chain is asked for first only if it is the longest; a leader whose hand-over fails keeps a longer one.
    loop {
        voters.iter_mut().for_each(Process::interrupt);
        if log(&fleet.nodes[0]).last_index() <= log(&fleet.nodes[1]).last_index() {
            break;
        }
        voters = [fleet.nodes[0].start(), fleet.nodes[1].start()];
        let (one, other) = (at(&fleet, &owner, 0).await, at(&fleet, &owner, 1).await);
        let height = one.status().await.unwrap().height;
        agree(&one, &other, height).await;
    }
    // The node of the other organisation has rewritten its chain.
    forge(&fleet.nodes[1]);
    voters[1] = fleet.nodes[1].start();
    drop(at(&fleet, &owner, 1).await);
    let mut learner = fleet.nodes[2].start();
    let refusal = "no other nodes confirm the blocks of this peer";
    eventually("nobody confirms it", || (said(&learner, refusal) > 0).then_some(()));
    assert_eq!(at(&fleet, &owner, 2).await.status().await.unwrap().height, 0);
    learner.interrupt();

    // Now somebody could, and does not. Nobody leads before the learner has asked: a leader would mend the forged chain.
    voters[1].interrupt();
    for place in &fleet.nodes[..2] {
        place.configure("[order]\nelection_ticks = 100");
    }
    let copies: Vec<_> = fleet.nodes.iter().map(Copy::of).collect();
    let mut tries = 0;
    let log = loop {
        let voters = [fleet.nodes[0].start(), fleet.nodes[1].start()];
        drop(at(&fleet, &owner, 1).await);
        drop(at(&fleet, &owner, 0).await);
        let before = fleet.nodes[2].logged().len();
        learner = fleet.nodes[2].start();
        let (one, follower) = (at(&fleet, &owner, 0).await, at(&fleet, &owner, 2).await);
        // The true chain has no majority to grow: the voter that has it appends nothing of a leader with another one.
        agree(&one, &follower, 1).await;
        let log = learner.stderr().split_off(before);
        if log.contains("fetching blocks node=\"Org2/node2\"") {
            break log;
        }
        // On a busy machine the forger's answer came too late to be asked at all.
        tries += 1;
        assert!(tries < 20, "the forged chain is never asked for: {log}");
        drop((voters, learner));
        copies.iter().for_each(Copy::put_back);
    };
    assert!(log.contains("Org1/node1 has another block at height"), "{log}");
    assert_eq!(log.matches("up to date").count(), 1, "{log}");
}

/// A copy of what a stopped node has stored.
struct Copy<'a> {
    place: &'a NodePlace,
    kept: tempfile::TempDir,
}

impl<'a> Copy<'a> {
    fn of(place: &'a NodePlace) -> Self {
        let kept = tempfile::tempdir().unwrap();
        copy(&place.data, kept.path());
        Self { place, kept }
    }

    /// The node, which must not run, has stored again what it had stored then.
    fn put_back(&self) {
        std::fs::remove_dir_all(&self.place.data).unwrap();
        std::fs::create_dir(&self.place.data).unwrap();
        copy(self.kept.path(), &self.place.data);
    }
}

/// The newest snapshot of a node: height, block hash, state digest, content.
fn snapshot(place: &NodePlace) -> Option<(u64, String)> {
    let files = std::fs::read_dir(place.data.join("snapshots")).ok()?;
    let files = files.filter_map(|entry| entry.ok().map(|entry| entry.path()));
    let newest = files.filter(|path| path.extension().is_some_and(|extension| extension == "snap")).max()?;
    let snapshot = Snapshot::open(&newest).ok()?;
    let Tip { height, hash, digest, .. } = snapshot.manifest().tip.clone();
    let content = snapshot.content();
    Some((height, format!(r#"{{"height":{height},"hash":"{hash}","digest":"{digest}","content":"{content}"}}"#)))
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_newcomer_takes_a_snapshot_that_two_organisations_attest_when_the_blocks_are_gone() {
    // At most one in 1.2 s of block time.
    const EVERY: u64 = 100;
    let (fleet, owner, users) = found_every(EVERY);
    let mut voters = [fleet.nodes[0].start(), fleet.nodes[1].start()];
    register_robots(&at(&fleet, &owner, 0).await, "open").await;
    let enough = blocks(&fleet, &users, 0, 2 * BLOCKS).await;
    let mut height = enough;
    while snapshot(&fleet.nodes[0]).is_none_or(|(made, _)| made < enough) {
        assert!(height < 100 * BLOCKS, "no snapshot: storing");
        height = blocks(&fleet, &users, 0, EVERY).await;
    }
    agree(&at(&fleet, &owner, 0).await, &at(&fleet, &owner, 1).await, height).await;
    voters.iter_mut().for_each(Process::interrupt);
    let [(due, one), other] = [0, 1].map(|node| snapshot(&fleet.nodes[node]).unwrap());
    assert_eq!((due, one), other, "every node makes the same");
    for (voter, place) in voters.iter_mut().zip(&fleet.nodes) {
        let first = log(place).prune(due).unwrap();
        assert!(first > 1, "something was dropped: the log begins at {first}");
        *voter = place.start();
    }
    let leader = at(&fleet, &owner, 0).await;
    let mut learner = fleet.nodes[2].start();
    // Until nodes of both organisations have attested it, it is not believed.
    let newcomer = at(&fleet, &owner, 2).await;
    let status = agree(&leader, &newcomer, height).await;
    let status = (status.height, newcomer.status().await.unwrap().first_height);
    assert_eq!(status.1, due + 1, "it begins after the snapshot");
    // What was executed before the snapshot is not executed again after it, and the chain goes on.
    let after = blocks(&fleet, &users, 2, 10).await;
    agree(&leader, &newcomer, after).await;
    for process in voters.iter_mut().chain([&mut learner]) {
        process.check();
        process.interrupt();
    }
}
