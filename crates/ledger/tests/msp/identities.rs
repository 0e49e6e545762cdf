use crate::world::{DAY, Network, SECOND, User, code, json};
use bytes::Bytes;
use ledger::msp::{
    CarrierRecord, CarryCa, ENROLMENT_REPEAT_MAX, IdentityRecord, KnownIdentity, LocalSecret, RENEWAL_PAUSE, Recorded,
    RevokedIdentity,
};
use ledger::{PAGE_MAX, Page};
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::Role;
use ledger_identity::key::KeyKind;
use serde_json::json as value;

/// The secret that everybody has here.
fn secret() -> Hash {
    Hash::of(&[b"secret"])
}

fn register(network: &mut Network, organisation: usize, name: &str, more: &str) -> Result<Bytes, Rejection> {
    let expires = network.time + DAY;
    let argument = format!(r#"{{"name":"{name}","secret":"{}","expires":{expires}{more}}}"#, secret());
    network.admin(organisation, "register", &[&argument])
}

/// A node of Org1 that carries its CA.
fn carried() -> Network {
    let mut network = Network::new(2, 2);
    let carry = network.carry(0, "Org1", "Org1/node1");
    network.node(1, "carry_ca", &[&serde_json::to_string(&carry).unwrap()]).unwrap();
    network
}

fn record_by(network: &mut Network, node: usize, user: &User, ground: &serde_json::Value) -> Result<Bytes, Rejection> {
    let argument = value!({
        "organisation": "Org1", "certificate": hex::encode(&user.certificate), "ground": ground,
    });
    network.node(node, "record_certificate", &[&argument.to_string()])
}

fn by_secret(network: &mut Network, user: &User) -> Result<Bytes, Rejection> {
    record_by(network, 1, user, &value!({ "secret": secret() }))
}

fn renewed(network: &mut Network, user: &User) -> Result<Bytes, Rejection> {
    record_by(network, 1, user, &value!("renewal"))
}

fn one(network: &Network, name: &str) -> Option<IdentityRecord> {
    network.query::<Page<_>>("identities", &[&value!({ "name": name }).to_string()]).items.pop()
}

fn certificate(answer: Result<Bytes, Rejection>) -> Bytes {
    hex::decode(json::<Recorded>(answer).certificate).unwrap().into()
}

fn member(network: &Network, name: &str) -> User {
    network.cas[0].user(name, "member", KeyKind::Ed25519)
}

#[test]
fn a_name_is_registered_once_and_a_name_that_no_context_may_have_never() {
    let mut network = carried();
    let more = r#","role":"member","attributes":{"Husky":"true"}"#;
    let registered: IdentityRecord = json(register(&mut network, 1, "Salma", more));
    assert_eq!(
        (registered.id().as_str(), registered.role, registered.by.as_str()),
        ("Org1/Salma", Role::Member, "Org1/Admin")
    );
    assert_eq!(registered.secret.unwrap().sha256, Hash::ZERO, "nobody reads the hash");
    assert_eq!(code(&register(&mut network, 1, "Salma", more)), Code::AlreadyRegistered);
    for name in ["Sal ma", "", ".salma", "-salma", "a/b", "sal\\u0000ma", &"x".repeat(65)] {
        assert_eq!(code(&register(&mut network, 1, name, more)), Code::BadArgument, "{name}");
    }
    assert_eq!(code(&register(&mut network, 1, "Farhad", r#","again":true"#)), Code::NotFound);
    // Another organisation has names of its own, and does not see these.
    json::<IdentityRecord>(register(&mut network, 2, "Salma", ""));
    let [reader, node] =
        [(2, "admin"), (1, "node")].map(|(org, role)| network.cas[org - 1].user("Reader", role, KeyKind::P256));
    let listed: Vec<IdentityRecord> = json(network.ask(&reader, "identities", &[]));
    assert_eq!(listed.iter().map(IdentityRecord::id).collect::<Vec<_>>(), ["Org2/Salma"]);
    assert_eq!(code(&network.ask(&node, "identities", &["{}"])), Code::NotAdmin);
    for expires in [network.time, network.time + 400 * DAY] {
        let argument = format!(r#"{{"name":"Late","secret":"{}","expires":{expires}}}"#, secret());
        assert_eq!(code(&network.admin(1, "register", &[&argument])), Code::BadArgument);
    }
}

#[test]
fn a_long_list_comes_in_pages() {
    let mut network = carried();
    for number in 0..450 {
        register(&mut network, 1, &format!("user{number:03}"), "").unwrap();
    }
    let (mut names, mut after) = (Vec::new(), None::<String>);
    loop {
        let argument = after.map_or_else(|| "{}".into(), |after| value!({ "after": after }).to_string());
        let page: Page<IdentityRecord> = network.query("identities", &[&argument]);
        assert!(page.items.len() <= PAGE_MAX, "{}", page.items.len());
        names.extend(page.items.into_iter().map(|record| record.name));
        after = page.next;
        if after.is_none() {
            break;
        }
    }
    assert_eq!(names.len(), 450);
    let refused = network.ask(&network.admins[0], "identities", &[]);
    assert!(code(&refused) == Code::OverBudget && refused.unwrap_err().advice().contains("{}"));
    assert!(names.is_sorted());
}

#[test]
fn a_secret_is_taken_by_the_first_key_and_the_same_key_receives_the_same_certificate_for_some_minutes() {
    let mut network = carried();
    register(&mut network, 1, "Salma", "").unwrap();
    let (first, other) = (member(&network, "Salma"), member(&network, "Salma"));
    assert_eq!(certificate(by_secret(&mut network, &first)), first.certificate);
    assert_eq!(network.event_names(), ["certified"]);
    assert_eq!(code(&by_secret(&mut network, &other)), Code::EnrolmentRefused);
    // Another carrier has signed another certificate for the same key: the first one counts.
    let again = network.cas[0].certify("Salma", "member", &first);
    assert_ne!(again.certificate, first.certificate);
    assert_eq!(certificate(by_secret(&mut network, &again)), first.certificate);
    let later = network.cas[0].certify("Salma", "member", &first);
    network.time += ENROLMENT_REPEAT_MAX;
    assert_eq!(code(&by_secret(&mut network, &later)), Code::EnrolmentRefused);
    assert_eq!(one(&network, "Salma").unwrap().certificates.len(), 1);
}

#[test]
fn a_secret_is_void_once_its_certificate_was_revoked_or_has_signed_something() {
    let mut network = carried();
    for name in ["Salma", "Farhad"] {
        register(&mut network, 1, name, "").unwrap();
    }
    let (salma, farhad) = (member(&network, "Salma"), member(&network, "Farhad"));
    by_secret(&mut network, &salma).unwrap();
    by_secret(&mut network, &farhad).unwrap();
    let revoked: RevokedIdentity = json(network.admin(1, "revoke_identity", &[r#"{"name":"Salma"}"#]));
    assert_eq!((revoked.certificates.len(), revoked.cancelled), (1, false));
    assert_eq!(code(&by_secret(&mut network, &salma)), Code::EnrolmentRefused, "not even the same certificate");
    let again = network.cas[0].certify("Salma", "member", &salma);
    assert_eq!(code(&by_secret(&mut network, &again)), Code::EnrolmentRefused);
    assert_eq!(code(&renewed(&mut network, &again)), Code::Revoked);
    // An admin who registers the name anew is another matter.
    register(&mut network, 1, "Salma", r#","again":true"#).unwrap();
    by_secret(&mut network, &again).unwrap();

    assert_eq!(code(&network.call(&farhad, "nodes", &[])), Code::QueryOnly, "the certificate counts");
    let again = network.cas[0].certify("Farhad", "member", &farhad);
    assert_eq!(code(&by_secret(&mut network, &again)), Code::EnrolmentRefused);
}

#[test]
fn by_serial_a_revocation_voids_what_its_secret_would_give_again() {
    let mut network = carried();
    register(&mut network, 1, "Salma", "").unwrap();
    let salma = member(&network, "Salma");
    by_secret(&mut network, &salma).unwrap();
    let issued = one(&network, "Salma").unwrap().certificates[0].clone();
    network.admin(1, "revoke", &[&issued.issuer.to_string(), &issued.serial]).unwrap();
    assert!(one(&network, "Salma").unwrap().certificates[0].revoked);
    let again = network.cas[0].certify("Salma", "member", &salma);
    assert_eq!(code(&by_secret(&mut network, &again)), Code::EnrolmentRefused);
}

#[test]
fn a_registration_is_cancelled_and_ends_in_block_time() {
    let mut network = carried();
    for name in ["Salma", "Farhad"] {
        register(&mut network, 1, name, "").unwrap();
    }
    assert!(one(&network, "Salma").unwrap().pending(network.time).is_some());
    assert_eq!(code(&network.admin(2, "cancel_registration", &[r#"{"name":"Salma"}"#])), Code::NotFound);
    network.admin(1, "cancel_registration", &[r#"{"name":"Salma"}"#]).unwrap();
    assert_eq!(one(&network, "Salma"), None, "it never had a certificate");
    let salma = member(&network, "Salma");
    assert_eq!(code(&by_secret(&mut network, &salma)), Code::NotFound);
    // Revoking does it as well.
    let revoked: RevokedIdentity = json(network.admin(1, "revoke_identity", &[r#"{"name":"Farhad"}"#]));
    assert!(revoked.cancelled && revoked.certificates.is_empty());
    assert_eq!(code(&network.admin(1, "revoke_identity", &[r#"{"name":"Farhad"}"#])), Code::NotFound);

    register(&mut network, 1, "Salma", "").unwrap();
    network.time += 2 * DAY;
    assert_eq!(code(&by_secret(&mut network, &salma)), Code::EnrolmentRefused);
    network.admin(1, "cancel_registration", &[r#"{"name":"Salma"}"#]).unwrap();
    assert_eq!(one(&network, "Salma"), None, "a secret that has ended holds no name");
}

#[test]
fn a_revoked_name_that_has_never_signed_anything_becomes_free_and_one_that_has_does_not() {
    let mut network = carried();
    register(&mut network, 1, "Turtlebot4", "").unwrap();
    let robot = member(&network, "Turtlebot4");
    by_secret(&mut network, &robot).unwrap();
    assert_eq!(code(&register(&mut network, 1, "turtlebot4", "")), Code::AlreadyRegistered);
    let refused = network.admin(1, "cancel_registration", &[r#"{"name":"Turtlebot4"}"#]).unwrap_err();
    assert!(refused.found.contains("a valid certificate") && refused.advice().contains("identity revoke"), "{refused}");
    network.admin(1, "revoke_identity", &[r#"{"name":"Turtlebot4"}"#]).unwrap();
    let refused = register(&mut network, 1, "turtlebot4", "").unwrap_err();
    assert!(refused.advice().contains("ledgerctl identity cancel Turtlebot4"), "{refused}");
    network.admin(1, "cancel_registration", &[r#"{"name":"Turtlebot4"}"#]).unwrap();
    assert_eq!(one(&network, "Turtlebot4"), None);
    assert_eq!(code(&by_secret(&mut network, &robot)), Code::NotFound);
    register(&mut network, 1, "turtlebot4", "").unwrap();
    assert_eq!(code(&network.call(&robot, "nodes", &[])), Code::Revoked, "its certificate stays revoked");

    register(&mut network, 1, "Salma", "").unwrap();
    let salma = member(&network, "Salma");
    by_secret(&mut network, &salma).unwrap();
    let _signed = network.call(&salma, "attest", &["{}"]);
    network.admin(1, "revoke_identity", &[r#"{"name":"Salma"}"#]).unwrap();
    let refused = network.admin(1, "cancel_registration", &[r#"{"name":"Salma"}"#]).unwrap_err();
    assert!(refused.code == Code::NotFound && refused.found.contains("signed"), "{refused}");
}

#[test]
fn a_certificate_counts_only_from_a_node_that_has_shown_the_cas_key_and_as_it_is_registered() {
    let mut network = carried();
    register(&mut network, 1, "Salma", "").unwrap();
    let salma = member(&network, "Salma");
    let ground = value!({ "secret": secret() });
    assert_eq!(code(&record_by(&mut network, 2, &salma, &ground)), Code::NotAdmin, "a node that does not hold it");
    let admin = value!({ "organisation": "Org1", "certificate": hex::encode(&salma.certificate), "ground": ground });
    assert_eq!(code(&network.admin(1, "record_certificate", &[&admin.to_string()])), Code::WrongRole);
    // Another CA, another role, a name that is not registered, another secret.
    let foreign = network.cas[1].user("Salma", "member", KeyKind::Ed25519);
    assert_eq!(code(&by_secret(&mut network, &foreign)), Code::Untrusted);
    let boss = network.cas[0].user("Salma", "admin", KeyKind::Ed25519);
    assert_eq!(code(&by_secret(&mut network, &boss)), Code::WrongRole);
    let stranger = member(&network, "Nobody");
    assert_eq!(code(&by_secret(&mut network, &stranger)), Code::NotFound);
    assert_eq!(code(&record_by(&mut network, 1, &salma, &value!({ "secret": Hash::ZERO }))), Code::EnrolmentRefused);
    let mut forged = salma.certificate.to_vec();
    *forged.last_mut().unwrap() ^= 1;
    let forged = User { certificate: forged.into(), key: member(&network, "Salma").key };
    assert_eq!(code(&by_secret(&mut network, &forged)), Code::Untrusted);
    by_secret(&mut network, &salma).unwrap();
}

#[test]
fn a_renewal_needs_a_good_certificate_and_comes_at_most_once_a_minute() {
    let mut network = carried();
    register(&mut network, 1, "Salma", "").unwrap();
    let salma = member(&network, "Salma");
    assert_eq!(code(&renewed(&mut network, &salma)), Code::Revoked, "it has none");
    by_secret(&mut network, &salma).unwrap();
    let (next, other) = (member(&network, "Salma"), member(&network, "Salma"));
    assert_eq!(code(&renewed(&mut network, &next)), Code::LimitExceeded);
    network.time += RENEWAL_PAUSE;
    assert_eq!(certificate(renewed(&mut network, &next)), next.certificate);
    // The answer was lost: the same key asks again.
    let again = network.cas[0].certify("Salma", "member", &next);
    assert_eq!(certificate(renewed(&mut network, &again)), next.certificate);
    assert_eq!(code(&renewed(&mut network, &other)), Code::LimitExceeded);
    network.admin(1, "revoke_identity", &[r#"{"name":"Salma"}"#]).unwrap();
    network.time += RENEWAL_PAUSE;
    assert_eq!(code(&renewed(&mut network, &other)), Code::Revoked);
}

#[test]
fn a_node_shows_the_cas_key_before_it_counts_as_a_carrier() {
    let mut network = Network::new(2, 2);
    let good = network.carry(0, "Org1", "Org1/node1");
    let call = |network: &mut Network, node: usize, carry: &CarryCa| {
        network.node(node, "carry_ca", &[&serde_json::to_string(carry).unwrap()])
    };
    let foreign = CarryCa { organisation: "Org1".into(), ..network.carry(1, "Org1", "Org1/node1") };
    assert_eq!(code(&call(&mut network, 1, &foreign)), Code::BadSignature);
    assert_eq!(code(&call(&mut network, 2, &good)), Code::BadSignature, "it is of another node");
    let argument = serde_json::to_string(&good).unwrap();
    assert_eq!(code(&network.admin(1, "carry_ca", &[&argument])), Code::WrongRole);
    call(&mut network, 1, &good).unwrap();
    call(&mut network, 1, &good).unwrap();
    let carriers: Vec<CarrierRecord> = network.query("carriers", &[]);
    assert_eq!(carriers.iter().map(CarrierRecord::full_name).collect::<Vec<_>>(), ["Org1/node1"]);

    let forget = r#"{"organisation":"Org1","node":"Org1/node1"}"#;
    assert_eq!(code(&network.admin(2, "uncarry_ca", &[forget])), Code::NotAdmin);
    network.admin(1, "uncarry_ca", &[forget]).unwrap();
    assert!(network.query::<Vec<CarrierRecord>>("carriers", &[]).is_empty());
    assert_eq!(code(&network.node(1, "uncarry_ca", &[r#"{"organisation":"Org1"}"#])), Code::NotFound);
    // A node that is removed carries nothing.
    let second = network.carry(1, "Org2", "Org2/node2");
    call(&mut network, 2, &second).unwrap();
    network.admin(2, "set_node_role", &[r#"{"id":2,"role":"removed"}"#]).unwrap();
    assert!(network.query::<Vec<CarrierRecord>>("carriers", &[]).is_empty());
}

#[test]
fn what_a_node_knows_from_before_the_ledger_is_listed_revoked_and_renewed_like_everything() {
    let mut network = carried();
    let old = member(&network, "Old");
    let known = network.known(&old, "Old", Role::Member);
    let pending = KnownIdentity {
        name: "admin".into(),
        role: Role::Admin,
        attributes: Default::default(),
        secret: Some(LocalSecret { at: String::new(), made: network.time, expires: network.time + DAY }),
        certificates: vec![],
    };
    let carry = CarryCa { identities: vec![known, pending], ..network.carry(0, "Org1", "Org1/node1") };
    let argument = serde_json::to_string(&carry).unwrap();
    network.node(1, "carry_ca", &[&argument]).unwrap();
    network.node(1, "carry_ca", &[&argument]).unwrap();
    assert_eq!(one(&network, "Old").unwrap().certificates.len(), 1);
    let admin = one(&network, "admin").unwrap();
    assert_eq!(admin.local.as_ref().unwrap().at, "Org1/node1");
    assert!(admin.pending(network.time).is_some());
    // It may renew at once, and be revoked anywhere.
    let next = member(&network, "Old");
    renewed(&mut network, &next).unwrap();
    let revoked: RevokedIdentity = json(network.admin(1, "revoke_identity", &[r#"{"name":"Old"}"#]));
    assert_eq!(revoked.certificates.len(), 2);
    assert_eq!(code(&network.call(&old, "nodes", &[])), Code::Revoked);
    // The secret at the node's machine is cancelled: what it made before counts no more, what it makes afterwards does.
    network.admin(1, "cancel_registration", &[r#"{"name":"admin"}"#]).unwrap();
    let boss = network.cas[0].user("admin", "admin", KeyKind::Ed25519);
    let made = network.time - 10 * SECOND;
    assert_eq!(code(&record_by(&mut network, 1, &boss, &value!({ "local": made }))), Code::EnrolmentRefused);
    network.node(1, "carry_ca", &[&argument]).unwrap();
    assert_eq!(one(&network, "admin").unwrap().local, None, "it does not come back");
    let made = network.time + 1;
    record_by(&mut network, 1, &boss, &value!({ "local": made })).unwrap();
    assert_eq!(one(&network, "admin").unwrap().certificates.len(), 1);
    let member = member(&network, "admin");
    assert_eq!(code(&record_by(&mut network, 1, &member, &value!({ "local": made }))), Code::WrongRole);
}

#[test]
fn a_name_from_before_the_ledger_is_not_looked_like_and_its_old_attributes_end_when_they_are_changed() {
    let mut network = carried();
    let (used, unused) = (member(&network, "Old"), member(&network, "Old"));
    let mut known = network.known(&used, "Old", Role::Member);
    known.certificates.extend(network.known(&unused, "Old", Role::Member).certificates);
    let carry = CarryCa { identities: vec![known], ..network.carry(0, "Org1", "Org1/node1") };
    network.node(1, "carry_ca", &[&serde_json::to_string(&carry).unwrap()]).unwrap();
    assert_eq!(code(&register(&mut network, 1, "0ld", "")), Code::AlreadyRegistered);
    assert_eq!(code(&network.call(&used, "withdraw", &["00000000"])), Code::NotAdmin);
    // Without a change all certificates stay.
    let next = member(&network, "Old");
    renewed(&mut network, &next).unwrap();
    assert_eq!(network.event_names(), ["certified"]);
    // With other attributes those go that say the old ones, and the one of which nothing is known.
    register(&mut network, 1, "Old", r#","again":true,"attributes":{"Husky":"true"}"#).unwrap();
    let json = ledger_identity::certificate::encode_attributes(&[("Husky".into(), "true".into())].into()).unwrap();
    let husky = network.cas[0].user_as(["Old", "member"], KeyKind::Ed25519, |params| {
        let oid = ledger_identity::certificate::ATTRIBUTES_OID;
        params.custom_extensions.push(rcgen::CustomExtension::from_oid_content(oid, json));
    });
    by_secret(&mut network, &husky).unwrap();
    assert_eq!(network.event_names(), ["revoked", "revoked", "revoked", "certified"]);
    for old in [&used, &unused, &next] {
        assert_eq!(code(&network.call(old, "withdraw", &["00000000"])), Code::Revoked);
    }
    assert_eq!(code(&network.call(&husky, "withdraw", &["00000000"])), Code::NotAdmin);
}

#[test]
fn an_invitation_is_listed_and_taken_back_by_who_proposed_it() {
    let mut network = Network::new(1, 1);
    let key = Hash([3; 32]);
    let invite = format!(r#"{{"name":"Beta","key":"{key}","expires":{}}}"#, network.time + DAY);
    network.admin(1, "invite_organisation", &[&invite]).unwrap();
    let listed: Vec<ledger::msp::Invitation> = network.query("invitations", &[]);
    assert_eq!((listed[0].name.as_str(), listed[0].by.as_str()), ("Beta", "Org1"));
    network.admin(1, "cancel_invitation", &[r#"{"name":"Beta"}"#]).unwrap();
    assert_eq!(network.event_names(), ["invitation_cancelled"]);
    assert!(network.query::<Vec<ledger::msp::Invitation>>("invitations", &[]).is_empty());
    assert_eq!(code(&network.admin(1, "cancel_invitation", &[r#"{"name":"Beta"}"#])), Code::NotFound);

    let mut network = Network::new(2, 2);
    let invite = format!(r#"{{"name":"Beta","key":"{key}","expires":{}}}"#, network.time + DAY);
    let id = crate::world::waiting(network.admin(1, "invite_organisation", &[&invite]));
    network.admin(2, "approve", &[&id]).unwrap();
    assert_eq!(code(&network.admin(2, "cancel_invitation", &[r#"{"name":"Beta"}"#])), Code::NotAdmin);
    network.admin(1, "cancel_invitation", &[r#"{"name":"Beta"}"#]).unwrap();
}

#[test]
fn no_admin_revokes_the_certificate_that_it_signs_with_so_the_last_one_stays() {
    let mut network = carried();
    let add = |network: &mut Network, name: &str| {
        register(network, 1, name, r#","role":"admin""#).unwrap();
        let admin = network.cas[0].user(name, "admin", KeyKind::Ed25519);
        by_secret(network, &admin).unwrap();
        admin
    };
    let (first, second) = (add(&mut network, "First"), add(&mut network, "Second"));
    let by_serial = |network: &mut Network, caller: &User, name: &str| {
        let issued = one(network, name).unwrap().certificates[0].clone();
        network.call(caller, "revoke", &[&issued.issuer.to_string(), &issued.serial])
    };
    assert_eq!(code(&network.call(&first, "revoke_identity", &[r#"{"name":"First"}"#])), Code::LastOne);
    assert_eq!(code(&by_serial(&mut network, &first, "First")), Code::LastOne);
    by_serial(&mut network, &second, "First").unwrap();
    assert_eq!(code(&by_serial(&mut network, &second, "Second")), Code::LastOne);
    assert_eq!(code(&network.call(&first, "revoke_identity", &[r#"{"name":"Second"}"#])), Code::Revoked);
}

#[test]
fn a_new_name_is_readable_and_looks_like_no_other_one_of_its_organisation() {
    let mut network = carried();
    register(&mut network, 1, "Salma", "").unwrap();
    let refused = register(&mut network, 1, "Sa1ma", "").unwrap_err();
    assert!(refused.code == Code::AlreadyRegistered && refused.found.contains("Salma"), "{refused}");
    register(&mut network, 2, "Sa1ma", "").unwrap();
    for deceiving in ["S\u{430}lma", "Salma\u{3164}", "Jo\u{308}rg"] {
        assert!([Code::BadName, Code::BadArgument].contains(&code(&register(&mut network, 1, deceiving, ""))));
    }
    register(&mut network, 1, "Jörg", "").unwrap();
    // A name that is forgotten leaves room for one that looks so.
    network.admin(1, "cancel_registration", &[r#"{"name":"Salma"}"#]).unwrap();
    register(&mut network, 1, "Sa1ma", "").unwrap();
    assert_eq!(code(&register(&mut network, 1, "Salma", "")), Code::AlreadyRegistered);
}
