//! How much of what the network stores one organisation may fill.

use crate::world::{Network, code, is_executed, waiting};
use ledger::msp::{QUOTAS, Quotas};
use ledger_base::hash::Hash;
use ledger_base::rejection::Code;
use ledger_identity::key::KeyKind;

fn register(network: &mut Network, organisation: usize, name: &str) -> Code {
    let expires = network.time + 3_600_000_000;
    let secret = Hash::of(&[name.as_bytes()]);
    let argument = format!(r#"{{"name":"{name}","role":"member","secret":"{secret}","expires":{expires}}}"#);
    code(&network.admin(organisation, "register", &[&argument]))
}

#[test]
fn an_organisation_that_fills_its_quota_keeps_no_other_from_adding() {
    let mut network = Network::new(3, 3);
    assert_eq!(network.query::<Quotas>("quotas", &["Org1"]), QUOTAS);
    let set = r#"{"organisation":"Org1","identities":3}"#;
    waiting(network.admin(1, "set_quota", &[set]));
    assert!(is_executed(network.admin(2, "set_quota", &[set])), "the same call is an approval");
    assert!(network.event_names().contains(&"quota_changed"));
    assert_eq!(network.query::<Quotas>("quotas", &["Org1"]), Quotas { identities: 3, ..QUOTAS });
    for name in ["Salma", "Farhad", "Nadia"] {
        assert_eq!(register(&mut network, 1, name), Code::Ok);
    }
    let expires = network.time + 3_600_000_000;
    let late = format!(r#"{{"name":"Omar","role":"member","secret":"{}","expires":{expires}}}"#, Hash::ZERO);
    let refused = network.admin(1, "register", &[&late]).unwrap_err();
    assert_eq!(refused.code, Code::QuotaReached);
    assert!(refused.found.contains("3 identities") && refused.advice().contains("set_quota"), "{refused}");
    assert_eq!(register(&mut network, 2, "Omar"), Code::Ok);
    // Room comes from what nobody uses.
    network.admin(1, "cancel_registration", &[r#"{"name":"Nadia"}"#]).unwrap();
    assert_eq!(register(&mut network, 1, "Omar"), Code::Ok);
}

#[test]
fn a_quota_is_set_by_approval_for_an_organisation_of_the_network_and_within_bounds() {
    let mut network = Network::new(3, 3);
    let member = network.cas[0].user("Salma", "member", KeyKind::Ed25519);
    assert_eq!(code(&network.call(&member, "set_quota", &[r#"{"organisation":"Org1"}"#])), Code::NotAdmin);
    for (argument, wanted) in [
        (r#"{"organisation":"Org9","robots":1}"#, Code::NotFound),
        (r#"{"organisation":"Org1","robots":1025}"#, Code::BadArgument),
        (r#"{"organisation":"Org1","policies":65}"#, Code::BadArgument),
        (r#"{"organisation":"Org1","walls":1}"#, Code::BadArgument),
        (r#"{"organisation":"Org1","identity_bytes_per_s":1073741825}"#, Code::BadArgument),
        (r#"{"organisation":"Org1","service_messages_per_s":0}"#, Code::BadArgument),
    ] {
        assert_eq!(code(&network.admin(1, "set_quota", &[argument])), wanted, "{argument}");
    }
}

#[test]
fn an_organisation_raises_its_rates_only_with_the_approval_of_others() {
    let mut network = Network::new(3, 3);
    let set = r#"{"organisation":"Org1","bytes_per_s":100000000,"identity_messages_per_s":50000}"#;
    waiting(network.admin(1, "set_quota", &[set]));
    assert_eq!(network.query::<Quotas>("quotas", &["Org1"]), QUOTAS, "one organisation alone raises nothing");
    assert!(is_executed(network.admin(2, "set_quota", &[set])));
    let raised = Quotas { bytes_per_s: 100_000_000, identity_messages_per_s: 50_000, ..QUOTAS };
    assert_eq!(network.query::<Quotas>("quotas", &["Org1"]), raised);
    assert_eq!(network.query::<Quotas>("quotas", &["Org2"]), QUOTAS, "of others nothing changes");
}
