use crate::world::{Network, code, is_executed, json, waiting};
use bytes::Bytes;
use ledger::msp::{self, Decision, JOINS_MAX, JOINS_TIME, NODES_ALLOWED_DEFAULT, NodeRecord, NodeRole, Nodes, desired};
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::key::KeyKind;
use ledger_light::head::LINKS_MAX;
use ledger_light::{Branch, BranchLink, DoubleHead, Head, Misbehaviour, Statement, block_hash};

const LEARNER: NodeRole = NodeRole::Learner;
const VOTER: NodeRole = NodeRole::Voter;
const REMOVED: NodeRole = NodeRole::Removed;

fn set(id: u64, role: &str) -> String {
    format!(r#"{{"id":{id},"role":"{role}"}}"#)
}

#[test]
fn founding_nodes_stand_on_the_ledger_with_what_they_are_in_fact() {
    let network = Network::new(3, 2);
    let nodes: Nodes = network.query("nodes", &[]);
    assert_eq!(network.roles()[2], (3, "Org3/node3".into(), LEARNER));
    assert_eq!(desired(&nodes.nodes), (nodes.members.voters.clone(), nodes.members.learners.clone()));
    assert_eq!(nodes.members, network.ledger.members().unwrap());
    assert_eq!(nodes.nodes, msp::nodes(&**network.ledger.state()).unwrap());
    let voters = network.ledger.voters().unwrap();
    assert_eq!(
        (voters.voters, &voters.nodes[&3].name[..]),
        ([1, 2].into(), "node3"),
        "it may vote before this state knows"
    );
}

#[test]
fn a_node_joins_as_a_learner_under_the_name_in_its_certificate_and_a_new_id() {
    let mut network = Network::new(2, 2);
    let fresh = network.cas[0].user("edge", "node", KeyKind::Ed25519);
    let node: NodeRecord = json(network.call(&fresh, "join_node", &[r#"{"address":"edge:7450"}"#]));
    assert_eq!((node.id, node.full_name().as_str(), node.role), (3, "Org1/edge", LEARNER));
    assert_eq!(network.event_names(), ["joined"]);
    let again: NodeRecord = json(network.call(&fresh, "join_node", &[r#"{"address":"edge:7450","name":"edge"}"#]));
    assert_eq!(again, node, "a repeated join changes nothing");
    assert!(network.events.is_empty());
    let other = network.call(&fresh, "join_node", &[r#"{"address":"edge:7450","name":"node1"}"#]);
    assert_eq!(code(&other), Code::BadArgument);
}

#[test]
fn a_renewed_certificate_is_the_same_node() {
    let mut network = Network::new(1, 1);
    let renewed = network.cas[0].user("node1", "node", KeyKind::Ed25519);
    let node: NodeRecord = json(network.call(&renewed, "join_node", &[r#"{"address":"elsewhere:7450"}"#]));
    assert_eq!((node.id, node.role, node.address.as_str()), (1, VOTER, "elsewhere:7450"));
    assert_eq!(network.event_names(), ["moved"]);
}

#[test]
fn only_nodes_join_and_only_at_an_address_of_their_own() {
    let mut network = Network::new(2, 2);
    assert_eq!(code(&network.admin(1, "join_node", &[r#"{"address":"a:1"}"#])), Code::WrongRole);
    let fresh = network.cas[1].user("edge", "node", KeyKind::Ed25519);
    for (address, wanted) in [
        ("node1:7450", Code::AlreadyExists),
        ("node9", Code::BadArgument),
        (":7450", Code::BadArgument),
        ("node9:0", Code::BadArgument),
        ("node9:070", Code::BadArgument),
        ("node9:70000", Code::BadArgument),
        ("node 9:7450", Code::BadArgument),
        ("169.254.169.254:80", Code::BadArgument),
        ("[::1]:7450", Code::Ok),
    ] {
        let argument = format!(r#"{{"address":"{address}"}}"#);
        assert_eq!(code(&network.call(&fresh, "join_node", &[&argument])), wanted, "{address}");
    }
}

#[test]
fn a_node_that_lost_its_disk_comes_back_under_a_new_id_and_no_id_is_used_twice() {
    let mut network = Network::new(2, 2);
    let replace = r#"{"address":"node2:7450","replace":true}"#;
    let node: NodeRecord = json(network.node(2, "join_node", &[replace]));
    assert_eq!((node.id, node.role, network.role(2)), (3, LEARNER, REMOVED));
    let node: NodeRecord = json(network.node(2, "join_node", &[replace]));
    assert_eq!((node.id, network.role(3)), (4, REMOVED));
    assert!(is_executed(network.admin(2, "set_node_role", &[&set(4, "removed")])));
    let node: NodeRecord = json(network.node(2, "join_node", &[r#"{"address":"node2:7450"}"#]));
    assert_eq!(node.id, 5);
    assert_eq!(code(&network.admin(2, "set_node_role", &[&set(2, "voter")])), Code::NotAMember);
    assert_eq!(code(&network.admin(2, "set_node_role", &[&set(2, "removed")])), Code::Ok, "it is removed already");
}

#[test]
fn removed_nodes_are_forgotten_in_the_end_but_not_their_ids() {
    let mut network = Network::new(2, 2);
    for _ in 0..300 {
        network.node(2, "join_node", &[r#"{"address":"node2:7450","replace":true}"#]).unwrap();
        network.time += JOINS_TIME / JOINS_MAX;
    }
    let nodes = network.roles();
    assert_eq!((nodes.len(), nodes[1].0), (258, 46));
    assert_eq!(nodes[257], (302, "Org2/node2".into(), LEARNER));
}

#[test]
fn an_organisation_brings_in_so_many_new_nodes_in_an_hour_and_the_refusal_says_when_the_next_may_come() {
    let mut network = Network::new(3, 2);
    let (join, replace) = (r#"{"address":"node2:7450"}"#, r#"{"address":"node2:7450","replace":true}"#);
    for number in 0..JOINS_MAX {
        // Whichever way it comes anew.
        match number % 2 {
            0 => drop(network.node(2, "join_node", &[replace]).unwrap()),
            _ => {
                let last = network.roles().last().unwrap().0;
                assert!(is_executed(network.admin(2, "set_node_role", &[&set(last, "removed")])));
                network.node(2, "join_node", &[join]).unwrap();
            }
        }
    }
    let refused = network.node(2, "join_node", &[replace]).unwrap_err();
    assert!(refused.code == Code::LimitExceeded && refused.advice().ends_with(" min"), "{refused}");
    network.node(2, "join_node", &[r#"{"address":"node2:7451"}"#]).unwrap();
    // Other organisations have their own.
    network.node(3, "join_node", &[r#"{"address":"node3:7450","replace":true}"#]).unwrap();
    network.time += JOINS_TIME;
    network.node(2, "join_node", &[replace]).unwrap();
}

#[test]
fn an_organisation_demotes_and_removes_its_own_nodes_alone_and_others_only_with_approval() {
    let mut network = Network::new(3, 3);
    assert!(is_executed(network.admin(1, "set_node_role", &[&set(1, "learner")])));
    assert_eq!((network.role(1), network.event_names()), (LEARNER, vec!["role_changed"]));
    let id = waiting(network.admin(1, "set_node_role", &[&set(2, "removed")]));
    assert_eq!(network.role(2), VOTER);
    assert!(is_executed(network.admin(3, "approve", &[&id])));
    assert_eq!(network.role(2), REMOVED);
    assert_eq!(code(&network.node(1, "set_node_role", &[&set(1, "removed")])), Code::NotAdmin);
}

/// The proof that node 1 has signed two blocks, or two results, of one height.
fn proof(network: &Network, (block, results): (u8, u8)) -> String {
    let signed = |block, results| {
        let statement = Statement {
            network: network.ledger.network(),
            recoveries: 0,
            height: 5,
            time: network.time,
            block: Hash([block; 32]),
            results: Hash([results; 32]),
        };
        statement.sign(1, network.nodes[0].certificate.clone(), &network.nodes[0].key).unwrap()
    };
    hex::encode(Misbehaviour::of(signed(1, 1), signed(block, results)).unwrap().to_bytes())
}

fn set_by_proof(id: u64, role: &str, proof: &str) -> String {
    format!(r#"{{"id":{id},"role":"{role}","proof":"{proof}"}}"#)
}

#[test]
fn the_vote_of_a_node_that_has_lied_ends_without_its_organisation_and_by_nobody_alone_where_there_are_others() {
    let mut network = Network::new(2, 2);
    let lie = proof(&network, (2, 1));
    assert!(is_executed(network.admin(2, "set_node_role", &[&set_by_proof(1, "removed", &lie)])), "the others are one");
    assert_eq!(network.role(1), REMOVED);

    let mut network = Network::new(4, 3);
    let lie = proof(&network, (2, 1));
    let id = waiting(network.admin(2, "set_node_role", &[&set_by_proof(1, "learner", &lie)]));
    waiting(network.admin(1, "approve", &[&id]));
    assert_eq!(network.role(1), VOTER, "its own organisation has no voice");
    assert!(is_executed(network.admin(3, "approve", &[&id])));
    assert_eq!(network.role(1), LEARNER);

    // Where all must agree, all others do.
    let mut network = Network::new(3, 3);
    let set = r#"{"chaincode":"msp","function":"set_node_role","quorum":"organisations = all"}"#;
    let id = waiting(network.admin(1, "set_quorum", &[set]));
    assert!(is_executed(network.admin(2, "approve", &[&id])));
    let lie = proof(&network, (2, 1));
    let id = waiting(network.admin(2, "set_node_role", &[&set_by_proof(1, "removed", &lie)]));
    assert!(is_executed(network.admin(3, "approve", &[&id])));
    assert_eq!(network.role(1), REMOVED);
}

#[test]
fn a_proof_justifies_the_end_of_the_vote_of_the_node_that_has_lied_and_nothing_else() {
    let mut network = Network::new(2, 2);
    let (lie, fault) = (proof(&network, (2, 1)), proof(&network, (1, 2)));
    let mut forged = lie.clone().into_bytes();
    let last = forged.len() - 1;
    forged[last] = if forged[last] == b'0' { b'1' } else { b'0' };
    let forged = String::from_utf8(forged).unwrap();
    for (id, role, proof, wanted) in [
        (1, "removed", &fault[..], Code::BadArgument),
        (2, "removed", &lie, Code::BadArgument),
        (1, "voter", &lie, Code::BadArgument),
        (1, "removed", "zz", Code::BadArgument),
        (1, "removed", &forged, Code::BadSignature),
        (1, "removed", "00", Code::Malformed),
    ] {
        let refused = network.admin(2, "set_node_role", &[&set_by_proof(id, role, proof)]);
        assert_eq!(code(&refused), wanted, "{id} {role} {refused:?}");
    }
    // Under a new number, the node has not lied.
    network.node(1, "join_node", &[r#"{"address":"node1:7450","replace":true}"#]).unwrap();
    assert_eq!(code(&network.admin(2, "set_node_role", &[&set_by_proof(3, "removed", &lie)])), Code::BadArgument);
}

/// The proof that node 1 has led with two logs, as long as one can be.
fn longest_double_head(network: &Network) -> String {
    let (name, node) = (network.ledger.network(), &network.nodes[0]);
    let link = BranchLink { term: 3, time: network.time, root: Hash([9; 32]) };
    let branch = |base: u8| {
        let base = Hash([base; 32]);
        let links = vec![link; LINKS_MAX];
        let end = 5 + LINKS_MAX as u64;
        let hash = (6..=end).zip(&links).fold(base, |hash, (height, link)| block_hash(height, link, hash));
        let head = Head { network: name, recoveries: 0, leader: 1, term: 3, height: end, hash };
        Branch { base, links, signature: head.sign(node.certificate.clone(), &node.key).unwrap() }
    };
    let branches = [branch(1), branch(2)];
    let heads =
        DoubleHead { network: name, recoveries: 0, leader: 1, term: 3, height: 5, time: network.time, branches };
    hex::encode(Misbehaviour::DoubleHead(heads).to_bytes())
}

#[test]
fn the_longest_proof_of_two_logs_fits_a_proposal() {
    let mut network = Network::new(4, 3);
    let heads = longest_double_head(&network);
    let id = waiting(network.admin(2, "set_node_role", &[&set_by_proof(1, "removed", &heads)]));
    assert!(is_executed(network.admin(3, "approve", &[&id])));
    assert_eq!(network.role(1), REMOVED);
    let other = network.admin(2, "set_node_role", &[&set_by_proof(2, "removed", &heads)]);
    assert_eq!(code(&other), Code::BadArgument, "it is about node 1");
}

#[test]
fn a_vote_is_given_by_a_majority_of_organisations_whosever_node_it_is() {
    let mut network = Network::new(2, 1);
    let by_name = r#"{"organisation":"Org2","name":"node2","role":"voter"}"#;
    let id = waiting(network.admin(2, "set_node_role", &[by_name]));
    assert_eq!(network.role(2), LEARNER);
    assert!(is_executed(network.admin(1, "approve", &[&id])));
    assert_eq!((network.role(2), network.event_names()), (VOTER, vec!["approved", "role_changed", "executed"]));
    assert!(is_executed(network.admin(1, "set_node_role", &[by_name])), "nothing is left to decide");
}

#[test]
fn the_last_voter_stays() {
    let mut network = Network::new(2, 1);
    for role in ["learner", "removed"] {
        assert_eq!(code(&network.admin(1, "set_node_role", &[&set(1, role)])), Code::LastOne, "{role}");
        assert_eq!(code(&network.admin(2, "set_node_role", &[&set(1, role)])), Code::LastOne, "{role}");
    }
    assert_eq!(code(&network.node(1, "join_node", &[r#"{"address":"node1:1","replace":true}"#])), Code::LastOne);
    assert_eq!(network.role(1), VOTER);
}

#[test]
fn the_last_voter_stays_also_when_an_older_approval_comes_late() {
    let mut network = Network::new(3, 2);
    let first = waiting(network.admin(3, "set_node_role", &[&set(1, "learner")]));
    let second = waiting(network.admin(3, "set_node_role", &[&set(2, "learner")]));
    assert!(is_executed(network.admin(2, "approve", &[&first])));
    let decision: Decision = json(network.admin(1, "approve", &[&second]));
    let failed = decision.proposal.unwrap().failed.unwrap();
    assert_eq!((decision.executed, failed.code), (false, Code::LastOne.number()));
    assert_eq!(network.role(2), VOTER);
}

#[test]
fn one_organisation_cannot_fill_the_network_with_its_nodes() {
    let mut network = Network::new(2, 1);
    for number in 1..NODES_ALLOWED_DEFAULT {
        assert_eq!(code(&join_edge(&mut network, number)), Code::Ok, "{number}");
    }
    assert_eq!(code(&join_edge(&mut network, 99)), Code::LimitExceeded);
    let other = network.cas[1].user("edge", "node", KeyKind::Ed25519);
    assert_eq!(code(&network.call(&other, "join_node", &[r#"{"address":"e:7450"}"#])), Code::Ok);
}

/// A new node of the first organisation joins.
fn join_edge(network: &mut Network, number: usize) -> Result<Bytes, Rejection> {
    let node = network.cas[0].user(&format!("edge{number}"), "node", KeyKind::Ed25519);
    network.call(&node, "join_node", &[&format!(r#"{{"address":"edge{number}:7450"}}"#)])
}

#[test]
fn the_organisations_decide_together_how_many_nodes_one_has() {
    let mut network = Network::new(3, 1);
    let allow = |nodes: usize| format!(r#"{{"organisation":"Org1","nodes":{nodes}}}"#);
    let id = waiting(network.admin(1, "allow_nodes", &[&allow(2)]));
    assert_eq!(code(&join_edge(&mut network, 1)), Code::Ok, "one organisation alone changes nothing");
    assert!(is_executed(network.admin(2, "approve", &[&id])));
    assert_eq!(network.event_names(), ["approved", "nodes_allowed", "executed"]);
    assert_eq!(code(&join_edge(&mut network, 2)), Code::LimitExceeded);
    let other = network.cas[1].user("edge", "node", KeyKind::Ed25519);
    assert_eq!(code(&network.call(&other, "join_node", &[r#"{"address":"e:7450"}"#])), Code::Ok);
    let id = waiting(network.admin(1, "allow_nodes", &[&allow(3)]));
    assert!(is_executed(network.admin(3, "approve", &[&id])));
    assert_eq!(code(&join_edge(&mut network, 2)), Code::Ok);
    for (argument, wanted) in
        [(allow(65), Code::BadArgument), (r#"{"organisation":"Org9","nodes":1}"#.into(), Code::NotFound)]
    {
        assert_eq!(code(&network.admin(1, "allow_nodes", &[&argument])), wanted, "{argument}");
    }
}

#[test]
fn a_node_that_nobody_knows_is_named_with_those_that_there_are() {
    let mut network = Network::new(2, 1);
    let refused = network.admin(1, "set_node_role", &[&set(9, "voter")]).unwrap_err();
    assert_eq!(refused.code, Code::NotFound);
    assert!(refused.wanted.contains("1 (Org1/node1), 2 (Org2/node2)"), "{refused}");
    for argument in [r#"{"role":"voter"}"#, r#"{"id":1,"name":"x","role":"voter"}"#, r#"{"id":1,"role":"king"}"#, "[]"]
    {
        assert_eq!(code(&network.admin(1, "set_node_role", &[argument])), Code::BadArgument, "{argument}");
    }
}
