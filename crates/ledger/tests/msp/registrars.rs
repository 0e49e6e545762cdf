//! Registrars of departments, names that may be taken for each other, and attributes that change.

use crate::world::{DAY, Network, User, code, json};
use bytes::Bytes;
use ledger::msp::{IdentityRecord, SetRegistrar};
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::key::KeyKind;
use serde_json::{Value, json as value};

fn secret() -> Hash {
    Hash::of(&[b"secret"])
}

fn registration(network: &Network, name: &str, more: &Value) -> String {
    let mut argument = value!({"name": name, "secret": secret(), "expires": network.time + DAY});
    for (key, more) in more.as_object().unwrap() {
        argument[key] = more.clone();
    }
    argument.to_string()
}

fn register(network: &mut Network, by: &User, name: &str, more: &Value) -> Result<Bytes, Rejection> {
    let argument = registration(network, name, more);
    network.call(by, "register", &[&argument])
}

fn by_admin(network: &mut Network, name: &str, more: &Value) -> Result<Bytes, Rejection> {
    let argument = registration(network, name, more);
    network.admin(1, "register", &[&argument])
}

fn in_department(department: &str) -> Value {
    value!({"attributes": {"hf.Affiliation": department}})
}

/// A network whose Org1 has a registrar of `sales` who may give `Husky`, and its CA at its node.
fn with_registrar() -> (Network, User) {
    let mut network = Network::new(2, 2);
    let carry = network.carry(0, "Org1", "Org1/node1");
    network.node(1, "carry_ca", &[&serde_json::to_string(&carry).unwrap()]).unwrap();
    let set = r#"{"name":"Farhad","affiliation":"sales","attributes":["Husky"]}"#;
    network.admin(1, "set_registrar", &[set]).unwrap();
    assert_eq!(network.event_names(), ["registrar_set"]);
    let farhad = network.cas[0].user("Farhad", "member", KeyKind::Ed25519);
    (network, farhad)
}

#[test]
fn a_registrar_registers_members_of_its_department_with_its_attributes_and_nothing_else() {
    let (mut network, farhad) = with_registrar();
    let registered: IdentityRecord = json(register(&mut network, &farhad, "Nadia", &in_department("sales")));
    assert_eq!((registered.by.as_str(), registered.role), ("Org1/Farhad", ledger_identity::Role::Member));
    let husky = value!({"attributes": {"hf.Affiliation": "sales.north", "Husky": "true"}});
    register(&mut network, &farhad, "Omar", &husky).unwrap();
    for beyond in [
        value!({}),
        in_department("salesmen"),
        in_department("finance"),
        in_department("sale"),
        value!({"role": "admin", "attributes": {"hf.Affiliation": "sales"}}),
        value!({"role": "node", "attributes": {"hf.Affiliation": "sales"}}),
        value!({"role": "robot", "attributes": {"hf.Affiliation": "sales"}}),
        value!({"attributes": {"hf.Affiliation": "sales", "Turtlebot4": "true"}}),
        value!({"attributes": {"Husky": "true"}}),
    ] {
        let refused = register(&mut network, &farhad, "Lena", &beyond);
        assert_eq!(code(&refused), Code::NotAdmin, "{beyond}");
    }
    let other = network.cas[0].user("Salma", "member", KeyKind::Ed25519);
    assert_eq!(code(&register(&mut network, &other, "Lena", &in_department("sales"))), Code::NotAdmin);
    let namesake = network.cas[1].user("Farhad", "member", KeyKind::Ed25519);
    assert_eq!(code(&register(&mut network, &namesake, "Lena", &in_department("sales"))), Code::NotAdmin, "of Org2");
    for function in ["set_registrar", "revoke_identity"] {
        assert_eq!(code(&network.call(&farhad, function, &[r#"{"name":"Nadia"}"#])), Code::NotAdmin, "{function}");
    }
}

#[test]
fn a_registrar_gives_no_secret_of_a_name_that_has_more_or_was_revoked_and_cancels_only_its_own() {
    let (mut network, farhad) = with_registrar();
    let more = value!({"attributes": {"hf.Affiliation": "sales", "Turtlebot4": "true"}});
    by_admin(&mut network, "Lena", &more).unwrap();
    let again = value!({"again": true});
    assert_eq!(code(&register(&mut network, &farhad, "Lena", &again)), Code::NotAdmin, "she has more");
    assert_eq!(code(&network.call(&farhad, "cancel_registration", &[r#"{"name":"Lena"}"#])), Code::NotAdmin);
    register(&mut network, &farhad, "Nadia", &in_department("sales")).unwrap();
    register(&mut network, &farhad, "Nadia", &again).unwrap();
    let wider = value!({"again": true, "attributes": {"hf.Affiliation": "finance"}});
    assert_eq!(code(&register(&mut network, &farhad, "Nadia", &wider)), Code::NotAdmin);
    network.call(&farhad, "cancel_registration", &[r#"{"name":"Nadia"}"#]).unwrap();
    // A name that had a certificate and was revoked.
    register(&mut network, &farhad, "Omar", &in_department("sales")).unwrap();
    let omar = enrol(&mut network, "Omar", &[("hf.Affiliation", "sales")]);
    network.admin(1, "revoke_identity", &[r#"{"name":"Omar"}"#]).unwrap();
    assert_eq!(code(&register(&mut network, &farhad, "Omar", &again)), Code::NotAdmin);
    assert_eq!(code(&by_admin(&mut network, "Omar", &value!({}))), Code::AlreadyRegistered, "not by accident");
    by_admin(&mut network, "Omar", &again).unwrap();
    assert_eq!(code(&network.call(&omar, "withdraw", &["00000000"])), Code::Revoked);
}

#[test]
fn a_registrar_becomes_nobody_whom_it_has_not_registered_and_no_other_registrar() {
    let (mut network, farhad) = with_registrar();
    let again = value!({"again": true});
    by_admin(&mut network, "Salma", &in_department("sales")).unwrap();
    let refused = register(&mut network, &farhad, "Salma", &again);
    assert_eq!(code(&refused), Code::NotAdmin);
    let refused = refused.unwrap_err();
    assert!(refused.found.contains("Org1/Salma, registered by Org1/Admin"), "{refused}");
    // One of its own whom an admin has made a registrar of more.
    register(&mut network, &farhad, "Bob", &in_department("sales")).unwrap();
    register(&mut network, &farhad, "Bob", &again).unwrap();
    network.admin(1, "set_registrar", &[r#"{"name":"Bob","affiliation":"ops","attributes":["Husky"]}"#]).unwrap();
    assert_eq!(code(&register(&mut network, &farhad, "Bob", &again)), Code::NotAdmin);
    network.admin(1, "set_registrar", &[r#"{"name":"Bob"}"#]).unwrap();
    register(&mut network, &farhad, "Bob", &again).unwrap();
}

#[test]
fn the_right_of_a_registrar_ends_by_an_admins_word_and_with_its_name() {
    let (mut network, farhad) = with_registrar();
    let known: Vec<SetRegistrar> = network.query("registrars", &[]);
    assert_eq!((known.len(), known[0].name.as_str()), (1, "Farhad"));
    network.admin(1, "set_registrar", &[r#"{"name":"Farhad"}"#]).unwrap();
    assert_eq!(code(&register(&mut network, &farhad, "Lena", &in_department("sales"))), Code::NotAdmin);
    by_admin(&mut network, "Sara", &value!({})).unwrap();
    network.admin(1, "set_registrar", &[r#"{"name":"Sara","affiliation":"sales"}"#]).unwrap();
    network.admin(1, "cancel_registration", &[r#"{"name":"Sara"}"#]).unwrap();
    assert!(network.query::<Vec<SetRegistrar>>("registrars", &[]).is_empty());
    for bad in [
        r#"{"name":"","affiliation":"sales"}"#.to_owned(),
        r#"{"name":"a/b","affiliation":"sales"}"#.to_owned(),
        r#"{"name":"Sara","affiliation":"a\u001bb"}"#.to_owned(),
        r#"{"name":"Sara","affiliation":"sales","attributes":["hf.Affiliation"]}"#.to_owned(),
        format!(r#"{{"name":"Sara","affiliation":"{}"}}"#, "x".repeat(129)),
    ] {
        assert_eq!(code(&network.admin(1, "set_registrar", &[&bad])), Code::BadArgument, "{bad}");
    }
    for number in 0..64 {
        let set = format!(r#"{{"name":"R{number}","affiliation":"sales"}}"#);
        network.admin(1, "set_registrar", &[&set]).unwrap();
    }
    let more = r#"{"name":"R64","affiliation":"sales"}"#;
    assert_eq!(code(&network.admin(1, "set_registrar", &[more])), Code::LimitExceeded);
}

#[test]
fn a_registrar_registers_no_name_that_an_admin_has_made_a_registrar_before() {
    let (mut network, farhad) = with_registrar();
    network.admin(1, "set_registrar", &[r#"{"name":"Bob","affiliation":"ops","attributes":["Husky"]}"#]).unwrap();
    let refused = register(&mut network, &farhad, "Bob", &in_department("sales"));
    assert_eq!(code(&refused), Code::NotAdmin);
    assert!(refused.unwrap_err().found.contains("Org1/Bob, who is a registrar"));
    by_admin(&mut network, "Bob", &in_department("ops")).unwrap();
}

#[test]
fn a_secret_is_worth_nothing_once_its_maker_has_lost_the_right_by_which_it_was_made() {
    let (mut network, farhad) = with_registrar();
    let sales = [("hf.Affiliation", "sales")];
    register(&mut network, &farhad, "Nadia", &in_department("sales")).unwrap();
    for set in [r#"{"name":"Farhad"}"#, r#"{"name":"Farhad","affiliation":"finance"}"#] {
        network.admin(1, "set_registrar", &[set]).unwrap();
        assert_eq!(code(&try_enrol(&mut network, "Nadia", &sales).1), Code::EnrolmentRefused, "{set}");
    }
    network.admin(1, "set_registrar", &[r#"{"name":"Farhad","affiliation":"sales"}"#]).unwrap();
    enrol(&mut network, "Nadia", &sales);

    let boss = network.cas[0].user("Boss", "admin", KeyKind::Ed25519);
    for (maker, name) in [(&farhad, "Omar"), (&boss, "Lena")] {
        register(&mut network, maker, name, &in_department("sales")).unwrap();
        revoke(&mut network, maker);
        let refused = try_enrol(&mut network, name, &sales).1;
        assert_eq!(code(&refused), Code::EnrolmentRefused, "{name}");
        assert!(refused.unwrap_err().found.contains("was revoked"), "{name}");
    }
    by_admin(&mut network, "Lena", &value!({"again": true})).unwrap();
    enrol(&mut network, "Lena", &sales);
}

#[test]
fn who_cancels_a_secret_of_an_enrolled_name_ends_neither_its_right_nor_its_certificates() {
    let (mut network, farhad) = with_registrar();
    let again = value!({"again": true});
    register(&mut network, &farhad, "Nadia", &in_department("sales")).unwrap();
    enrol(&mut network, "Nadia", &[("hf.Affiliation", "sales")]);
    register(&mut network, &farhad, "Nadia", &again).unwrap();
    network.admin(1, "set_registrar", &[r#"{"name":"Nadia","affiliation":"ops"}"#]).unwrap();
    network.call(&farhad, "cancel_registration", &[r#"{"name":"Nadia"}"#]).unwrap();
    let registrars = |network: &Network| {
        let known: Vec<SetRegistrar> = network.query("registrars", &[]);
        known.into_iter().map(|known| known.name).collect::<Vec<_>>()
    };
    assert_eq!(registrars(&network), ["Farhad", "Nadia"]);
    network.admin(1, "set_registrar", &[r#"{"name":"Nadia"}"#]).unwrap();
    register(&mut network, &farhad, "Nadia", &again).unwrap();
    network.admin(1, "set_registrar", &[r#"{"name":"Nadia","affiliation":"ops"}"#]).unwrap();
    network.admin(1, "revoke_identity", &[r#"{"name":"Nadia"}"#]).unwrap();
    assert_eq!(registrars(&network), ["Farhad"], "who is revoked is no registrar any more");
}

/// The certificate of somebody is revoked.
fn revoke(network: &mut Network, user: &User) {
    let identity = network.ledger.msps().verify(&user.certificate, &[], network.time).unwrap();
    network.admin(1, "revoke", &[&hex::encode(identity.issuer), &hex::encode(&identity.serial)]).unwrap();
}

/// Somebody enrols with a secret and these attributes.
fn enrol(network: &mut Network, name: &str, attributes: &[(&str, &str)]) -> User {
    let (user, answer) = try_enrol(network, name, attributes);
    answer.unwrap();
    user
}

/// The same, and the answer.
fn try_enrol(network: &mut Network, name: &str, attributes: &[(&str, &str)]) -> (User, Result<Bytes, Rejection>) {
    let map = attributes.iter().map(|(name, value)| ((*name).to_owned(), (*value).to_owned())).collect();
    let json = ledger_identity::certificate::encode_attributes(&map).unwrap();
    let user = network.cas[0].user_as([name, "member"], KeyKind::Ed25519, |params| {
        let oid = ledger_identity::certificate::ATTRIBUTES_OID;
        params.custom_extensions.push(rcgen::CustomExtension::from_oid_content(oid, json));
    });
    let argument = value!({
        "organisation": "Org1", "certificate": hex::encode(&user.certificate), "ground": {"secret": secret()},
    });
    let answer = network.node(1, "record_certificate", &[&argument.to_string()]);
    (user, answer)
}

#[test]
fn enrolling_with_other_attributes_revokes_the_certificates_before_in_that_block_and_with_the_same_ones_it_does_not() {
    let (mut network, _) = with_registrar();
    let husky = value!({"attributes": {"Husky": "true"}});
    by_admin(&mut network, "Salma", &husky).unwrap();
    let first = enrol(&mut network, "Salma", &[("Husky", "true")]);
    by_admin(&mut network, "Salma", &value!({"again": true})).unwrap();
    let second = enrol(&mut network, "Salma", &[("Husky", "true")]);
    assert_eq!(network.event_names(), ["certified"]);
    let other = value!({"again": true, "attributes": {"Turtlebot4": "true"}});
    by_admin(&mut network, "Salma", &other).unwrap();
    for user in [&first, &second] {
        assert_eq!(code(&network.call(user, "withdraw", &["00000000"])), Code::NotAdmin, "until she has enrolled");
    }
    let third = enrol(&mut network, "Salma", &[("Turtlebot4", "true")]);
    assert_eq!(network.event_names(), ["revoked", "revoked", "certified"]);
    for user in [&first, &second] {
        assert_eq!(code(&network.call(user, "withdraw", &["00000000"])), Code::Revoked);
    }
    assert_eq!(code(&network.call(&third, "withdraw", &["00000000"])), Code::NotAdmin);
}

#[test]
fn a_name_that_may_be_taken_for_another_one_is_refused_whatever_the_case_of_its_letters() {
    let (mut network, _) = with_registrar();
    by_admin(&mut network, "Ivan", &value!({})).unwrap();
    for alike in ["ivan", "IVAN", "lvan", "1van"] {
        let refused = by_admin(&mut network, alike, &value!({}));
        assert_eq!(code(&refused), Code::AlreadyRegistered, "{alike}");
        assert!(refused.unwrap_err().found.contains("Ivan"));
    }
    network.admin(1, "cancel_registration", &[r#"{"name":"Ivan"}"#]).unwrap();
    by_admin(&mut network, "ivan", &value!({})).unwrap();
    by_admin(&mut network, "lvan", &value!({})).unwrap();
}
