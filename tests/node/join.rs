//! `ledgerd join`: a token from an admin, one command, and the node belongs to the network.

use crate::support::network::{free_address, some_block};
use crate::support::{Fleet, Process, connect, programs, until};
use bytes::Bytes;
use ledger::msp::InviteOrganisation;
use ledger_api::token::{JoinKind, JoinToken};
use ledger_api::{Client, Context, Enrolment};
use ledger_base::hash::Hash;
use ledger_base::rejection::Code;
use ledger_identity::Role;
use ledger_identity::key::{KeyKind, SigningKey};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// A machine on which a node joins.
pub struct Newcomer {
    pub directory: PathBuf,
    pub address: String,
}

/// The output of one run of `ledgerd join`.
pub struct Ran {
    ok: bool,
    stdout: String,
    stderr: String,
}

impl Newcomer {
    pub fn new(fleet: &Fleet, name: &str) -> Self {
        Self { directory: fleet.path().join(name), address: free_address() }
    }

    fn config(&self) -> PathBuf {
        self.directory.join("ledgerd.toml")
    }

    pub fn data(&self) -> PathBuf {
        self.directory.join("data")
    }

    pub fn join(&self, token: &str) -> Ran {
        let mut command = programs::node();
        // No argument has the secret in the token.
        let file = self.directory.with_extension("token");
        std::fs::write(&file, token).unwrap();
        let token = format!("@{}", file.display());
        command.args(["join", &token, "--address", &self.address, "--config"]).arg(self.config());
        let done = command.output().unwrap();
        let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
        Ran { ok: done.status.success(), stdout: text(&done.stdout), stderr: text(&done.stderr) }
    }

    pub fn run(&self, name: &str, fleet: &Fleet) -> Process {
        let mut command = programs::node();
        command.args(["run", "--config"]).arg(self.config());
        Process::start(name, fleet.path(), command)
    }

    /// The remains of a try that was interrupted: everything but these files.
    fn interrupt(&self, lost: &[&str]) {
        let staged = self.staged();
        std::fs::rename(self.data(), &staged).unwrap();
        // There was no such node before.
        std::fs::write(staged.join("before"), "0").unwrap();
        for file in lost {
            std::fs::remove_file(staged.join(file)).unwrap();
        }
    }

    /// Where the node is prepared: the name is told by the first try that fails.
    fn staged(&self) -> PathBuf {
        let name = std::fs::read_to_string(self.directory.join("staged")).unwrap();
        self.directory.join(name)
    }

    /// Remembers that name, from a try that cannot come far.
    fn remember_staged(&self) {
        let entries = std::fs::read_dir(&self.directory).unwrap().map(|entry| entry.unwrap().file_name());
        let staged = entries.map(|name| name.into_string().unwrap()).find(|name| name.contains(".joining-")).unwrap();
        std::fs::write(self.directory.join("staged"), staged).unwrap();
    }
}

impl Ran {
    #[track_caller]
    pub fn ok(self) -> String {
        assert!(self.ok, "{}", self.stderr);
        self.stdout
    }

    #[track_caller]
    pub fn refused(self, words: &[&str]) {
        assert!(!self.ok, "{}", self.stdout);
        for word in words {
            assert!(self.stderr.contains(word), "{word:?} is missing in: {}", self.stderr);
        }
    }
}

/// A token of this fleet for a node of an organisation.
pub async fn token(fleet: &Fleet, admin: &Client, organisation: &str, node: &str) -> JoinToken {
    let secret = admin.register(node, Role::Node, &BTreeMap::new()).await.unwrap().secret;
    let authority = &fleet.founded.authorities[0];
    JoinToken {
        network: fleet.founded.network,
        addresses: vec![fleet.nodes[0].address.clone()],
        ca: authority.fingerprint,
        organisation: organisation.into(),
        node: node.into(),
        kind: JoinKind::Node,
        secret,
    }
}

pub fn id(data: &Path) -> u64 {
    let joined: serde_json::Value = serde_json::from_slice(&std::fs::read(data.join("node.json")).unwrap()).unwrap();
    joined["id"].as_u64().unwrap()
}

/// The node follows what its network does, as somebody sees who trusts its organisation.
pub async fn follows(somebody: &Context, leader: &Client, newcomer: &Newcomer) {
    let there = connect(&Context { nodes: vec![newcomer.address.clone()], ..somebody.clone() }).await;
    let height = some_block(leader).await;
    // The members still change meanwhile: two states are compared where both nodes are at one height.
    let (here, at_leader) = until("the new node follows", || async {
        let (here, at_leader) = (there.status().await.unwrap(), leader.status().await.unwrap());
        let level = here.height >= height && here.height == at_leader.height;
        (level && here.role == "learner").then_some((here, at_leader))
    })
    .await;
    assert_eq!(here.state_digest, at_leader.state_digest);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_node_of_an_organisation_joins_and_a_join_that_was_interrupted_is_finished_by_the_same_command() {
    let fleet = Fleet::found(1);
    let admin = fleet.issue("Org1", "Admin", Role::Admin, &[]);
    let _node = fleet.nodes[0].start();
    let leader = connect(&admin).await;
    let token = token(&fleet, &leader, "Org1", "node2").await;
    let newcomer = Newcomer::new(&fleet, "second");

    let nowhere = JoinToken { addresses: vec![free_address()], ..token.clone() };
    std::fs::create_dir(&newcomer.directory).unwrap();
    newcomer.join(&nowhere.to_string()).refused(&["cannot reach a node at"]);
    newcomer.remember_staged();

    let said = newcomer.join(&token.to_string()).ok();
    for word in ["node Org1/node2 has joined network \"test\" as node 2", "ledgerd run --config"] {
        assert!(said.contains(word), "{word:?} is missing in: {said}");
    }
    // Typed again, it says the same.
    assert_eq!(newcomer.join(&token.to_string()).ok(), said);
    // Interrupted after the certificate, and before the end. Before the certificate, the same key receives the same one
    // (see ca.rs); once it has signed something, as it did here, the secret is void.
    for lost in [&["genesis.json", "node.json"][..], &["node.json"], &[]] {
        newcomer.interrupt(lost);
        assert_eq!(newcomer.join(&token.to_string()).ok(), said, "without {lost:?}");
        assert_eq!(id(&newcomer.data()), 2);
    }
    // A disk that was lost is another matter: that node comes back under a new number.
    newcomer.interrupt(&["before", "node.json"]);
    newcomer.join(&token.to_string()).ok();
    assert_eq!(id(&newcomer.data()), 3);
    let mut second = newcomer.run("node2", &fleet);
    follows(&admin, &leader, &newcomer).await;
    second.interrupt();
    second = newcomer.run("node2", &fleet);
    follows(&admin, &leader, &newcomer).await;
    second.check();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_invited_organisation_joins_with_its_own_ca_and_its_admin_enrols() {
    let fleet = Fleet::found(1);
    let (admin, owner) = (fleet.issue("Org1", "Admin", Role::Admin, &[]), fleet.owner());
    let _node = fleet.nodes[0].start();
    let leader = connect(&admin).await;
    let seed = [7; 32];
    let token = JoinToken {
        network: fleet.founded.network,
        addresses: vec![fleet.nodes[0].address.clone()],
        ca: fleet.founded.authorities[0].fingerprint,
        organisation: "Org3".into(),
        node: "node3".into(),
        kind: JoinKind::Organisation,
        secret: hex::encode(seed),
    };
    let newcomer = Newcomer::new(&fleet, "third");
    newcomer.join(&token.to_string()).refused(&["may not join", "ledgerctl network proposals"]);

    let key = SigningKey::from_seed(&seed).unwrap();
    assert_eq!(key.kind(), KeyKind::Ed25519);
    let invite = InviteOrganisation {
        name: "Org3".into(),
        key: Hash::from_slice(key.public_key().bytes()).unwrap(),
        expires: crate::support::network::now() + 3_600_000_000,
    };
    let invite = Bytes::from(serde_json::to_vec(&invite).unwrap());
    let proposed = leader.invoke("msp", "invite_organisation", vec![invite]).await.unwrap();
    newcomer.join(&token.to_string()).refused(&["no approved invitation"]);
    let proposal: serde_json::Value = serde_json::from_slice(&proposed.response).unwrap();
    let proposal = proposal["proposal"]["id"].as_str().or(proposal["id"].as_str()).unwrap().to_owned();
    connect(&owner).await.invoke("msp", "approve", vec![proposal.into()]).await.unwrap();

    let said = newcomer.join(&token.to_string()).ok();
    assert!(said.contains("node Org3/node3 has joined") && said.contains("admin    Org3/admin"), "{said}");
    // Until the admin has enrolled, the command tells a new secret when it is typed again.
    let said = newcomer.join(&token.to_string()).ok();
    let word = |after: &str| said.split_once(after).unwrap().1.split_whitespace().next().unwrap().to_owned();
    let (fingerprint, secret) = (word("--ca-fingerprint "), word("--secret "));
    let _third = newcomer.run("node3", &fleet);
    let enrolment = Enrolment::new(&newcomer.address, Hash::from_hex(&fingerprint).unwrap());
    let enrolled = until("the admin enrols", || async {
        match enrolment.enrol("admin", &secret, KeyKind::Ed25519).await {
            Ok(context) => Some(context),
            // It has to learn first that its organisation belongs to the network.
            Err(refused) if matches!(refused.code, Code::Unreachable | Code::Behind) => None,
            Err(refused) => panic!("{refused}"),
        }
    })
    .await;
    assert_eq!(enrolled.organisation, "Org3");
    follows(&enrolled, &leader, &newcomer).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_cannot_join_is_told_why() {
    let (fleet, other) = (Fleet::found(1), Fleet::found(1));
    let admin = fleet.issue("Org1", "Admin", Role::Admin, &[]);
    let stranger = other.issue("Org1", "Admin", Role::Admin, &[]);
    let _nodes = (fleet.nodes[0].start(), other.nodes[0].start());
    let (leader, _other) = (connect(&admin).await, connect(&stranger).await);
    let good = token(&fleet, &leader, "Org1", "node2").await;
    let newcomer = Newcomer::new(&fleet, "second");
    let text = good.to_string();
    newcomer.join(&text[..text.len() - 9]).refused(&["this is not a join token", "ask an admin"]);
    // The node of another network has another CA; one with the right CA has another genesis.
    let elsewhere = JoinToken { addresses: vec![other.nodes[0].address.clone()], ..good.clone() };
    newcomer.join(&elsewhere.to_string()).refused(&["is not trusted", &good.ca.to_string()]);
    let renamed = JoinToken { network: Hash([1; 32]), ..good.clone() };
    newcomer.join(&renamed.to_string()).refused(&["belongs to another network"]);
    let wrong = JoinToken { secret: "00".repeat(16), ..good.clone() };
    newcomer.join(&wrong.to_string()).refused(&["enrolment is rejected", "ledgerctl network invite --node node2"]);
    let taken = Newcomer { address: fleet.nodes[0].address.clone(), ..Newcomer::new(&fleet, "taken") };
    taken.join(&text).refused(&["another process uses the address", "--address"]);
    std::fs::create_dir_all(newcomer.data()).unwrap();
    std::fs::write(newcomer.data().join("photos"), "").unwrap();
    newcomer.join(&text).refused(&["exists already", "--data"]);
    // Nothing of all this has used up the secret.
    std::fs::remove_file(newcomer.data().join("photos")).unwrap();
    // An empty directory, as a new disk is mounted, is free to be used.
    std::fs::create_dir(newcomer.data().join("lost+found")).unwrap();
    newcomer.join(&text).ok();
    assert_eq!(id(&newcomer.data()), 2);
    let mut inside: Vec<_> =
        std::fs::read_dir(newcomer.data()).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    inside.sort();
    assert_eq!(inside, ["genesis.json", "lost+found", "node.json", "node.key", "node.pem"]);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_identity_files_of_another_node_refuse_the_start_and_both_nodes_are_named() {
    let fleet = Fleet::found(1);
    let admin = fleet.issue("Org1", "Admin", Role::Admin, &[]);
    let _node = fleet.nodes[0].start();
    let leader = connect(&admin).await;
    let token = token(&fleet, &leader, "Org1", "node2").await;
    let newcomer = Newcomer::new(&fleet, "second");
    newcomer.join(&token.to_string()).ok();
    for file in ["node.pem", "node.key"] {
        std::fs::copy(fleet.nodes[0].data.join(file), newcomer.data().join(file)).unwrap();
    }
    let mut node = newcomer.run("node2", &fleet);
    assert!(!node.wait().success());
    for word in ["node.pem and node.json belong to different nodes", "Org1/org1-node", "Org1/node2"] {
        assert!(node.stderr().contains(word), "{word:?} is missing in: {}", node.stderr());
    }
}
