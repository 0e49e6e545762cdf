//! Members that lie about the ordering protocol, with their real certificates: bytes made by hand, to real voters.

use crate::support::network::{NodePlace, NodeWish, free_address, message, register_robots};
use crate::support::{Fleet, Process, connect, wire};
use bytes::Bytes;
use futures::StreamExt;
use ledger_api::v1::peer_client::PeerClient;
use ledger_api::{Context, v1};
use ledger_identity::Role;
use ledger_identity::key::SigningKey;
use rustls_pki_types::CertificateDer;
use rustls_pki_types::pem::PemObject;
use std::sync::Arc;

/// Kinds of messages, as docs/format.md numbers them.
const APPEND: u64 = 1;
const APPEND_RESPONSE: u64 = 2;
const HEARTBEAT: u64 = 3;
const VOTE: u64 = 5;
const TIMEOUT_NOW: u64 = 9;
const READ_INDEX_RESPONSE: u64 = 11;

/// A field of protobuf that holds a number.
fn number(field: u64, value: u64) -> Vec<u8> {
    let mut bytes = Vec::new();
    for mut rest in [field << 3, value] {
        while rest > 0x7f {
            bytes.push((rest & 0x7f) as u8 | 0x80);
            rest >>= 7;
        }
        bytes.push(rest as u8);
    }
    bytes
}

/// A field of protobuf that holds bytes.
pub(crate) fn part(field: u64, content: &[u8]) -> Vec<u8> {
    let mut bytes = number(field, content.len() as u64);
    bytes[0] |= 2;
    bytes.extend_from_slice(content);
    bytes
}

/// A message `Raft` of docs/format.md in a `PeerMessage`.
fn raft(fields: &[Vec<u8>]) -> Bytes {
    part(1, &fields.concat()).into()
}

/// Says this to a node as another node, and hangs up.
pub(crate) async fn say(liar: &Context, address: &str, said: Vec<Bytes>) {
    let context = Context { nodes: vec![address.to_owned()], ..liar.clone() };
    let channel = wire::channel(&context, true).await;
    let frames = futures::stream::iter(said.into_iter().map(|message| v1::PeerFrame { message }));
    PeerClient::new(channel).messages(frames.boxed()).await.unwrap();
}

/// A network of three voters and a learner, `robot`.
pub(crate) fn found() -> Fleet {
    let wish = |name: &str, organisation: &str, voter| NodeWish {
        name: name.into(),
        organisation: organisation.into(),
        voter,
        address: free_address(),
    };
    let wishes =
        [wish("a", "Org1", true), wish("b", "Org1", true), wish("c", "Org2", true), wish("robot", "Org2", false)];
    Fleet::found_with(&wishes, crate::support::network::now())
}

/// Speaks with the certificate of a node that does not run.
pub(crate) fn as_node(place: &NodePlace, any: &Context) -> Context {
    let pem = std::fs::read(place.data.join("node.pem")).unwrap();
    let chain = CertificateDer::pem_slice_iter(&pem).collect::<Result<Vec<_>, _>>().unwrap();
    let key = SigningKey::from_pkcs8_pem(&std::fs::read_to_string(place.data.join("node.key")).unwrap()).unwrap();
    Context { chain, key: Arc::new(key), ..any.clone() }
}

#[tokio::test]
async fn a_voter_that_says_that_it_was_elected_leads_nobody_without_the_votes() {
    let fleet = found();
    let (owner, salma) = (fleet.owner(), fleet.issue("Org1", "Salma", Role::Member, &["Turtlebot4"]));
    // Node b does not run: this test speaks with its certificate.
    let others = [&fleet.nodes[0], &fleet.nodes[2]];
    let mut nodes: Vec<Process> = others.iter().map(|node| node.start()).collect();
    register_robots(&connect(&owner).await, "exclusive").await;
    let client = connect(&salma).await;
    client.invoke("abac", "acquire", vec!["Turtlebot4".into(), "600000".into()]).await.unwrap();

    let liar = as_node(&fleet.nodes[1], &salma);
    let term = 1_000_000;
    let mandate = |voters: &[u64], signed: &[u8]| -> Bytes {
        let votes = voters.iter().map(|node| part(2, &[number(1, *node), part(2, signed)].concat()));
        part(7, &[vec![number(1, term)], votes.collect()].concat().concat()).into()
    };
    let block = |data: &[u8]| part(10, &[number(1, 1), number(2, term), number(3, 1), part(4, data)].concat());
    for (round, made_up) in [&b"one"[..], b"another"].into_iter().enumerate() {
        for (node, data) in others.iter().zip([made_up, b"and to the other voter another one"]) {
            let lies = vec![
                raft(&[number(1, HEARTBEAT), number(2, term)]),
                mandate(&[2], b""),
                mandate(&[1, 2, 3], &[7; 90]),
                raft(&[number(1, HEARTBEAT), number(2, term)]),
                raft(&[number(1, APPEND), number(2, term), number(5, 1), block(data)]),
            ];
            say(&liar, &node.address, lies).await;
        }
        client.invoke("abac", "set", message(1, 1 + round as u64, b"go on")).await.unwrap();
    }
    for node in &mut nodes {
        node.check();
        assert!(node.stderr().contains("have not elected it"), "{}", node.stderr());
        assert!(!node.stderr().contains("leader=\"Org1/b\""), "{}", node.stderr());
        node.interrupt();
    }
}

#[tokio::test]
async fn a_learner_that_names_a_later_term_ends_no_voter_and_leads_nobody() {
    let fleet = found();
    let (owner, salma) = (fleet.owner(), fleet.issue("Org1", "Salma", Role::Member, &["Turtlebot4"]));
    let mut nodes: Vec<Process> = fleet.nodes[..3].iter().map(|node| node.start()).collect();
    register_robots(&connect(&owner).await, "exclusive").await;
    let client = connect(&salma).await;
    client.invoke("abac", "acquire", vec!["Turtlebot4".into(), "600000".into()]).await.unwrap();

    // The learner's node does not run: this test speaks with its certificate.
    let liar = as_node(&fleet.nodes[3], &salma);

    let (term, height) = (1_000_000, 1_000_000);
    let empty_block = part(10, &[number(1, 1), number(2, term), number(3, 1)].concat());
    let lies = vec![
        raft(&[number(1, HEARTBEAT), number(2, term), number(5, height)]),
        raft(&[number(1, HEARTBEAT), number(2, term)]),
        raft(&[number(1, APPEND), number(2, term), number(5, 1), empty_block]),
        raft(&[number(1, APPEND_RESPONSE), number(2, term), number(4, 1)]),
        raft(&[number(1, VOTE), number(2, term), number(3, term), number(4, height), part(9, b"CampaignTransfer")]),
        raft(&[number(1, TIMEOUT_NOW), number(2, 1)]),
        raft(&[number(1, READ_INDEX_RESPONSE), number(2, 1), number(4, 1), part(9, &[0; 24])]),
    ];
    for round in 0..3 {
        for node in &fleet.nodes[..3] {
            say(&liar, &node.address, lies.clone()).await;
        }
        client.invoke("abac", "set", message(1, 1 + round, b"go on")).await.unwrap();
    }
    for node in &mut nodes {
        node.check();
        assert!(node.stderr().contains("ignoring messages of a peer"), "{}", node.stderr());
        assert!(!node.stderr().contains("leader=\"Org2/robot\""), "{}", node.stderr());
        node.interrupt();
    }
}
