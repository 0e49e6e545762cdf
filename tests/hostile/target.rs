//! The node that is attacked, and its people.

use crate::support::network::{message, now, register_robots};
use crate::support::{Fleet, Process, connect};
use bytes::Bytes;
use ledger::transaction::{Body, NONCE_BYTES, Transaction};
use ledger_api::{Client, Context};
use ledger_base::hash::Hash;
use ledger_identity::Role;
use ring::rand::{SecureRandom, SystemRandom};

/// A running node with the paper's people.
pub(crate) struct Target {
    pub(crate) fleet: Fleet,
    pub(crate) node: Process,
    pub(crate) admin: Context,
    pub(crate) salma: Context,
    /// Asks after every fault whether the node is still there.
    pub(crate) client: Client,
    pub(crate) faults: u64,
}

impl Target {
    pub(crate) async fn start() -> Self {
        Self::start_on(Fleet::found(1)).await
    }

    pub(crate) async fn start_on(fleet: Fleet) -> Self {
        let owner = fleet.owner();
        let admin = fleet.issue("Org1", "Boss", Role::Admin, &[]);
        let salma = fleet.issue("Org1", "Salma", Role::Member, &["Turtlebot4", "Husky"]);
        let node = fleet.nodes[0].start();
        register_robots(&connect(&owner).await, "exclusive").await;
        let client = connect(&salma).await;
        client.invoke("abac", "acquire", vec!["Turtlebot4".into(), "600000".into()]).await.unwrap();
        Self { fleet, node, admin, salma, client, faults: 0 }
    }

    /// The fault was survived: the node answers, and orders.
    pub(crate) async fn survived(&mut self, what: &str) {
        self.faults += 1;
        self.node.check();
        let seq = 1_000_000 + self.faults;
        self.client
            .invoke("abac", "set", message(1, seq, &[]))
            .await
            .unwrap_or_else(|error| panic!("after {what}: {error}"));
        self.node.no_panic();
    }

    /// The signed transaction of a body that was changed first.
    pub(crate) fn signed(&self, change: impl FnOnce(&mut Body)) -> Transaction {
        let mut body = self.body();
        change(&mut body);
        Transaction::sign(&body, &self.salma.key).unwrap()
    }

    pub(crate) fn body(&self) -> Body {
        let mut nonce = [0; NONCE_BYTES];
        SystemRandom::new().fill(&mut nonce).unwrap();
        Body {
            network: Bytes::copy_from_slice(&self.salma.network.0),
            creator: Bytes::copy_from_slice(Hash::of(&[&self.salma.chain[0]]).as_ref()),
            nonce: Bytes::copy_from_slice(&nonce),
            not_after: now() + 30_000_000,
            chaincode: "abac".into(),
            function: "robots".into(),
            args: Vec::new(),
            known_block: None,
        }
    }

    /// Ends the node in order; it must not have panicked.
    pub(crate) fn end(mut self, test: &str) {
        println!("hostile: {test}: {} faults", self.faults);
        self.node.interrupt();
    }
}
