//! Users who publish through every fault and write down every acknowledgement.

use crate::cluster::{Cluster, NODES};
use crate::support::network::{message, now};
use crate::support::until;
use crate::support::wait::PATIENCE;
use futures::StreamExt;
use futures::stream::FuturesUnordered;
use ledger::transaction::Transaction;
use ledger_api::{Call, Client, Committed};
use ledger_base::rejection::Code;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;
use tokio::task::JoinHandle;
use tokio::time::{MissedTickBehavior, interval};

/// Transactions of one user that wait for their verdict.
const PIPELINE: usize = 32;
/// Between two transactions of one user: enough load to hit something, little enough to look up everything.
const PACE: Duration = Duration::from_millis(40);

/// A transaction and what its user was told.
pub struct Acknowledged {
    pub transaction: Transaction,
    pub committed: Committed,
    /// When the user was told, by the machine's clock in microseconds since the UNIX epoch.
    pub at: u64,
}

/// All that users were told.
#[derive(Default)]
pub struct Told {
    pub acknowledged: Vec<Acknowledged>,
    /// How many were refused or ended without an answer.
    pub refused: BTreeMap<Code, u64>,
}

/// Users at work.
pub struct Load {
    stop: Arc<AtomicBool>,
    count: Arc<AtomicU64>,
    users: Vec<JoinHandle<Told>>,
}

impl Load {
    /// Every person publishes, each beginning at another node.
    pub async fn start(cluster: &Cluster) -> Self {
        let (stop, count) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicU64::new(0)));
        let mut users = Vec::new();
        for (at, person) in cluster.people.iter().enumerate() {
            let client = cluster.client_from(person, at % NODES).await;
            users.push(tokio::spawn(publish(client, Arc::clone(&stop), Arc::clone(&count))));
        }
        Self { stop, count, users }
    }

    /// Waits for so many more acknowledgements; every node that should run must go on running meanwhile.
    pub async fn more(&self, what: &str, more: u64, cluster: &mut Cluster) {
        let enough = self.count.load(Ordering::Relaxed) + more;
        until(&format!("{what}: {more} more acknowledgements"), || {
            cluster.check();
            let reached = self.count.load(Ordering::Relaxed) >= enough;
            async move { reached.then_some(()) }
        })
        .await;
    }

    /// Ends the load; every transaction gets its verdict.
    pub async fn finish(self) -> Told {
        self.stop.store(true, Ordering::Relaxed);
        let mut all = Told::default();
        for user in self.users {
            let told =
                tokio::time::timeout(2 * PATIENCE, user).await.expect("every transaction gets an answer").unwrap();
            all.acknowledged.extend(told.acknowledged);
            for (code, count) in told.refused {
                *all.refused.entry(code).or_default() += count;
            }
        }
        all
    }
}

async fn publish(client: Client, stop: Arc<AtomicBool>, count: Arc<AtomicU64>) -> Told {
    let mut told = Told::default();
    let mut waiting = FuturesUnordered::new();
    let mut pace = interval(PACE);
    pace.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut seq = 0_u64;
    while !stop.load(Ordering::Relaxed) || !waiting.is_empty() {
        let answered = tokio::select! {
            _ = pace.tick(), if waiting.len() < PIPELINE && !stop.load(Ordering::Relaxed) => None,
            Some(answered) = waiting.next() => Some(answered),
        };
        match answered {
            None => {
                seq += 1;
                let args = message(0, seq, &seq.to_le_bytes());
                let call = Call { chaincode: "abac".into(), function: "set".into(), args, ttl: PATIENCE };
                let transaction = client.prepare(call).unwrap();
                let verdict = client.submit_nowait(&transaction);
                waiting.push(async move { (transaction, verdict.await) });
            }
            Some((transaction, Ok(committed))) => {
                count.fetch_add(1, Ordering::Relaxed);
                told.acknowledged.push(Acknowledged { transaction, committed, at: now() });
            }
            Some((_, Err(refused))) => *told.refused.entry(refused.code).or_default() += 1,
        }
    }
    told
}
