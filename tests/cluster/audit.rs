//! The truth after every fault: all nodes have the same chain and the same state. In it every acknowledged transaction
//! is once, where its user was told.

use crate::cluster::{Cluster, NODES};
use crate::load::Told;
use crate::rounds;
use bytes::Bytes;
use futures::{StreamExt, TryStreamExt, stream};
use ledger_api::{Client, Committed};
use ledger_base::hash::Hash;
use std::collections::HashMap;

/// Questions to one node at a time.
const ASKED_AT_ONCE: usize = 32;
/// Acknowledged transactions that are looked up by their id on every node (all of them are looked for in its blocks), and
/// that are submitted again. Times the rounds.
const LOOKED_UP: usize = 300;
const RESUBMITTED: usize = 30;

/// The state of every node at one height.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Link {
    pub term: u64,
    pub hash: Bytes,
    pub digest: Bytes,
    /// Ids with the codes of their verdicts.
    pub transactions: Vec<(Hash, u32)>,
}

/// The chain of a network, equal on all its nodes.
pub struct Chain {
    /// Its blocks from height 1 on.
    pub links: Vec<Link>,
}

impl Chain {
    /// Term of the block at a height.
    pub fn term(&self, height: u64) -> u64 {
        self.links[height as usize - 1].term
    }
}

/// The blocks of a node.
pub async fn links(node: &Client, height: u64) -> Vec<Link> {
    let block = |height| async move {
        let block = node.block(height).await?;
        let transactions = block.transactions.iter().map(|record| {
            let id = Hash::from_slice(&record.id).unwrap();
            (id, record.verdict.as_ref().unwrap().code)
        });
        let transactions = transactions.collect();
        Ok::<_, ledger_base::rejection::Rejection>(Link {
            term: block.term,
            hash: block.hash,
            digest: block.state_digest,
            transactions,
        })
    };
    stream::iter(1..=height).map(block).buffered(ASKED_AT_ONCE).try_collect().await.unwrap()
}

/// Waits until all nodes are at the same height and compares everything.
pub async fn audit(cluster: &mut Cluster, told: &Told) -> Chain {
    cluster.check();
    let newest = told.acknowledged.iter().map(|told| told.committed.height).max().unwrap_or(0);
    let height = cluster.converge(newest).await;
    let chain = links(cluster.observer(0), height).await;
    for node in 1..NODES {
        let other = links(cluster.observer(node), height).await;
        for (at, (one, other)) in chain.iter().zip(&other).enumerate() {
            assert_eq!(one, other, "nodes 1 and {} differ at height {}", node + 1, at + 1);
        }
    }
    // None twice, and every acknowledged one where its user was told.
    let mut places: HashMap<Hash, (u64, u32)> = HashMap::new();
    for (height, link) in (1..).zip(&chain) {
        for (index, (id, code)) in (0..).zip(&link.transactions) {
            if *code == 0 {
                let before = places.insert(*id, (height, index));
                assert_eq!(before, None, "{id} was executed twice, again at {height}:{index}");
            }
        }
    }
    for told in &told.acknowledged {
        let place = places.get(&told.transaction.id()).copied();
        assert_eq!(place, Some((told.committed.height, told.committed.index)), "{}", told.transaction.id());
    }
    look_up(cluster, told).await;
    Chain { links: chain }
}

/// Acknowledged transactions by their id on every node; and some submitted again, which changes nothing.
async fn look_up(cluster: &Cluster, told: &Told) {
    for node in 0..NODES {
        let observer = cluster.observer(node);
        stream::iter(told.acknowledged.iter().rev().step_by(step(told, LOOKED_UP)))
            .for_each_concurrent(ASKED_AT_ONCE, |told| async move {
                let id = told.transaction.id();
                let record = observer.transaction(id).await.unwrap_or_else(|lost| panic!("node {}: {lost}", node + 1));
                let verdict = record.verdict.unwrap();
                let found = (record.height, record.index, verdict.code, record.response);
                let Committed { height, index, response, .. } = told.committed.clone();
                assert_eq!(found, (height, index, 0, response), "{id} on node {}", node + 1);
            })
            .await;
    }
    for (at, told) in told.acknowledged.iter().rev().step_by(step(told, RESUBMITTED)).enumerate() {
        let again = cluster.observer(at % NODES).submit(told.transaction.clone()).await.unwrap();
        assert_eq!(again, told.committed);
    }
}

/// Every how many of them are so many of all, times the rounds.
fn step(told: &Told, wanted: usize) -> usize {
    told.acknowledged.len().div_ceil(wanted * rounds() as usize).max(1)
}
