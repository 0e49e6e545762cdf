use crate::world::{Ca, DAY, Network, SECOND, code, is_executed, json, waiting};
use bytes::Bytes;
use ledger::msp::{self, JoinOrganisation, NodeRole, Organisation};
use ledger::network::FoundingOrganisation;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::key::{KeyKind, SigningKey};

fn key() -> SigningKey {
    SigningKey::from_seed(&[7; 32]).unwrap()
}

fn invite(network: &Network, name: &str) -> String {
    let (key, expires) = (hex::encode(key().public_key().bytes()), network.time + DAY);
    format!(r#"{{"name":"{name}","key":"{key}","expires":{expires}}}"#)
}

fn remove(name: &str) -> String {
    format!(r#"{{"name":"{name}"}}"#)
}

fn signed(network: &Network, organisation: FoundingOrganisation) -> JoinOrganisation {
    JoinOrganisation::sign(&network.ledger.network(), organisation, "node1", "beta:7450", &key())
}

/// The request, carried by a node of Org1.
fn carry(network: &mut Network, join: &JoinOrganisation) -> Result<Bytes, Rejection> {
    network.node(1, "join_organisation", &[&serde_json::to_string(join).unwrap()])
}

/// The argument of `update_organisation`.
fn authorities(roots: &[&Ca]) -> String {
    let roots: Vec<_> = roots.iter().map(|ca| format!("{:?}", hex::encode(ca.root()))).collect();
    format!(r#"{{"roots":[{}]}}"#, roots.join(","))
}

fn names(network: &Network) -> Vec<String> {
    network.query("organisations", &[])
}

#[test]
fn an_invited_organisation_joins_and_its_node_after_it() {
    let mut network = Network::new(2, 2);
    let beta = Ca::new("beta-ca");
    let argument = invite(&network, "Beta");
    let id = waiting(network.admin(1, "invite_organisation", &[&argument]));
    let join = signed(&network, FoundingOrganisation::below("Beta", beta.root()));
    let node = beta.user("node1", "node", KeyKind::Ed25519);
    assert_eq!(code(&carry(&mut network, &join)), Code::NotInvited, "not approved yet");
    assert!(is_executed(network.admin(2, "approve", &[&id])));
    assert_eq!(network.event_names(), ["approved", "invited", "executed"]);
    assert_eq!(msp::invitation(&**network.ledger.state(), "Beta").unwrap().unwrap().name, "Beta");

    assert_eq!(code(&network.call(&node, "join_node", &[r#"{"address":"beta:7450"}"#])), Code::Untrusted);
    let answer: Organisation = json(carry(&mut network, &join));
    assert_eq!((answer.name.as_str(), answer.roots[0].fingerprint), ("Beta", Hash::of(&[&beta.root()])));
    assert_eq!(network.event_names(), ["organisation_joined"]);
    network.call(&node, "join_node", &[r#"{"address":"beta:7450"}"#]).unwrap();
    assert_eq!(network.roles()[2], (3, "Beta/node1".into(), NodeRole::Learner));

    assert_eq!(json::<Organisation>(carry(&mut network, &join)), answer, "an answer that was lost is asked for again");
    assert_eq!(names(&network), ["Beta", "Org1", "Org2"]);
    assert_eq!(network.query::<Organisation>("organisation", &["Beta"]), answer);
    assert!(msp::invitation(&**network.ledger.state(), "Beta").unwrap().is_none(), "it is used up");
}

#[test]
fn whoever_carries_a_request_cannot_change_it() {
    let mut network = Network::new(1, 1);
    let argument = invite(&network, "Beta");
    assert!(is_executed(network.admin(1, "invite_organisation", &[&argument])));
    let (beta, mallory) = (Ca::new("beta-ca"), Ca::new("beta-ca"));
    let good = signed(&network, FoundingOrganisation::below("Beta", beta.root()));
    let change = |change: &dyn Fn(&mut JoinOrganisation)| {
        let mut changed = good.clone();
        change(&mut changed);
        changed
    };
    let other_network = JoinOrganisation::sign(
        &Hash::ZERO,
        FoundingOrganisation::below("Beta", beta.root()),
        "node1",
        "beta:7450",
        &key(),
    );
    let other_key = SigningKey::from_seed(&[8; 32]).unwrap();
    let other_key = JoinOrganisation::sign(
        &network.ledger.network(),
        FoundingOrganisation::below("Beta", beta.root()),
        "node1",
        "beta:7450",
        &other_key,
    );
    for (what, join) in [
        ("roots", change(&|join| join.organisation.roots = vec![mallory.root()])),
        ("another root", change(&|join| join.organisation.roots.push(mallory.root()))),
        ("root as intermediate", change(&|join| join.organisation.intermediates = vec![mallory.root()])),
        ("node", change(&|join| join.node_name = "node2".into())),
        ("address", change(&|join| join.address = "mallory:7450".into())),
        ("name", change(&|join| join.organisation.name = "Gamma".into())),
        ("signature", change(&|join| join.signature.clear())),
        ("network", other_network),
        ("key", other_key),
    ] {
        assert_eq!(code(&carry(&mut network, &join)), Code::NotInvited, "{what}");
    }
    let admin = network.admin(1, "join_organisation", &[&serde_json::to_string(&good).unwrap()]);
    assert_eq!(code(&admin), Code::WrongRole, "nodes carry such requests");
    carry(&mut network, &good).unwrap();
}

#[test]
fn an_invitation_ends_in_block_time_and_lasts_thirty_days_at_most() {
    let mut network = Network::new(1, 1);
    let argument = invite(&network, "Beta");
    assert!(is_executed(network.admin(1, "invite_organisation", &[&argument])));
    network.time += DAY;
    let join = signed(&network, FoundingOrganisation::below("Beta", Ca::new("beta-ca").root()));
    assert_eq!(code(&carry(&mut network, &join)), Code::NotInvited);
    for expires in [network.time, network.time + 31 * DAY] {
        let argument = format!(r#"{{"name":"Beta","key":"{}","expires":{expires}}}"#, Hash::ZERO);
        assert_eq!(code(&network.admin(1, "invite_organisation", &[&argument])), Code::BadArgument);
    }
}

#[test]
fn no_two_organisations_share_a_name_or_an_authority() {
    let mut network = Network::new(2, 2);
    let argument = invite(&network, "Org2");
    assert_eq!(code(&network.admin(1, "invite_organisation", &[&argument])), Code::AlreadyExists);
    for name in ["", "a/b"] {
        let argument = invite(&network, name);
        assert_eq!(code(&network.admin(1, "invite_organisation", &[&argument])), Code::BadName);
    }
    let argument = invite(&network, "Beta");
    let id = waiting(network.admin(1, "invite_organisation", &[&argument]));
    assert!(is_executed(network.admin(2, "approve", &[&id])));
    let same_root = FoundingOrganisation::below("Beta", network.cas[0].root());
    let same_name = FoundingOrganisation::below("Beta", Ca::new("org1-ca").root());
    let no_root = FoundingOrganisation { roots: Vec::new(), ..same_root.clone() };
    let user = network.cas[0].user("Salma", "member", KeyKind::Ed25519);
    let no_authority = FoundingOrganisation { roots: vec![user.certificate], ..same_root.clone() };
    for bad in [same_root, same_name, no_root, no_authority] {
        let join = signed(&network, bad);
        assert_ne!(code(&carry(&mut network, &join)), Code::Ok);
    }
    assert_eq!(names(&network), ["Org1", "Org2"]);
}

#[test]
fn the_certificates_of_a_removed_organisation_count_no_longer() {
    let mut network = Network::new(3, 3);
    let salma = network.cas[2].user("Salma", "member", KeyKind::Ed25519);
    let identity = network.ledger.msps().verify(&salma.certificate, &[], network.time).unwrap();
    assert_eq!(code(&network.call(&salma, "proposals", &[])), Code::QueryOnly, "the certificate counts");
    let id = waiting(network.admin(1, "remove_organisation", &[&remove("Org3")]));
    let admitted = network.sign_for("listener", &salma, "echo", &["x"]);
    network.ledger.admit(admitted.encoded().clone(), network.time).unwrap();
    assert!(is_executed(network.admin(2, "approve", &[&id])));
    assert!(network.event_names().contains(&"organisation_removed"));
    assert_eq!(network.told(), "Org3", "other chaincodes were told in the same block");

    let outcome = network.block(&[&admitted]).remove(0);
    assert_eq!(code(&outcome), Code::Untrusted, "also what was admitted before");
    let fresh = network.sign(&salma, "proposals", &[]);
    let refused = network.ledger.admit(fresh.encoded().clone(), network.time).unwrap_err();
    assert_eq!(refused.rejection.code, Code::Untrusted);
    let refused = network.ledger.query(&identity, network.time, "msp", "proposals", &[]).unwrap_err();
    assert_eq!(refused.code, Code::Untrusted, "a session that is open ends");
    assert_eq!(network.ledger.check_revoked(&identity).unwrap_err().code, Code::Untrusted);
    let event = network.events.first().cloned().unwrap_or_default();
    assert_eq!(network.ledger.may_read(&identity, &event).unwrap_err().code, Code::Untrusted);
    assert_eq!(network.role(3), NodeRole::Removed, "its nodes left with it");
}

#[test]
fn what_a_removed_organisation_signed_has_no_effect_behind_the_removal_in_the_same_block() {
    let mut network = Network::new(3, 3);
    let id = waiting(network.admin(1, "remove_organisation", &[&remove("Org3")]));
    let (admin2, admin3, node3) = (
        network.cas[1].user("Boss", "admin", KeyKind::Ed25519),
        network.cas[2].user("Boss", "admin", KeyKind::Ed25519),
        network.cas[2].user("edge", "node", KeyKind::Ed25519),
    );
    let approve = network.sign(&admin2, "approve", &[&id]);
    let invite = invite(&network, "Friends");
    let propose = network.sign(&admin3, "invite_organisation", &[&invite]);
    let join = network.sign(&node3, "join_node", &[r#"{"address":"edge:7450"}"#]);
    let outcomes = network.block(&[&approve, &propose, &join]);
    let codes: Vec<_> = outcomes.iter().map(code).collect();
    assert_eq!(codes, [Code::Ok, Code::Untrusted, Code::Untrusted]);
}

#[test]
fn behind_the_removal_of_an_organisation_in_a_block_its_members_call_no_chaincode() {
    let mut network = Network::new(3, 3);
    let id = waiting(network.admin(1, "remove_organisation", &[&remove("Org3")]));
    let boss = network.cas[1].user("Boss", "admin", KeyKind::Ed25519);
    let [salma, omar] = [2, 0].map(|index| network.cas[index].user("Salma", "member", KeyKind::Ed25519));
    let before = network.sign_for("listener", &salma, "arm", &[]);
    let approve = network.sign(&boss, "approve", &[&id]);
    let behind = network.sign_for("listener", &salma, "arm", &[]);
    let other = network.sign_for("listener", &omar, "arm", &[]);
    let codes: Vec<_> = network.block(&[&before, &approve, &behind, &other]).iter().map(code).collect();
    assert_eq!(codes, [Code::Ok, Code::Ok, Code::Untrusted, Code::Ok]);
    let late = network.sign_for("listener", &salma, "arm", &[]);
    assert_eq!(code(&network.block(&[&late]).remove(0)), Code::Untrusted);
}

#[test]
fn behind_the_loss_of_an_authority_in_a_block_nobody_acts_with_its_certificates() {
    let mut network = Network::new(2, 2);
    let renewed = Ca::new("org1-ca-2031");
    let both = authorities(&[&network.cas[0], &renewed]);
    network.admin(1, "update_organisation", &[&both]).unwrap();
    let anew = renewed.user("Admin", "admin", KeyKind::Ed25519);
    let [old, salma] =
        [("Boss", "admin"), ("Salma", "member")].map(|(name, role)| network.cas[0].user(name, role, KeyKind::P256));
    let update = network.sign(&anew, "update_organisation", &[&authorities(&[&renewed])]);
    let register =
        format!(r#"{{"name":"Mallory","role":"admin","secret":"{}","expires":{}}}"#, Hash::ZERO, network.time + DAY);
    let register = network.sign(&old, "register", &[&register]);
    let arm = network.sign_for("listener", &salma, "arm", &[]);
    let stays = network.sign_for("listener", &anew, "arm", &[]);
    let codes: Vec<_> = network.block(&[&update, &register, &arm, &stays]).iter().map(code).collect();
    assert_eq!(codes, [Code::Ok, Code::Untrusted, Code::Untrusted, Code::Ok]);
}

#[test]
fn a_ca_founded_anew_under_the_name_of_the_old_one_ends_what_the_old_key_vouched_for() {
    let mut network = Network::new(2, 2);
    let anew = Ca::new("org2-ca");
    let both = authorities(&[&network.cas[1], &anew]);
    network.admin(2, "update_organisation", &[&both]).unwrap();
    assert_eq!(network.lost(), "", "both keys vouch");
    let boss = anew.user("Boss", "admin", KeyKind::Ed25519);
    let issuer = network.ledger.msps().verify(&boss.certificate, &[], network.time).unwrap().issuer;
    let salma = network.cas[1].user("Salma", "member", KeyKind::Ed25519);
    let update = network.sign(&boss, "update_organisation", &[&authorities(&[&anew])]);
    let [behind, later] = [(); 2].map(|()| network.sign_for("listener", &salma, "arm", &[]));
    let codes: Vec<_> = network.block(&[&update, &behind]).iter().map(code).collect();
    assert_eq!(network.lost(), hex::encode(issuer), "other chaincodes were told in the same block");
    let refused = code(&network.block(&[&later]).remove(0));
    assert_ne!(refused, Code::Ok);
    assert_eq!(codes, [Code::Ok, refused], "at once as in the next block");
}

#[test]
fn the_invitations_of_an_organisation_end_with_it() {
    let mut network = Network::new(3, 3);
    for (organisation, name) in [(3, "Beta"), (1, "Gamma")] {
        let argument = invite(&network, name);
        let id = waiting(network.admin(organisation, "invite_organisation", &[&argument]));
        assert!(is_executed(network.admin(2, "approve", &[&id])));
    }
    let id = waiting(network.admin(1, "remove_organisation", &[&remove("Org3")]));
    assert!(is_executed(network.admin(2, "approve", &[&id])));
    assert!(network.event_names().contains(&"invitation_cancelled"));
    let join = |network: &mut Network, name: &str| {
        let join = signed(network, FoundingOrganisation::below(name, Ca::new(&format!("{name}-ca")).root()));
        code(&carry(network, &join))
    };
    assert_eq!(join(&mut network, "Beta"), Code::NotInvited);
    assert_eq!(join(&mut network, "Gamma"), Code::Ok, "that of an organisation that stays");
}

#[test]
fn neither_the_last_organisation_nor_the_one_with_the_last_voters_is_removed() {
    let mut network = Network::new(1, 1);
    assert_eq!(code(&network.admin(1, "remove_organisation", &[&remove("Org1")])), Code::LastOne);
    let mut network = Network::new(3, 1);
    assert_eq!(code(&network.admin(2, "remove_organisation", &[&remove("Org1")])), Code::LastOne);
    assert_eq!(names(&network), ["Org1", "Org2", "Org3"]);
    let refused = network.admin(2, "remove_organisation", &[&remove("Org9")]).unwrap_err();
    assert!(refused.code == Code::NotFound && refused.wanted.contains("Org1, Org2, Org3"), "{refused}");
}

#[test]
fn a_former_name_comes_back_only_with_a_root_that_it_had() {
    let mut network = Network::new(3, 3);
    let id = waiting(network.admin(1, "remove_organisation", &[&remove("Org3")]));
    assert!(is_executed(network.admin(2, "approve", &[&id])));
    let argument = invite(&network, "Org3");
    let id = waiting(network.admin(1, "invite_organisation", &[&argument]));
    assert!(is_executed(network.admin(2, "approve", &[&id])));
    let stranger = signed(&network, FoundingOrganisation::below("Org3", Ca::new("org3-ca").root()));
    assert_eq!(code(&carry(&mut network, &stranger)), Code::AlreadyExists);
    let returns = signed(&network, FoundingOrganisation::below("Org3", network.cas[2].root()));
    carry(&mut network, &returns).unwrap();
    assert_eq!(names(&network), ["Org1", "Org2", "Org3"]);
    let node: msp::NodeRecord = json(network.node(3, "join_node", &[r#"{"address":"node3:7450"}"#]));
    assert_eq!(node.id, 4, "its nodes come back as new ones");
}

#[test]
fn an_organisation_renews_its_own_roots_and_keeps_at_least_one() {
    let mut network = Network::new(2, 2);
    let renewed = Ca::new("org1-ca-2031");
    let new_admin = renewed.user("Admin", "admin", KeyKind::Ed25519);
    assert_eq!(code(&network.call(&new_admin, "proposals", &[])), Code::Untrusted);
    let both = authorities(&[&network.cas[0], &renewed]);
    let only = authorities(&[&renewed]);
    network.admin(1, "update_organisation", &[&both]).unwrap();
    assert_eq!(network.event_names(), ["organisation_updated"]);
    assert_eq!(code(&network.call(&new_admin, "proposals", &[])), Code::QueryOnly, "the certificate counts");
    assert_eq!(code(&network.admin(1, "update_organisation", &[&only])), Code::LastOne, "it would lock itself out");
    assert_eq!(code(&network.call(&new_admin, "update_organisation", &[r#"{"roots":[]}"#])), Code::LastOne);
    let foreign = authorities(&[&renewed, &network.cas[1]]);
    assert_ne!(code(&network.call(&new_admin, "update_organisation", &[&foreign])), Code::Ok);
    network.call(&new_admin, "update_organisation", &[&only]).unwrap();
    assert_eq!(code(&network.admin(1, "proposals", &[])), Code::Untrusted, "the old root counts no longer");
    assert_eq!(code(&network.node(2, "update_organisation", &[&only])), Code::NotAdmin);
    network.time += SECOND;
}

#[test]
fn an_invited_organisation_has_a_readable_name_that_looks_like_no_other_one() {
    let mut network = Network::new(2, 2);
    let wrong = [("0rg1", Code::AlreadyExists), ("Orgl", Code::AlreadyExists), ("\u{41e}rg3", Code::BadName)];
    let wrong = wrong.map(|(name, code)| (name, Err(code)));
    for (name, expected) in wrong.into_iter().chain([("Neighbour", Ok(()))]) {
        let invitation = invite(&network, name);
        let invited = network.admin(1, "invite_organisation", &[&invitation]);
        assert_eq!(invited.map(drop).map_err(|refused| refused.code), expected, "{name}");
    }
}
