//! `kill -9` at any moment: nothing acknowledged is lost, nothing is executed twice.

use crate::support::ctl::verify;
use crate::support::network::{message, register_robots};
use crate::support::wait::PATIENCE;
use crate::support::{Dice, Fleet, connect, until};
use futures::StreamExt;
use futures::stream::FuturesUnordered;
use ledger::transaction::Transaction;
use ledger_api::{Call, Client, Committed, Context};
use ledger_base::hash::Hash;
use ledger_base::rejection::Code;
use ledger_identity::Role;
use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

/// Transactions of one user that wait for their verdict.
const PIPELINE: usize = 24;
/// Acknowledged transactions that are submitted again at the end, of each user.
const RESUBMITTED: usize = 40;

/// A user who publishes without a pause, through every restart, and writes down every acknowledgement.
struct User {
    client: Client,
    acknowledged: Vec<(Transaction, Committed)>,
    refused: BTreeMap<Code, u64>,
}

impl User {
    async fn publish(mut self, stop: Arc<AtomicBool>, count: Arc<AtomicU64>) -> Self {
        let mut waiting = FuturesUnordered::new();
        let mut seq = 0;
        while !stop.load(Ordering::Relaxed) || !waiting.is_empty() {
            while waiting.len() < PIPELINE && !stop.load(Ordering::Relaxed) {
                seq += 1;
                let call = Call {
                    chaincode: "abac".into(),
                    function: "set".into(),
                    args: message(0, seq, &seq.to_le_bytes()),
                    ttl: PATIENCE,
                };
                let transaction = self.client.prepare(call).unwrap();
                let verdict = self.client.submit_nowait(&transaction);
                waiting.push(async move { (transaction, verdict.await) });
            }
            let Some((transaction, verdict)) = waiting.next().await else { continue };
            match verdict {
                Ok(committed) => {
                    count.fetch_add(1, Ordering::Relaxed);
                    self.acknowledged.push((transaction, committed));
                }
                Err(refused) => *self.refused.entry(refused.code).or_default() += 1,
            }
        }
        self
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn nothing_acknowledged_is_lost_and_nothing_is_executed_twice() {
    let kills: u64 = std::env::var("LEDGERD_TEST_KILLS").map_or(25, |kills| kills.parse().expect("a number of kills"));
    let mut dice = Dice::roll("crash");
    let fleet = Fleet::found(1);
    let owner = fleet.owner();
    let people: Vec<Context> = ["Salma", "Farhad", "Nadia", "Omar"]
        .iter()
        .map(|name| fleet.issue("Org1", name, Role::Member, &["Turtlebot4"]))
        .collect();
    let place = &fleet.nodes[0];
    let mut node = place.start();
    let auditor = connect(&owner).await;
    register_robots(&auditor, "open").await;

    let (stop, count) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicU64::new(0)));
    let mut load = Vec::new();
    for person in &people {
        let user = User { client: connect(person).await, acknowledged: Vec::new(), refused: BTreeMap::new() };
        load.push(tokio::spawn(user.publish(Arc::clone(&stop), Arc::clone(&count))));
    }

    for round in 0..kills {
        // Some kills hit a node that is still starting.
        if dice.below(5) > 0 {
            let enough = count.load(Ordering::Relaxed) + 1 + dice.below(200);
            until(&format!("round {round}: {enough} acknowledgements"), || {
                node.check();
                let reached = count.load(Ordering::Relaxed) >= enough;
                async move { reached.then_some(()) }
            })
            .await;
        }
        // Not a wait for anything: the moment of the fault.
        tokio::time::sleep(Duration::from_micros(dice.below(30_000))).await;
        node.kill();
        node = place.start();
    }
    let enough = count.load(Ordering::Relaxed) + 100;
    until("the node goes on after the last kill", || {
        node.check();
        let reached = count.load(Ordering::Relaxed) >= enough;
        async move { reached.then_some(()) }
    })
    .await;
    stop.store(true, Ordering::Relaxed);
    let mut users = Vec::new();
    for task in load {
        users.push(tokio::time::timeout(PATIENCE, task).await.expect("every transaction gets its verdict").unwrap());
    }

    // Submitted again, an acknowledged transaction gets its first verdict.
    for user in &users {
        for (transaction, first) in user.acknowledged.iter().rev().take(RESUBMITTED) {
            assert_eq!(&user.client.submit(transaction.clone()).await.unwrap(), first);
        }
    }
    // Every acknowledged id is where its client was told, and nowhere else.
    let status = auditor.status().await.unwrap();
    let mut executed: HashMap<Hash, Vec<(u64, u32)>> = HashMap::new();
    for height in 1..=status.height {
        for record in auditor.block(height).await.unwrap().transactions {
            if record.verdict.unwrap().code == 0 {
                executed.entry(Hash::from_slice(&record.id).unwrap()).or_default().push((height, record.index));
            }
        }
    }
    let mut acknowledged = 0;
    for (transaction, committed) in users.iter().flat_map(|user| &user.acknowledged) {
        let places = executed.get(&transaction.id()).map(Vec::as_slice).unwrap_or_default();
        assert_eq!(places, [(committed.height, committed.index)], "places of {}", transaction.id());
        acknowledged += 1;
    }
    for (id, places) in &executed {
        assert_eq!(places.len(), 1, "{id} was executed more than once: {places:?}");
    }
    // A sample through the index of transactions too: it was rebuilt many times.
    for (transaction, committed) in users.iter().flat_map(|user| user.acknowledged.iter().step_by(17)) {
        let record = auditor.transaction(transaction.id()).await.unwrap();
        assert_eq!(
            (record.height, record.index, &record.response),
            (committed.height, committed.index, &committed.response)
        );
    }
    // What the node has after all this is what executing its blocks from the start gives.
    assert!(node.signal(rustix::process::Signal::TERM).success());
    node.no_panic();
    let report = verify(&place.data).ok().json();
    assert_eq!(report["ok"], true);
    let before = auditor_digest(&fleet, &owner, status.height).await;
    std::fs::remove_dir_all(place.data.join("state")).unwrap();
    assert_eq!(auditor_digest(&fleet, &owner, status.height).await, before);

    let refused: BTreeMap<_, u64> =
        users.iter().flat_map(|user| &user.refused).fold(BTreeMap::new(), |mut all, (code, n)| {
            *all.entry(code.to_string()).or_default() += n;
            all
        });
    println!(
        "crash: {kills} kills, {acknowledged} transactions acknowledged, {} executed, refused {refused:?}, height {}",
        executed.len(),
        status.height
    );
    assert!(acknowledged > kills, "hardly any load");
}

/// Starts the node; answers with its state digest at a height.
async fn auditor_digest(fleet: &Fleet, owner: &Context, height: u64) -> bytes::Bytes {
    let mut node = fleet.nodes[0].start();
    let client = connect(owner).await;
    // After a start, the last blocks are executed when the node leads again.
    let block = until("the block is there", || async { client.block(height).await.ok() }).await;
    let digest = block.state_digest;
    node.interrupt();
    digest
}
