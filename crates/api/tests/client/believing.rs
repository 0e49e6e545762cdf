//! Answers of nodes that lie: nothing is believed that voters have not signed.

use crate::authority::Authority;
use crate::fake::{Fake, wall_clock};
use bytes::Bytes;
use ledger::Rules;
use ledger::network::{FoundingNode, FoundingOrganisation, Genesis};
use ledger_api::tls::TlsIdentity;
use ledger_api::{Call, Client, v1};
use ledger_base::hash::Hash;
use ledger_base::rejection::Code;
use ledger_light::fact::Fact;
use ledger_light::proof::{Proof, Shown};
use ledger_light::{Certificate, Change, Statement, merkle};
use std::sync::Arc;
use std::time::Duration;

/// A network of one voter, whose node the client asks.
struct Network {
    fake: Fake,
    client: Client,
    name: Hash,
    genesis: Bytes,
    /// The key of the voter, and that of a node which does not vote.
    keys: [Arc<TlsIdentity>; 2],
}

fn genesis(authority: &Authority, label: &str) -> Genesis {
    let node = |id, name: &str, voter| FoundingNode {
        id,
        name: name.into(),
        organisation: "Org1".into(),
        address: "127.0.0.1:1".into(),
        voter,
    };
    Genesis {
        rules: Rules::NEWEST.number(),
        label: label.into(),
        created: wall_clock(),
        salt: Hash::ZERO,
        organisations: vec![FoundingOrganisation::below("Org1", authority.der())],
        nodes: vec![node(1, "node1", true), node(2, "node2", false)],
        snapshot_every: 1000,
    }
}

/// The proof of a block with one verdict, signed as this node.
fn proof(network: Hash, genesis: &[u8], height: u64, (id, response): (Hash, &[u8]), by: (u64, &TlsIdentity)) -> Bytes {
    // What the genesis writes, the governing chain of a network covers.
    let begun = Genesis::governance(genesis).unwrap();
    let ground =
        Fact::Ground { governing: begun.chain(), control: Hash::ZERO, digest: Hash::ZERO, previous: Hash::ZERO };
    let verdict = Fact::Verdict { index: 0, id, code: 0, response: Hash::of(&[response]) };
    let leaves = [ground.leaf(), verdict.leaf()];
    let results = merkle::root(leaves.to_vec());
    let statement = Statement { network, recoveries: 0, height, time: wall_clock(), block: Hash::ZERO, results };
    let own = by.1.own();
    let signed = statement.sign(by.0, Bytes::copy_from_slice(own.certificate()), &own.key).unwrap();
    let facts = [(0, ground), (1, verdict)].map(|(at, fact)| Shown::of(&fact, &leaves, at).unwrap());
    Proof { certificate: Certificate { statement, signatures: vec![signed.signature] }, facts: facts.into() }.to_bytes()
}

impl Network {
    async fn new() -> Self {
        let authority = Arc::new(Authority::new());
        let genesis = genesis(&authority, "one").to_bytes().unwrap();
        let name = Genesis::network_of(&genesis).unwrap();
        let fake = Fake::start(&authority).await;
        *fake.node.network.lock().unwrap() = name;
        fake.node.steps.lock().unwrap().push(v1::GovernanceStep { genesis: genesis.clone(), ..Default::default() });
        let mut context = authority.context(&[&fake]);
        context.network = name;
        let client = Client::connect(&context).await.unwrap();
        let keys = ["node1", "node2"].map(|name| Arc::new(authority.node_named(name)));
        Self { fake, client, name, genesis, keys }
    }

    /// From now on the node shows its answer, or another one, signed by that node, as the verdict on the newest transaction or on
    /// another one.
    fn proves(&self, response: Option<&'static str>, by: u64, of: Option<Hash>) {
        let (name, genesis, key) = (self.name, self.genesis.clone(), Arc::clone(&self.keys[by as usize - 1]));
        let prover = move |height: u64, id| {
            let told = response.map_or_else(|| height.to_string(), str::to_owned);
            proof(name, &genesis, height, (of.unwrap_or(id), told.as_bytes()), (by, &*key))
        };
        *self.fake.node.prover.lock().unwrap() = Arc::new(prover);
    }

    async fn ask(&self) -> Code {
        let call = Call {
            chaincode: "abac".into(),
            function: "declare".into(),
            args: Vec::new(),
            ttl: Duration::from_secs(30),
        };
        let answer = self.client.invoke_certified(None, call).await;
        answer.map_or_else(|refused| refused.code, |_| Code::Ok)
    }
}

#[tokio::test]
async fn an_answer_is_believed_with_the_proof_of_this_very_transaction_only() {
    let network = Network::new().await;
    network.proves(None, 1, None);
    assert_eq!(network.ask().await, Code::Ok);
    network.proves(None, 1, Some(Hash([4; 32])));
    assert_eq!(network.ask().await, Code::Untrusted, "the verdict on another transaction, perhaps an old one");
    network.proves(Some("held by nobody"), 1, None);
    assert_eq!(network.ask().await, Code::Untrusted, "voters have signed another answer");
    network.proves(None, 2, None);
    assert_eq!(network.ask().await, Code::Untrusted, "a node without a vote has signed it");
    *network.fake.node.prover.lock().unwrap() = Arc::new(|_, _| Bytes::from_static(b"ledgerd proof v1\0"));
    assert_eq!(network.ask().await, Code::Malformed);
}

#[tokio::test]
async fn another_genesis_and_changes_that_nobody_has_signed_are_refused() {
    let network = Network::new().await;
    network.proves(None, 1, None);
    let put = |steps: Vec<v1::GovernanceStep>| *network.fake.node.steps.lock().unwrap() = steps;
    let members = br#"{"voters":[2],"learners":[],"outgoing":[],"learners_next":[],"auto_leave":false}"#;
    let coup =
        Change { height: 1, writes: vec![(Bytes::from_static(b"msp\0members"), Some(Bytes::from_static(members)))] };
    let changes = vec![v1::GovernanceChange { height: 1, writes: coup.to_bytes() }];
    put(vec![v1::GovernanceStep { genesis: network.genesis.clone(), changes, ..Default::default() }]);
    network.client.invoke("abac", "setup", Vec::new()).await.unwrap();
    assert_eq!(network.ask().await, Code::Untrusted, "node 2 makes itself the voter");
    let other = genesis(&Authority::new(), "another").to_bytes().unwrap();
    put(vec![v1::GovernanceStep { genesis: other, ..Default::default() }]);
    assert_eq!(network.ask().await, Code::WrongNetwork);
    put(Vec::new());
    assert_eq!(network.client.governance(None).await.unwrap_err().code, Code::NotFound);
}

#[tokio::test]
async fn a_node_whose_way_to_those_who_govern_never_ends_is_refused() {
    let network = Network::new().await;
    network.proves(None, 1, None);
    let first = v1::GovernanceStep { genesis: network.genesis.clone(), ..Default::default() };
    *network.fake.node.steps.lock().unwrap() = vec![first, v1::GovernanceStep::default()];
    network.client.invoke("abac", "setup", Vec::new()).await.unwrap();
    network.fake.node.endless.store(true, std::sync::atomic::Ordering::Relaxed);
    assert_eq!(network.ask().await, Code::TooLarge);
    assert_eq!(network.client.governance(None).await.unwrap_err().code, Code::TooLarge);
}
