//! Which attestations make a snapshot believed.

use bytes::Bytes;
use ledger::transaction::{Body, NONCE_BYTES, Transaction};
use ledger_base::hash::Hash;
use ledger_base::rejection::Code;
use ledger_identity::key::KeyKind;
use ledger_identity::msp::{Msp, Msps};
use ledger_identity::{Identity, Role};
use ledger_replica::trust::{Attested, Claim, Known};
use std::collections::BTreeMap;
use testkit::{Ca, User};

const NOW: u64 = 1_900_000_000_000_000;
const CONTENT: Hash = Hash([7; 32]);

/// Three organisations.
struct World {
    network: Hash,
    authorities: BTreeMap<&'static str, Ca>,
    msps: Msps,
}

impl World {
    fn new() -> Self {
        let (mut authorities, mut msps) = (BTreeMap::new(), Msps::new());
        for name in ["Org1", "Org2", "Org3"] {
            let authority = Ca::new(&format!("{name}-ca"));
            msps.insert(Msp::new(name, &[authority.root()], &[] as &[Bytes]).unwrap()).unwrap();
            authorities.insert(name, authority);
        }
        Self { network: Hash::of(&[b"fleet"]), authorities, msps }
    }

    fn node(&self, organisation: &str, role: Role) -> User {
        self.authorities[organisation].user(&format!("a-{role}"), role.as_str(), KeyKind::Ed25519)
    }

    fn claim(&self) -> Claim {
        Claim { network: self.network, height: 10, time: NOW, content: CONTENT }
    }

    /// Only some of the organisations.
    fn only(&self, names: &[&str]) -> Msps {
        let mut msps = Msps::new();
        for name in names {
            msps.insert(self.msps.get(name).unwrap().clone()).unwrap();
        }
        msps
    }

    fn attest(&self, node: &User, function: &str, statement: &str) -> Attested {
        let body = Body {
            network: Bytes::copy_from_slice(&self.network.0),
            creator: Bytes::copy_from_slice(&Hash::of(&[&node.certificate]).0),
            nonce: Bytes::from_static(&[1; NONCE_BYTES]),
            not_after: NOW + 1,
            chaincode: "msp".into(),
            function: function.into(),
            args: vec![Bytes::copy_from_slice(statement.as_bytes())],
            known_block: None,
        };
        let transaction = Transaction::sign(&body, &node.key).unwrap();
        Attested { transaction: transaction.encoded().clone(), certificate: node.certificate.clone() }
    }
}

fn statement(height: u64, content: Hash) -> String {
    let zero = Hash::ZERO;
    format!(r#"{{"height":{height},"hash":"{zero}","digest":"{zero}","content":"{content}"}}"#)
}

fn nobody(_: &Identity) -> bool {
    false
}

#[test]
fn a_snapshot_needs_nodes_of_two_organisations_that_this_node_knew() {
    let world = World::new();
    let claim = world.claim();
    let nodes = ["Org1", "Org2", "Org3"].map(|organisation| world.node(organisation, Role::Node));
    let [one, two, three] = nodes.map(|node| world.attest(&node, "attest", &statement(10, CONTENT)));
    let (all, first) = (world.only(&["Org1", "Org2", "Org3"]), world.only(&["Org1"]));
    let accept = |attested: &[&Attested], known: &Msps, declared: &Msps| {
        let attested: Vec<_> = attested.iter().map(|one| (*one).clone()).collect();
        claim.accept(&attested, (Known::Members(known), declared), &nobody)
    };
    accept(&[&one, &two], &first, &all).unwrap();
    accept(&[&three, &two], &all, &all).unwrap();
    assert_eq!(accept(&[&one], &all, &all).unwrap_err().code, Code::Untrusted, "one is not enough");
    assert_eq!(accept(&[&one, &one], &all, &all).unwrap_err().code, Code::Untrusted, "twice the same");
    assert_eq!(accept(&[&two, &three], &first, &all).unwrap_err().code, Code::Untrusted, "none is trusted");
    assert_eq!(accept(&[], &all, &all).unwrap_err().code, Code::Untrusted);
    // A network of one organisation has no second one.
    accept(&[&one], &first, &first).unwrap();
    // By the snapshot, the second organisation does not belong to the network.
    assert_eq!(accept(&[&one, &two], &all, &world.only(&["Org1", "Org3"])).unwrap_err().code, Code::Untrusted);
    // An organisation that declares itself alone, or with one that nobody knew.
    let both = world.only(&["Org1", "Org2"]);
    assert_eq!(accept(&[&one], &both, &first).unwrap_err().code, Code::Untrusted, "alone");
    let refused = accept(&[&one, &three], &both, &world.only(&["Org1", "Org3"])).unwrap_err();
    assert!(refused.code == Code::Untrusted && refused.advice().contains("ledgerd rejoin"), "{refused}");
}

#[test]
fn a_newcomer_believes_the_organisation_of_its_token_with_another_one() {
    let world = World::new();
    let claim = world.claim();
    let nodes = ["Org1", "Org3"].map(|organisation| world.node(organisation, Role::Node));
    let [one, three] = nodes.map(|node| world.attest(&node, "attest", &statement(10, CONTENT)));
    let accept = |attested: &[&Attested], declared: &[&str]| {
        let attested: Vec<_> = attested.iter().map(|one| (*one).clone()).collect();
        // Both organisations of the genesis, one of which has left since; and the token.
        let trusted = world.only(&["Org1", "Org2"]);
        claim.accept(&attested, (Known::Vouched(&trusted), &world.only(declared)), &nobody)
    };
    accept(&[&one, &three], &["Org1", "Org3"]).unwrap();
    accept(&[&one], &["Org1"]).unwrap();
    assert_eq!(accept(&[&one], &["Org1", "Org3"]).unwrap_err().code, Code::Untrusted);
    assert_eq!(accept(&[&three], &["Org3"]).unwrap_err().code, Code::Untrusted, "nobody trusts it");
}

#[test]
fn only_what_a_node_signed_about_this_snapshot_counts() {
    let world = World::new();
    let claim = world.claim();
    let (one, two) = (world.node("Org1", Role::Node), world.node("Org2", Role::Node));
    let member = world.node("Org2", Role::Member);
    let right = statement(10, CONTENT);
    let by = |attested: Attested, revoked: &dyn Fn(&Identity) -> bool| {
        claim.attested_by(&[attested], &world.msps, revoked).into_iter().collect::<Vec<_>>()
    };
    assert_eq!(by(world.attest(&one, "attest", &right), &nobody), ["Org1"]);
    assert!(by(world.attest(&one, "attest", &right), &|_| true).is_empty(), "revoked");
    assert!(by(world.attest(&one, "attest", &statement(11, CONTENT)), &nobody).is_empty(), "another height");
    assert!(by(world.attest(&one, "attest", &statement(10, Hash::ZERO)), &nobody).is_empty(), "another content");
    assert!(by(world.attest(&one, "attest", "{}"), &nobody).is_empty(), "no statement");
    assert!(by(world.attest(&one, "detest", &right), &nobody).is_empty(), "another function");
    assert!(by(world.attest(&member, "attest", &right), &nobody).is_empty(), "not a node");
    let foreign = Attested { certificate: two.certificate.clone(), ..world.attest(&one, "attest", &right) };
    assert!(by(foreign, &nobody).is_empty(), "somebody else's certificate");
    let stolen = User { key: one.key, certificate: two.certificate };
    assert!(by(world.attest(&stolen, "attest", &right), &nobody).is_empty(), "somebody else's key");
    assert!(by(Attested::default(), &nobody).is_empty());
}
