//! Governance, followed from a pinned beginning: over changes of voters, of organisations and revocations.

use crate::world::{NETWORK, NOW, World, name, statement};
use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_base::rejection::Code;
use ledger_light::fact::Fact;
use ledger_light::proof::{Proof, Shown};
use ledger_light::{Change, Checkpoint, Governance, Statement};
use serde_json::{Value, json};

/// Writes of the chaincode `msp`, in order of keys.
fn change(height: u64, writes: &[(&str, Option<Value>)]) -> Change {
    let mut writes: Vec<(Bytes, Option<Bytes>)> = writes
        .iter()
        .map(|(key, value)| {
            let value = value.as_ref().map(|value| serde_json::to_vec(value).unwrap().into());
            (["msp\0", key].concat().into(), value)
        })
        .collect();
    writes.sort();
    Change { height, writes }
}

fn members(voters: &[u64], outgoing: &[u64]) -> (&'static str, Option<Value>) {
    ("members", Some(json!({"voters": voters, "outgoing": outgoing, "learners": []})))
}

/// The genesis: both organisations, four nodes, and these voters.
fn genesis(world: &World, voters: &[u64]) -> Change {
    let mut writes = vec![members(voters, &[])];
    for (ca, organisation) in world.cas.iter().zip(["organisation/Org1", "organisation/Org2"]) {
        writes.push((organisation, Some(json!({"name": &organisation[13..], "roots": [hex::encode(ca.root())]}))));
    }
    for (id, key) in (1..).zip(["node/1", "node/2", "node/3", "node/4"]) {
        let [organisation, name] = name(id);
        writes.push((key, Some(json!({"id": id, "organisation": organisation, "name": name, "address": "a:1"}))));
    }
    change(0, &writes)
}

fn founded(world: &World, voters: &[u64]) -> Governance {
    Governance::founded(NETWORK, NOW, &genesis(world, voters)).unwrap()
}

/// The proof of a block at which the governing chain covers these changes.
fn proof_of(world: &World, height: u64, changes: &[&Change], signers: &[u64]) -> Proof {
    let governing = changes.iter().fold(Hash::ZERO, |chain, change| change.extend(chain).unwrap());
    let ground = Fact::Ground { governing, control: Hash::ZERO, digest: Hash([4; 32]), previous: Hash::ZERO };
    let leaves = [ground.leaf(), Hash([9; 32])];
    let said =
        Statement { results: ledger_light::merkle::root(leaves.to_vec()), time: NOW + height, ..statement(height) };
    let facts = vec![Shown::of(&ground, &leaves, 0).unwrap()];
    Proof { certificate: world.certificate(said, signers), facts }
}

fn code(followed: Result<Governance, ledger_base::rejection::Rejection>) -> Code {
    followed.map_or_else(|refused| refused.code, |_| Code::Ok)
}

#[test]
fn a_reader_goes_on_with_all_changes_and_with_none_left_out_or_made_up() {
    let world = World::new();
    let (begun, first) = (founded(&world, &[1, 2, 3]), genesis(&world, &[1, 2, 3]));
    let moved =
        change(5, &[("node/4", Some(json!({"id": 4, "organisation": "Org2", "name": "node4", "address": "b:1"})))]);
    let proof = proof_of(&world, 8, &[&first, &moved], &[1, 3]);
    let after = begun.follow(std::slice::from_ref(&moved), &proof).unwrap();
    assert_eq!((after.height(), after.time(), after.network()), (8, NOW + 8, NETWORK));
    let made_up = change(5, &[("node/4", None)]);
    let later = Change { height: 6, ..moved.clone() };
    let beyond = Change { height: 9, ..made_up.clone() };
    assert_eq!(code(begun.follow(&[], &proof)), Code::Untrusted, "left out");
    assert_eq!(code(begun.follow(std::slice::from_ref(&made_up), &proof)), Code::Untrusted, "made up");
    assert_eq!(code(begun.follow(&[later], &proof)), Code::Untrusted, "another height");
    assert_eq!(
        code(begun.follow(&[moved.clone(), change(7, &[("node/4", None)])], &proof)),
        Code::Untrusted,
        "one more"
    );
    assert_eq!(begun.follow(&[moved, beyond], &proof).unwrap(), after, "what comes later waits");
    assert_eq!(code(after.follow(&[], &proof_of(&world, 7, &[&first], &[1, 3]))), Code::Untrusted, "older");
}

#[test]
fn voters_hand_on_what_is_believed_in_them_and_strangers_cannot() {
    let world = World::new();
    let (begun, first) = (founded(&world, &[1, 3]), genesis(&world, &[1, 3]));
    let joined = change(4, &[members(&[2, 4], &[1, 3])]);
    let left = change(6, &[members(&[2, 4], &[])]);
    let changes = [joined.clone(), left.clone()];
    // The new voters alone could be anybody's.
    let alone = proof_of(&world, 9, &[&first, &joined, &left], &[2, 4]);
    assert_eq!(code(begun.follow(&changes, &alone)), Code::Untrusted);
    // Those before have signed the block of the change, and both sets the one that completes it.
    let one = begun.follow(&changes, &proof_of(&world, 4, &[&first, &joined], &[1, 3])).unwrap();
    assert_eq!(code(one.follow(&changes, &alone)), Code::Untrusted, "while they change, both must agree");
    let two = one.follow(&changes, &proof_of(&world, 6, &[&first, &joined, &left], &[1, 2, 3, 4])).unwrap();
    let three = two.follow(&changes, &alone).unwrap();
    assert_eq!((three.height(), three.voters().unwrap().voters), (9, [2, 4].into()));
    // In one step, if enough of the earlier voters still sign.
    let both = proof_of(&world, 9, &[&first, &joined, &left], &[1, 2, 3, 4]);
    assert_eq!(begun.follow(&changes, &both).unwrap(), three);
    let few = proof_of(&world, 9, &[&first, &joined, &left], &[1, 3]);
    assert_eq!(code(begun.follow(&changes, &few)), Code::Untrusted, "the new ones must agree, too");
}

#[test]
fn a_revoked_certificate_signs_nothing_any_more_and_an_organisation_brings_its_authorities() {
    let world = World::new();
    let (begun, first) = (founded(&world, &[1, 2, 3]), genesis(&world, &[1, 2, 3]));
    let node1 = world.identify(&world.nodes[0].certificate, NOW).unwrap();
    let key = [&b"msp\0revoked/"[..], &node1.revocation_key()].concat().into();
    let revoked = Change { height: 3, writes: vec![(key, Some(Bytes::from_static(b"{}")))] };
    let changes = [revoked.clone()];
    let by = |signers: &[u64]| begun.follow(&changes, &proof_of(&world, 7, &[&first, &revoked], signers));
    assert_eq!(code(by(&[1, 3])), Code::Revoked);
    let after = by(&[2, 3]).unwrap();
    assert!(after.is_revoked(&node1) && !begun.is_revoked(&node1));
    assert_eq!(after.revocations().count(), 1);
    assert_eq!(by(&[1, 2, 3]).unwrap(), after, "the signature of a revoked one spoils nothing");
    // A name that is barred has no certificate that begins before that.
    let node2 = world.identify(&world.nodes[1].certificate, NOW).unwrap();
    for (time, is_revoked) in [(node2.valid_from, true), (node2.valid_from - 1, false)] {
        let (organisation, name) = (&node2.organisation, &node2.name);
        let record = serde_json::json!({ "organisation": organisation, "name": name, "time": time, "height": 8 });
        let key = format!("msp\0barred/{organisation}/{name}").into();
        let barred = Change { height: 8, writes: vec![(key, Some(record.to_string().into()))] };
        let proof = proof_of(&world, 8, &[&first, &revoked, &barred], &[2, 3]);
        let after = after.follow(&[barred], &proof).unwrap();
        assert_eq!(after.barred().unwrap(), [(node2.id(), time)].into());
        assert_eq!(after.is_revoked(&node2), is_revoked);
    }
    let gone = change(8, &[("organisation/Org2", None)]);
    let proof = proof_of(&world, 8, &[&first, &revoked, &gone], &[2, 3]);
    let without = after.follow(&[gone], &proof).unwrap();
    assert!(without.msps().unwrap().get("Org2").is_none() && after.msps().unwrap().get("Org2").is_some());
}

#[test]
fn a_proof_shows_facts_of_its_own_block_only() {
    let world = World::new();
    let (begun, first) = (founded(&world, &[1, 2, 3]), genesis(&world, &[1, 2, 3]));
    let good = proof_of(&world, 8, &[&first], &[1, 3]);
    assert_eq!(Proof::from_bytes(&good.to_bytes()).unwrap(), good);
    let other = Fact::Ground {
        governing: first.extend(Hash::ZERO).unwrap(),
        control: Hash([1; 32]),
        digest: Hash::ZERO,
        previous: Hash::ZERO,
    };
    let mut forged = good.clone();
    forged.facts[0].fact = other.to_bytes().into();
    assert_eq!(code(begun.follow(&[], &forged)), Code::Untrusted);
    let mut without = good.clone();
    without.facts.clear();
    assert_eq!(code(begun.follow(&[], &without)), Code::Malformed);
    let mut more = good;
    more.facts.push(Shown { fact: other.to_bytes().into(), ..more.facts[0].clone() });
    assert_eq!(more.others().unwrap_err().code, Code::Untrusted);
    assert!(begun.follow(&[], &more).is_ok(), "what is not asked for is not believed either");
}

#[test]
fn a_checkpoint_is_where_its_maker_was() {
    let world = World::new();
    let (begun, first) = (founded(&world, &[1, 2, 3]), genesis(&world, &[1, 2, 3]));
    let proof = proof_of(&world, 8, &[&first], &[1, 3]);
    let after = begun.follow(&[], &proof).unwrap();
    let kept = Checkpoint { governance: after, proof };
    assert_eq!(Checkpoint::from_bytes(&NETWORK, &kept.to_bytes()).unwrap(), kept);
    assert_eq!(Checkpoint::from_bytes(&Hash::ZERO, &kept.to_bytes()).unwrap_err().code, Code::WrongNetwork);
    let mut cut = kept.to_bytes().to_vec();
    cut.pop();
    assert_eq!(Checkpoint::from_bytes(&NETWORK, &cut).unwrap_err().code, Code::Malformed);
}
