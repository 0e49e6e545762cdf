//! Proposals of any call that needs approval, and the quorums that they need.

use crate::world::{Ca, DAY, Network, User, code, failed, is_executed, json, waiting};
use ledger::msp::{CALL_ARGS_MAX, CALL_BYTES_MAX, Decision, FunctionQuorum};
use ledger_base::rejection::Code;
use ledger_identity::key::KeyKind;
use serde_json::{Value, json as value};

fn call_of(chaincode: &str, function: &str, args: &[&str]) -> String {
    let args: Vec<_> = args.iter().map(hex::encode).collect();
    value!({ "chaincode": chaincode, "function": function, "args": args }).to_string()
}

/// A proposal of `listener agree TEXT`.
fn agree(text: &str) -> String {
    call_of("listener", "agree", &[text])
}

fn quorum(chaincode: &str, function: &str, quorum: &str) -> String {
    value!({ "chaincode": chaincode, "function": function, "quorum": quorum }).to_string()
}

/// Another admin of an organisation, counted from 1.
fn deputy(network: &Network, organisation: usize, name: &str) -> User {
    network.cas[organisation - 1].user(name, "admin", KeyKind::Ed25519)
}

fn revoke(network: &mut Network, organisation: usize, user: &User) {
    let identity = network.ledger.msps().verify(&user.certificate, &[], network.time).unwrap();
    let (issuer, serial) = (hex::encode(identity.issuer), hex::encode(&identity.serial));
    network.admin(organisation, "revoke", &[&issuer, &serial]).unwrap();
}

#[test]
fn a_call_is_executed_once_its_quorum_agrees_and_learns_who_did() {
    let mut network = Network::new(3, 1);
    let id = waiting(network.admin(1, "propose", &[&agree("yes")]));
    assert_eq!(network.agreed(), "");
    assert!(is_executed(network.admin(3, "approve", &[&id])));
    assert_eq!(network.agreed(), "b\"yes\" by Org1 {\"Admin\"}, Org3 {\"Admin\"} for Org1\n");
    assert_eq!(network.event_names(), ["approved", "agreed", "executed"]);
    assert_eq!(code(&network.admin(2, "approve", &[&id])), Code::NotFound, "it is done once");
}

#[test]
fn a_function_that_needs_approval_refuses_a_direct_call_and_says_how_to_propose_it() {
    let mut network = Network::new(3, 1);
    let boss = deputy(&network, 1, "Boss");
    for function in ["agree", "detour"] {
        let call = network.sign_for("listener", &boss, function, &["yes"]);
        let refused = network.block(&[&call]).remove(0).unwrap_err();
        assert_eq!(refused.code, Code::NeedsApproval, "{function}");
        assert!(refused.advice().starts_with("ledgerctl network propose listener agree ARG"), "{refused}");
    }
    assert_eq!(network.agreed(), "");
}

#[test]
fn what_an_approved_call_calls_is_not_approved() {
    let mut network = Network::new(1, 1);
    assert_eq!(code(&network.admin(1, "propose", &[&agree("detour")])), Code::NeedsApproval);
}

#[test]
fn an_approval_counts_for_exactly_the_proposed_bytes() {
    let mut network = Network::new(3, 1);
    let first = waiting(network.admin(1, "propose", &[&agree("yes")]));
    let other = waiting(network.admin(2, "propose", &[&agree("yes ")]));
    assert_ne!(first, other);
    assert_eq!(network.agreed(), "", "one organisation each");
    assert!(is_executed(network.admin(2, "propose", &[&agree("yes")])), "the same call again is an approval");
    assert_eq!(network.agreed(), "b\"yes\" by Org1 {\"Admin\"}, Org2 {\"Admin\"} for Org1\n");
    assert_eq!(waiting(network.admin(2, "approve", &[&other])), other);
}

#[test]
fn neither_the_proposer_nor_another_admin_of_its_organisation_adds_an_organisation() {
    let mut network = Network::new(3, 1);
    let boss = deputy(&network, 1, "Boss");
    let id = waiting(network.admin(1, "propose", &[&agree("yes")]));
    for answer in [
        network.admin(1, "approve", &[&id]),
        network.admin(1, "propose", &[&agree("yes")]),
        network.call(&boss, "approve", &[&id]),
        network.call(&boss, "approve", &[&id]),
    ] {
        assert_eq!(waiting(answer), id);
    }
    let standing: Vec<Decision> = network.query("proposals", &[]);
    let proposal = standing[0].proposal.as_ref().unwrap();
    assert_eq!((standing[0].missing, proposal.approved_by.len(), proposal.approvals.len()), (1, 2, 1));
}

#[test]
fn a_quorum_of_admins_counts_different_admins_of_that_organisation() {
    let mut network = Network::new(2, 1);
    let id = waiting(network.admin(1, "propose", &[&call_of("listener", "agree-as-one", &["yes"])]));
    assert_eq!(waiting(network.admin(2, "approve", &[&id])), id, "another organisation is not asked");
    let renewed = deputy(&network, 1, "Admin");
    assert_eq!(waiting(network.call(&renewed, "approve", &[&id])), id, "the same admin with another certificate");
    let boss = deputy(&network, 1, "Boss");
    assert!(is_executed(network.call(&boss, "approve", &[&id])));
    assert!(network.agreed().contains("Org1 {\"Admin\", \"Boss\"}, Org2 {\"Admin\"} for Org1"), "{}", network.agreed());
}

#[test]
fn the_approval_of_a_revoked_admin_does_not_count() {
    let mut network = Network::new(3, 1);
    let boss = deputy(&network, 2, "Boss");
    let id = waiting(network.call(&boss, "propose", &[&agree("yes")]));
    revoke(&mut network, 2, &boss);
    let standing: Vec<Decision> = network.query("proposals", &[]);
    assert_eq!((standing[0].missing, standing[0].proposal.as_ref().unwrap().approvals.len()), (2, 0));
    assert_eq!(waiting(network.admin(1, "approve", &[&id])), id, "one of three");
    assert!(is_executed(network.admin(2, "approve", &[&id])), "another admin of that organisation agrees");
    assert!(!network.agreed().contains("Boss"), "{}", network.agreed());
}

#[test]
fn the_approval_of_an_admin_whose_authority_was_lost_does_not_count() {
    let mut network = Network::new(3, 1);
    let renewed = Ca::new("org2-ca-2031");
    let roots = |cas: &[&Ca]| {
        let roots: Vec<_> = cas.iter().map(|ca| hex::encode(ca.root())).collect();
        value!({ "roots": roots }).to_string()
    };
    let both = roots(&[&network.cas[1], &renewed]);
    network.admin(2, "update_organisation", &[&both]).unwrap();
    let id = waiting(network.admin(2, "propose", &[&agree("yes")]));
    let boss = renewed.user("Boss", "admin", KeyKind::Ed25519);
    network.call(&boss, "update_organisation", &[&roots(&[&renewed])]).unwrap();
    let standing: Vec<Decision> = network.query("proposals", &[]);
    assert_eq!((standing[0].missing, standing[0].proposal.as_ref().unwrap().approvals.len()), (2, 0));
    assert_eq!(waiting(network.admin(1, "approve", &[&id])), id, "one of three");
    assert!(is_executed(network.call(&boss, "approve", &[&id])), "an admin whose authority stands agrees");
}

#[test]
fn an_organisation_that_left_and_came_back_is_asked_again() {
    let mut network = Network::new(4, 1);
    let id = waiting(network.admin(4, "propose", &[&agree("yes")]));
    waiting(network.admin(3, "approve", &[&id]));
    let all = quorum("listener", "agree", "admins of Org4 = 2");
    let change = waiting(network.admin(1, "set_quorum", &[&all]));
    waiting(network.admin(2, "approve", &[&change]));
    assert!(is_executed(network.admin(3, "approve", &[&change])));
    let remove = waiting(network.admin(1, "remove_organisation", &[r#"{"name":"Org4"}"#]));
    waiting(network.admin(2, "approve", &[&remove]));
    assert!(is_executed(network.admin(3, "approve", &[&remove])));
    let standing: Vec<Decision> = network.query("proposals", &[]);
    let proposal = standing[0].proposal.as_ref().unwrap();
    assert_eq!(proposal.approvals, ["Org3".to_owned()].into(), "that of Org4 is gone for ever");
    let rules: Vec<FunctionQuorum> = network.query("quorums", &[]);
    let rule = rules.iter().find(|rule| rule.function == "agree").unwrap();
    assert_eq!((rule.set, rule.quorum.to_string().as_str()), (false, "organisations = majority"), "nobody could agree");
}

#[test]
fn a_quorum_is_changed_only_under_the_quorum_that_stands() {
    let mut network = Network::new(3, 1);
    let (all, one) =
        (quorum("listener", "agree", "organisations = all"), quorum("listener", "agree", "organisations = 1"));
    let id = waiting(network.admin(1, "set_quorum", &[&all]));
    assert!(is_executed(network.admin(2, "approve", &[&id])), "more than half, as the table says");
    assert_eq!(network.event_names(), ["approved", "quorum_changed", "executed"]);
    let easier = waiting(network.admin(1, "set_quorum", &[&one]));
    assert_eq!(waiting(network.admin(2, "approve", &[&easier])), easier, "all must agree to that now");
    let call = waiting(network.admin(1, "propose", &[&agree("yes")]));
    assert_eq!(waiting(network.admin(2, "approve", &[&call])), call);
    assert!(is_executed(network.admin(3, "approve", &[&easier])));
    let executed = network.event_names();
    assert_eq!(executed, ["approved", "quorum_changed", "executed", "agreed", "executed"], "what is due is done");
    assert!(is_executed(network.admin(2, "propose", &[&agree("alone")])));
    let table = value!({ "chaincode": "listener", "function": "agree" }).to_string();
    assert!(is_executed(network.admin(3, "set_quorum", &[&table])), "one organisation decides");
    assert_eq!(json::<Value>(network.admin(1, "propose", &[&agree("again")]))["missing"], 1);
}

#[test]
fn a_quorum_for_what_has_none_is_refused() {
    let mut network = Network::new(2, 1);
    for (chaincode, function, rule, wanted) in [
        ("listener", "echo", "organisations = all", Code::BadArgument),
        ("nobody", "agree", "organisations = all", Code::UnknownChaincode),
        ("msp", "set_quorum", "organisations = 1", Code::BadArgument),
        ("msp", "approve", "organisations = 1", Code::BadArgument),
        ("listener", "agree", "organisations = 0", Code::BadArgument),
        ("listener", "agree", "everybody", Code::BadArgument),
        ("listener", "agree", "admins of Org9 = 1", Code::NotFound),
    ] {
        let argument = quorum(chaincode, function, rule);
        assert_eq!(code(&network.admin(1, "set_quorum", &[&argument])), wanted, "{argument}");
    }
    let member = network.cas[0].user("Salma", "member", KeyKind::Ed25519);
    let argument = quorum("listener", "agree", "organisations = all");
    assert_eq!(code(&network.call(&member, "set_quorum", &[&argument])), Code::NotAdmin);
}

#[test]
fn what_cannot_be_proposed_is_refused_with_what_can() {
    let mut network = Network::new(2, 1);
    let nested = call_of("msp", "propose", &[&agree("yes")]);
    for (call, wanted, says) in [
        (nested.as_str(), Code::BadArgument, "set_node_role"),
        (&call_of("msp", "approve", &["00000000"]), Code::BadArgument, "set_node_role"),
        (&call_of("listener", "echo", &["yes"]), Code::BadArgument, "agree, agree-as-one"),
        (&call_of("listener", "no such", &[]), Code::BadArgument, "agree, agree-as-one"),
        (&call_of("nobody", "agree", &[]), Code::UnknownChaincode, "listener"),
        (&call_of("msp", "set_node_role", &["{}"]), Code::BadArgument, "role"),
        (r#"{"chaincode":"listener"}"#, Code::BadArgument, "args"),
        (r#"{"chaincode":"listener","function":"agree","args":["zz"]}"#, Code::BadArgument, "hexadecimal"),
        ("[]", Code::BadArgument, "args"),
    ] {
        let refused = network.admin(1, "propose", &[call]).unwrap_err();
        assert_eq!(refused.code, wanted, "{call}: {refused}");
        assert!(refused.to_string().contains(says), "{says} in {refused}");
    }
    let member = network.cas[0].user("Salma", "member", KeyKind::Ed25519);
    assert_eq!(code(&network.call(&member, "propose", &[&agree("yes")])), Code::NotAdmin);
    assert_eq!(code(&network.node(1, "propose", &[&agree("yes")])), Code::NotAdmin);
    assert!(network.query::<Vec<Decision>>("proposals", &[]).is_empty());
}

#[test]
fn a_call_with_long_or_many_arguments_is_refused() {
    let mut network = Network::new(2, 1);
    let longest = CALL_BYTES_MAX - "listener".len() - "agree".len();
    let refused = network.admin(1, "propose", &[&agree(&"x".repeat(longest + 1))]).unwrap_err();
    assert!(refused.code == Code::TooLarge && refused.wanted == "at most 16384 bytes", "{refused}");
    waiting(network.admin(1, "propose", &[&agree(&"x".repeat(longest))]));
    let many = call_of("listener", "agree", &vec![""; CALL_ARGS_MAX + 1]);
    let refused = network.admin(1, "propose", &[&many]).unwrap_err();
    assert!(refused.code == Code::TooLarge && refused.wanted == "at most 64 arguments", "{refused}");
}

#[test]
fn a_call_that_would_be_refused_now_is_not_proposed() {
    let mut network = Network::new(2, 1);
    let wrong = call_of("listener", "agree", &["refuse"]);
    let boss = deputy(&network, 1, "Boss");
    let arm = network.sign_for("listener", &boss, "arm", &[]);
    network.block(&[&arm]).remove(0).unwrap();
    assert_eq!(code(&network.admin(1, "propose", &[&wrong])), Code::Refused);
    assert!(network.events.is_empty() && network.agreed().is_empty(), "nothing of the rehearsal is left");
    assert_eq!(code(&network.admin(1, "propose", &[&agree("panic")])), Code::ChaincodePanic);
}

#[test]
fn an_approved_call_that_fails_changes_nothing_and_stands_as_failed() {
    for (text, wanted) in [("refuse", Code::Refused), ("panic", Code::ChaincodePanic)] {
        let mut network = Network::new(2, 1);
        let boss = deputy(&network, 1, "Boss");
        let id = waiting(network.admin(1, "propose", &[&agree(text)]));
        let arm = network.sign_for("listener", &boss, "arm", &[]);
        network.block(&[&arm]).remove(0).unwrap();
        assert_eq!(failed(network.admin(2, "approve", &[&id])), wanted);
        assert_eq!(network.event_names(), ["approved", "failed"], "no event of the call");
        assert_eq!(network.agreed(), "", "nothing that it wrote");
        let height = network.ledger.tip().height;
        let standing: Vec<Decision> = network.query("proposals", &[]);
        let failure = standing[0].proposal.as_ref().unwrap().failed.unwrap();
        assert_eq!((failure.code, failure.height), (wanted.number(), height));
        assert_eq!(code(&network.admin(2, "approve", &[&id])), Code::NotFound, "it is over");
        network.admin(1, "withdraw", &[&id]).unwrap();
    }
}

#[test]
fn withdrawing_takes_back_what_any_admin_of_the_organisation_agreed_to() {
    let mut network = Network::new(4, 1);
    let boss = deputy(&network, 2, "Boss");
    let id = waiting(network.admin(1, "propose", &[&agree("yes")]));
    waiting(network.call(&boss, "approve", &[&id]));
    network.admin(2, "withdraw", &[&id]).unwrap();
    assert_eq!(waiting(network.admin(3, "approve", &[&id])), id, "two of four");
    assert!(is_executed(network.call(&boss, "approve", &[&id])), "they may agree again");
}

#[test]
fn one_organisation_cannot_fill_a_proposal_with_its_admins() {
    let mut network = Network::new(2, 1);
    let rule = quorum("listener", "agree", "organisations = all");
    let id = waiting(network.admin(1, "set_quorum", &[&rule]));
    assert!(is_executed(network.admin(2, "approve", &[&id])));
    let id = waiting(network.admin(1, "propose", &[&agree("yes")]));
    for number in 1..16 {
        let admin = deputy(&network, 1, &format!("admin{number}"));
        assert_eq!(waiting(network.call(&admin, "approve", &[&id])), id);
    }
    let more = deputy(&network, 1, "more");
    assert_eq!(code(&network.call(&more, "approve", &[&id])), Code::LimitExceeded);
    assert!(is_executed(network.admin(2, "approve", &[&id])));
}

#[test]
fn a_failed_proposal_ends_with_the_time_of_a_proposal() {
    let mut network = Network::new(2, 1);
    let boss = deputy(&network, 1, "Boss");
    let id = waiting(network.admin(1, "propose", &[&agree("refuse")]));
    let arm = network.sign_for("listener", &boss, "arm", &[]);
    network.block(&[&arm]).remove(0).unwrap();
    assert_eq!(failed(network.admin(2, "approve", &[&id])), Code::Refused);
    network.time += 8 * DAY;
    assert!(network.query::<Vec<Decision>>("proposals", &[]).is_empty());
}
