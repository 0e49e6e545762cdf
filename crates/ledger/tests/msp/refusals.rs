use crate::world::{Network, START, code};
use ledger::msp::{REFUSALS_BYTES_MAX, REFUSALS_MAX, Refused, TellRefusals};
use ledger_base::hash::Hash;
use ledger_base::rejection::Code;
use ledger_identity::key::KeyKind;
use ledger_storage::result::Event;

fn line(who: &str) -> Refused {
    Refused {
        who: who.into(),
        chaincode: "abac".into(),
        function: "acquire".into(),
        subject: "Turtlebot4/cmd_vel".into(),
        code: 3001,
        count: 7,
        first: START,
        last: START + 5,
        sample: Some(Hash([9; 32])),
        why: "Org1/Farhad may not acquire it (policies of Org2, version 3)".into(),
        found: String::new(),
    }
}

fn told(refusals: Vec<Refused>) -> String {
    serde_json::to_string(&TellRefusals { refusals }).unwrap()
}

#[test]
fn a_node_tells_what_it_refused_and_only_admins_and_nodes_read_it() {
    let mut network = Network::new(2, 2);
    let said = told(vec![line("Org1/Farhad"), Refused { code: 0, ..line("") }]);
    network.node(2, "tell_refusals", &[&said]).unwrap();
    let event = network.events[0].clone();
    assert_eq!((event.name.as_str(), &event.payload[..]), ("refused", said.as_bytes()));
    let member = network.cas[0].user("Salma", "member", KeyKind::Ed25519);
    let may = |der: &bytes::Bytes, event: &Event| {
        let reader = network.ledger.msps().verify(der, &[], network.time).unwrap();
        let follows = network.ledger.may_follow(&reader, "msp", &[], &["refused".to_owned()]).is_ok();
        (network.ledger.may_read(&reader, event).is_ok(), follows)
    };
    assert_eq!(may(&network.admins[0].certificate, &event), (true, true));
    assert_eq!(may(&network.nodes[0].certificate, &event), (true, true));
    assert_eq!(may(&member.certificate, &event), (false, false));
    let other = Event { name: "joined".into(), ..event };
    assert!(may(&member.certificate, &other).0, "other events are for all");
}

#[test]
fn nobody_but_a_node_of_the_network_tells_refusals() {
    let mut network = Network::new(2, 2);
    let said = told(vec![line("Org1/Farhad")]);
    assert_eq!(code(&network.admin(1, "tell_refusals", &[&said])), Code::WrongRole);
    let stranger = network.cas[0].user("edge", "node", KeyKind::Ed25519);
    assert_eq!(code(&network.call(&stranger, "tell_refusals", &[&said])), Code::NotAMember);
}

#[test]
fn a_node_tells_at_most_once_in_a_second_and_another_one_beside_it() {
    let mut network = Network::new(2, 2);
    let said = told(vec![line("Org1/Farhad")]);
    let nodes = std::mem::take(&mut network.nodes);
    let calls = [&nodes[0], &nodes[0], &nodes[1]].map(|node| network.sign(node, "tell_refusals", &[&said]));
    let verdicts = network.block(&calls.each_ref());
    assert_eq!(verdicts.iter().map(code).collect::<Vec<_>>(), [Code::Ok, Code::LimitExceeded, Code::Ok]);
    assert!(network.call(&nodes[0], "tell_refusals", &[&said]).is_ok(), "a second later");
}

#[test]
fn lines_that_are_too_many_too_long_or_cannot_be_are_refused() {
    let mut network = Network::new(1, 1);
    let many = |count: usize| told((0..count).map(|number| line(&format!("Org1/P{number}"))).collect());
    for (said, wanted) in [
        (many(0), Code::BadArgument),
        (many(REFUSALS_MAX + 1), Code::BadArgument),
        (" ".repeat(REFUSALS_BYTES_MAX + 1), Code::TooLarge),
        (told(vec![Refused { count: 0, ..line("a") }]), Code::BadArgument),
        (told(vec![Refused { first: 9, last: 8, ..line("a") }]), Code::BadArgument),
        (told(vec![Refused { why: "a\u{1b}[2J".into(), ..line("a") }]), Code::BadArgument),
        (told(vec![Refused { subject: "x".repeat(257), ..line("a") }]), Code::BadArgument),
        (many(1).replace("\"code\"", "\"colour\":1,\"code\""), Code::BadArgument),
        (many(REFUSALS_MAX), Code::Ok),
    ] {
        assert_eq!(code(&network.node(1, "tell_refusals", &[&said])), wanted, "{}", said.get(..99).unwrap_or(&said));
    }
}

#[test]
fn a_node_that_is_removed_leaves_nothing_behind() {
    let mut network = Network::new(2, 2);
    let keys = |network: &Network| {
        let world = network.ledger.state().world(None, 1000).unwrap();
        world.iter().filter(|(key, _)| key.starts_with(b"msp\0told/")).count()
    };
    network.node(2, "tell_refusals", &[&told(vec![line("Org1/Farhad")])]).unwrap();
    assert_eq!(keys(&network), 1);
    network.admin(2, "set_node_role", &[r#"{"id":2,"role":"removed"}"#]).unwrap();
    assert_eq!(keys(&network), 0);
}
