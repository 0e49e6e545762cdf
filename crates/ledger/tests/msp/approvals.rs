use crate::world::{DAY, Network, code, is_executed, waiting};
use ledger::msp::{Decision, NodeRole};
use ledger_base::rejection::Code;
use ledger_identity::key::KeyKind;

fn promote(id: u64) -> String {
    format!(r#"{{"id":{id},"role":"voter"}}"#)
}

#[test]
fn a_network_of_one_organisation_decides_at_once() {
    let mut network = Network::new(1, 1);
    let edge = network.cas[0].user("edge", "node", KeyKind::Ed25519);
    network.call(&edge, "join_node", &[r#"{"address":"edge:7450"}"#]).unwrap();
    assert!(is_executed(network.admin(1, "set_node_role", &[&promote(2)])));
    assert_eq!(network.role(2), NodeRole::Voter);
    assert!(network.query::<Vec<Decision>>("proposals", &[]).is_empty());
}

#[test]
fn more_than_half_is_needed_and_a_proposal_tells_who_is_missing() {
    let mut network = Network::new(4, 1);
    let id = waiting(network.admin(1, "set_node_role", &[&promote(2)]));
    assert_eq!(waiting(network.admin(2, "approve", &[&id])), id, "two of four are not more than half");
    assert_eq!(waiting(network.admin(2, "approve", &[&id])), id, "an organisation counts once");
    let standing: Vec<Decision> = network.query("proposals", &[]);
    assert_eq!(
        (standing.len(), standing[0].missing, &standing[0].pending),
        (1, 1, &vec!["Org3".into(), "Org4".into()])
    );
    assert!(is_executed(network.admin(4, "approve", &[&id[..8]])), "the first digits of the id are enough");
    assert!(network.query::<Vec<Decision>>("proposals", &[]).is_empty());
    assert_eq!(code(&network.admin(3, "approve", &[&id])), Code::NotFound);
}

#[test]
fn only_admins_approve_and_withdraw() {
    let mut network = Network::new(3, 1);
    let id = waiting(network.admin(1, "set_node_role", &[&promote(2)]));
    let member = network.cas[1].user("Salma", "member", KeyKind::Ed25519);
    for function in ["approve", "withdraw"] {
        assert_eq!(code(&network.call(&member, function, &[&id])), Code::NotAdmin);
        assert_eq!(code(&network.node(2, function, &[&id])), Code::NotAdmin);
    }
    assert_eq!(network.role(2), NodeRole::Learner);
}

#[test]
fn proposing_what_stands_already_approves_it() {
    let mut network = Network::new(3, 1);
    let id = waiting(network.admin(1, "set_node_role", &[&promote(2)]));
    assert_eq!(waiting(network.admin(1, "set_node_role", &[&promote(2)])), id);
    assert!(is_executed(network.admin(2, "set_node_role", &[&promote(2)])));
}

#[test]
fn the_same_proposal_made_again_has_another_id() {
    let mut network = Network::new(2, 1);
    let first = waiting(network.admin(1, "set_node_role", &[&promote(2)]));
    network.admin(1, "withdraw", &[&first]).unwrap();
    let second = waiting(network.admin(1, "set_node_role", &[&promote(2)]));
    assert_ne!(first, second, "an approval of the first must not count for the second");
    assert_eq!(code(&network.admin(2, "approve", &[&first])), Code::NotFound);
}

#[test]
fn an_approval_can_be_taken_back_and_a_proposal_only_by_its_organisation() {
    let mut network = Network::new(4, 1);
    let id = waiting(network.admin(1, "set_node_role", &[&promote(2)]));
    waiting(network.admin(2, "approve", &[&id]));
    network.admin(2, "withdraw", &[&id]).unwrap();
    assert_eq!(waiting(network.admin(3, "approve", &[&id])), id, "two of four again");
    assert_eq!(code(&network.admin(4, "withdraw", &[&id])), Code::NotFound);
    network.admin(1, "withdraw", &[&id]).unwrap();
    assert_eq!(network.event_names(), ["withdrawn"]);
    assert!(network.query::<Vec<Decision>>("proposals", &[]).is_empty());
}

#[test]
fn a_proposal_ends_after_seven_days_of_block_time() {
    let mut network = Network::new(2, 1);
    let id = waiting(network.admin(1, "set_node_role", &[&promote(2)]));
    network.time += 7 * DAY;
    assert_eq!(code(&network.admin(2, "approve", &[&id])), Code::NotFound);
    assert!(network.query::<Vec<Decision>>("proposals", &[]).is_empty());
    let again = waiting(network.admin(1, "set_node_role", &[&promote(2)]));
    network.time += 7 * DAY - 2_000_000;
    assert!(is_executed(network.admin(2, "approve", &[&again])), "a moment before");
}

#[test]
fn approvals_of_an_organisation_that_left_do_not_count_and_fewer_organisations_need_fewer_approvals() {
    let mut network = Network::new(5, 1);
    // Approved by Org1 and Org2: two of five.
    let votes = waiting(network.admin(1, "set_node_role", &[&promote(2)]));
    waiting(network.admin(2, "approve", &[&votes]));
    // Approved by Org5 and Org1: two of five.
    let other = waiting(network.admin(5, "set_node_role", &[&promote(3)]));
    waiting(network.admin(1, "approve", &[&other]));
    for gone in ["Org5", "Org4"] {
        let argument = format!(r#"{{"name":"{gone}"}}"#);
        let id = waiting(network.admin(1, "remove_organisation", &[&argument]));
        waiting(network.admin(2, "approve", &[&id]));
        assert!(is_executed(network.admin(3, "approve", &[&id])));
    }
    assert_eq!(network.role(2), NodeRole::Voter, "two of three, in the block that left three");
    assert_eq!(network.role(3), NodeRole::Learner, "one of three: that of Org5 is gone");
    let decisions: Vec<Decision> = network.query("proposals", &[]);
    assert_eq!((decisions.len(), decisions[0].missing), (1, 1));
}

#[test]
fn one_organisation_cannot_fill_the_list_of_proposals() {
    let mut network = Network::new(2, 1);
    let invite = |network: &mut Network, by, number: usize| {
        let (key, expires) = ("00".repeat(32), network.time + DAY);
        let argument = format!(r#"{{"name":"New{number}","key":"{key}","expires":{expires}}}"#);
        network.admin(by, "invite_organisation", &[&argument])
    };
    for number in 0..16 {
        waiting(invite(&mut network, 1, number));
    }
    assert_eq!(code(&invite(&mut network, 1, 16)), Code::LimitExceeded);
    waiting(invite(&mut network, 2, 16));
    network.time += 8 * DAY;
    waiting(invite(&mut network, 1, 17));
    let standing: Vec<Decision> = network.query("proposals", &[]);
    assert_eq!(standing.len(), 1, "the others have expired");
}

#[test]
fn ids_that_name_nothing_are_refused() {
    let mut network = Network::new(2, 1);
    for (id, wanted) in [("", Code::BadArgument), ("1234567", Code::BadArgument), ("xyzxyzxyz", Code::BadArgument)] {
        assert_eq!(code(&network.admin(1, "approve", &[id])), wanted, "{id}");
    }
    assert_eq!(code(&network.admin(1, "approve", &["12345678"])), Code::NotFound);
    assert_eq!(code(&network.admin(1, "approve", &[])), Code::BadArgument);
    let unknown = network.admin(1, "aprove", &["12345678"]).unwrap_err();
    assert!(unknown.code == Code::UnknownFunction && unknown.wanted.contains("approve"), "{unknown}");
}
