use crate::world::{Network, code, is_executed};
use ledger::msp::{self, AttestationRecord};
use ledger_base::hash::Hash;
use ledger_base::rejection::Code;
use ledger_identity::key::KeyKind;

fn attest(height: u64, digest: u8, content: Option<u8>) -> String {
    let (hash, digest) = (Hash::ZERO, Hash([digest; 32]));
    let content = content.map(|byte| format!(r#","content":"{}""#, Hash([byte; 32]))).unwrap_or_default();
    format!(r#"{{"height":{height},"hash":"{hash}","digest":"{digest}"{content}}}"#)
}

fn known(network: &Network) -> Vec<AttestationRecord> {
    let answer = network.query("attestations", &[]);
    assert_eq!(answer, msp::attestations(&**network.ledger.state()).unwrap());
    answer
}

#[test]
fn the_ledger_keeps_what_each_node_attested_last() {
    let mut network = Network::new(2, 2);
    network.node(1, "attest", &[&attest(0, 1, None)]).unwrap();
    network.node(2, "attest", &[&attest(1, 2, None)]).unwrap();
    network.node(1, "attest", &[&attest(2, 3, None)]).unwrap();
    assert_eq!((network.event_names(), network.events[0].subject.as_str()), (vec!["attested"], "Org1/node1"));
    let records = known(&network);
    let told: Vec<_> = records.iter().map(|r| (r.node.as_str(), r.id, r.latest.attest.height)).collect();
    assert_eq!(told, [("node1", 1, 2), ("node2", 2, 1)]);
    let transaction = records[0].latest.transaction;
    assert_eq!(network.ledger.transaction(&transaction).unwrap().unwrap().height, 3, "its proof can be found");
}

#[test]
fn an_attestation_of_a_snapshot_stays_beside_newer_ones_and_may_come_late() {
    let mut network = Network::new(1, 1);
    for _ in 0..4 {
        network.block(&[]);
    }
    network.node(1, "attest", &[&attest(4, 1, None)]).unwrap();
    network.node(1, "attest", &[&attest(3, 1, Some(7))]).unwrap();
    network.node(1, "attest", &[&attest(5, 1, None)]).unwrap();
    let record = known(&network).remove(0);
    let snapshot = record.snapshot.unwrap().attest;
    assert_eq!((record.latest.attest.height, snapshot.height, snapshot.content), (5, 3, Some(Hash([7; 32]))));
}

#[test]
fn what_two_organisations_attest_is_remembered_until_they_attest_something_newer() {
    let mut network = Network::new(2, 2);
    let remembered = Some((2, Hash([2; 32])));
    for _ in 0..9 {
        network.block(&[]);
    }
    let mut snapshot = |node: usize, height: u8| {
        network.node(node, "attest", &[&attest(height.into(), 1, Some(height))]).unwrap();
        msp::shared_snapshot(&known(&network), 2)
    };
    assert_eq!(snapshot(1, 2), None);
    assert_eq!(snapshot(2, 2), Some((2, Hash([2; 32]))));
    // One goes on, the other is late and attests others.
    for height in [3, 4, 5] {
        assert_eq!(snapshot(1, height), remembered, "{height}");
    }
    for height in [3, 4] {
        assert_eq!(snapshot(2, height), remembered, "{height}");
    }
    assert_eq!(snapshot(2, 5), Some((5, Hash([5; 32]))));
    assert_eq!(snapshot(2, 6), Some((5, Hash([5; 32]))));
    assert_eq!(snapshot(1, 7), Some((5, Hash([5; 32]))));
}

#[test]
fn a_node_does_not_go_back_nor_speak_of_what_is_to_come() {
    let mut network = Network::new(1, 1);
    for _ in 0..3 {
        network.block(&[]);
    }
    network.node(1, "attest", &[&attest(3, 1, Some(1))]).unwrap();
    assert_eq!(code(&network.node(1, "attest", &[&attest(2, 1, None)])), Code::BadArgument);
    assert_eq!(code(&network.node(1, "attest", &[&attest(2, 1, Some(1))])), Code::BadArgument);
    assert_eq!(code(&network.node(1, "attest", &[&attest(99, 1, None)])), Code::BadArgument);
    assert_eq!(known(&network)[0].latest.attest.height, 3);
}

#[test]
fn only_nodes_of_the_network_attest_and_those_removed_are_forgotten() {
    let mut network = Network::new(2, 2);
    assert_eq!(code(&network.admin(1, "attest", &[&attest(0, 1, None)])), Code::WrongRole);
    let stranger = network.cas[0].user("edge", "node", KeyKind::Ed25519);
    assert_eq!(code(&network.call(&stranger, "attest", &[&attest(0, 1, None)])), Code::NotAMember);
    network.node(2, "attest", &[&attest(0, 1, None)]).unwrap();
    assert!(is_executed(network.admin(2, "set_node_role", &[r#"{"id":2,"role":"removed"}"#])));
    assert!(known(&network).is_empty());
    assert_eq!(code(&network.node(2, "attest", &[&attest(1, 1, None)])), Code::NotAMember);
    assert_eq!(code(&network.node(1, "attest", &[r#"{"height":1}"#])), Code::BadArgument);
}
