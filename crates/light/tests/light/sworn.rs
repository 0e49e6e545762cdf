//! The vectors of votes, and of proofs of a lie.

use crate::vectors::{bytes, hash, members, number, text, vectors};
use crate::world::{NETWORK, NOW, World};
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::key::KeyKind;
use ledger_light::{Fault, Lie, Misbehaviour, Signature, Statement, Vote};
use serde_json::{Value, json};

fn outcome(found: Result<String, Rejection>, vector: &Value) {
    match found {
        Ok(name) => assert_eq!(name, vector["signer"], "{vector}"),
        Err(reason) => {
            assert_eq!(reason.code.name(), vector["refused"], "{reason:?} {vector}");
            assert!(!text(vector, "why").is_empty());
        }
    }
}

#[test]
fn votes_are_believed_and_refused_as_the_vectors_say() {
    let vectors = vectors();
    let (voters, msps) = members(vectors);
    let votes = vectors["votes"].as_array().unwrap();
    assert!(votes.len() > 8 && votes.iter().any(|vote| vote["refused"].is_null()));
    for vector in votes {
        let fields = ["recoveries", "term", "candidate", "voter"];
        let [recoveries, term, candidate, voter] = fields.map(|field| number(vector, field));
        let vote = Vote { network: hash(vector, "network"), recoveries, term, candidate, voter };
        assert_eq!(hex::encode(vote.to_bytes()), text(vector, "bytes"));
        let found = Signature::from_bytes(&bytes(vector, "signature")).and_then(|signature| {
            let identity = msps.verify(&signature.certificate, &[], number(vectors, "time"))?;
            voters.check_vote(&vote, &signature, &identity).map(|()| identity.id())
        });
        outcome(found, vector);
    }
}

#[test]
fn lies_are_proved_and_not_proved_as_the_vectors_say() {
    let vectors = vectors();
    let (_, msps) = members(vectors);
    let lies = vectors["lies"].as_array().unwrap();
    assert!(lies.len() > 6 && lies.iter().any(|lie| lie["refused"].is_null()));
    for vector in lies {
        let found = Misbehaviour::from_bytes(&bytes(vector, "lie")).and_then(|lie| {
            assert_eq!(hex::encode(lie.to_bytes()), text(vector, "lie"));
            lie.signer(|der, time| msps.verify(der, &[], time).map_err(Rejection::from)).map(|liar| liar.id())
        });
        outcome(found, vector);
    }
}

#[test]
fn faults_are_proved_and_not_proved_as_the_vectors_say() {
    let vectors = vectors();
    let (_, msps) = members(vectors);
    let faults = vectors["faults"].as_array().unwrap();
    assert!(faults.len() > 2 && faults.iter().any(|fault| fault["refused"].is_null()));
    for vector in faults {
        let found = Misbehaviour::from_bytes(&bytes(vector, "fault")).and_then(|fault| {
            assert_eq!(hex::encode(fault.to_bytes()), text(vector, "fault"));
            fault.signer(|der, time| msps.verify(der, &[], time).map_err(Rejection::from)).map(|node| node.id())
        });
        outcome(found, vector);
    }
}

/// The vectors of votes.
pub(crate) fn votes(world: &World) -> Vec<Value> {
    let vote = Vote { network: NETWORK, recoveries: 0, term: 7, candidate: 1, voter: 3 };
    let signed = |vote: &Vote, node: usize| {
        vote.sign(world.nodes[node - 1].certificate.clone(), &world.nodes[node - 1].key).unwrap()
    };
    let shown = |name: &str, vote: &Vote, signature: &Signature| {
        json!({"name": name, "network": vote.network, "recoveries": vote.recoveries, "term": vote.term, "candidate": vote.candidate,
               "voter": vote.voter, "bytes": hex::encode(vote.to_bytes()), "signature": hex::encode(signature.to_bytes())})
    };
    let good = signed(&vote, 3);
    let mut votes = vec![
        shown("a vote", &vote, &good),
        shown("with Ed25519", &Vote { voter: 2, ..vote }, &signed(&Vote { voter: 2, ..vote }, 2)),
    ];
    votes[0]["signer"] = "Org2/node3".into();
    votes[1]["signer"] = "Org1/node2".into();
    let member = world.cas[1].user("node3", "member", KeyKind::P256);
    let said =
        Statement { network: NETWORK, recoveries: 0, height: 7, time: NOW, block: Hash::ZERO, results: Hash::ZERO };
    let not_signed = "the vote is not the one that was signed";
    let bad = Code::BadSignature;
    for (name, vote, signature, code, why) in [
        ("another term", Vote { term: 8, ..vote }, good.clone(), bad, not_signed),
        (
            "after another number of forced recoveries",
            Vote { recoveries: 1, ..vote },
            signed(&Vote { recoveries: 1, ..vote }, 3),
            Code::Untrusted,
            "the ledger has executed no forced recovery",
        ),
        ("another candidate", Vote { candidate: 2, ..vote }, good.clone(), bad, not_signed),
        ("another network", Vote { network: Hash::ZERO, ..vote }, good.clone(), bad, not_signed),
        ("a statement", vote, world.sign(&said, 3).signature, bad, "statements are signed with other first bytes"),
        ("another voter", Vote { voter: 1, ..vote }, good.clone(), bad, "node 3 votes for itself only"),
        (
            "the certificate of another node",
            vote,
            Signature { certificate: world.nodes[3].certificate.clone(), ..good.clone() },
            Code::Untrusted,
            "it is that of node 4",
        ),
        (
            "the certificate of a member of the same name",
            vote,
            vote.sign(member.certificate, &member.key).unwrap(),
            Code::Untrusted,
            "only nodes vote",
        ),
        (
            "a node that nobody knows",
            Vote { voter: 9, ..vote },
            Signature { node: 9, ..signed(&Vote { voter: 9, ..vote }, 3) },
            Code::NotAMember,
            "the ledger has no node 9",
        ),
    ] {
        let mut vector = shown(name, &vote, &signature);
        (vector["refused"], vector["why"]) = (code.name().into(), why.into());
        votes.push(vector);
    }
    votes
}

/// The vectors of proofs of a lie.
pub(crate) fn lies(world: &World, said: Statement) -> Vec<Value> {
    let other = Statement { block: Hash([9; 32]), ..said };
    let pair = |first: &Statement, by: u64, second: &Statement, and: u64| Lie {
        first: world.sign(first, by),
        second: world.sign(second, and),
    };
    let lie_bytes = |lie: Lie| Misbehaviour::Lie(lie).to_bytes();
    let lie = |first: &Statement, by: u64, second: &Statement, and: u64| lie_bytes(pair(first, by, second, and));
    let good = lie(&said, 3, &other, 3);
    let mut forged = pair(&said, 3, &other, 3);
    forged.second.statement.results = Hash([8; 32]);
    let member = world.cas[1].user("node3", "member", KeyKind::P256);
    let by_member = |said: &Statement| said.sign(3, member.certificate.clone(), &member.key).unwrap();
    let by_member = Lie { first: by_member(&said), second: by_member(&other) };
    let same = "the statements do not contradict each other";
    let later = Statement { height: said.height + 1, ..other };
    let elsewhere = Statement { network: Hash::ZERO, ..other };
    let recovered = Statement { recoveries: 1, ..other };
    let results = Statement { results: Hash([9; 32]), ..said };
    let mut renumbered = pair(&said, 3, &other, 3);
    (renumbered.first.signature.node, renumbered.second.signature.node) = (4, 4);
    let refused = [
        ("the same twice", lie(&said, 3, &said, 3), Code::Malformed, same),
        ("two nodes", lie(&said, 3, &other, 1), Code::Malformed, same),
        ("two heights", lie(&said, 3, &later, 3), Code::Malformed, same),
        ("two networks", lie(&said, 3, &elsewhere, 3), Code::Malformed, same),
        ("before and after a forced recovery", lie(&said, 3, &recovered, 3), Code::Malformed, same),
        ("two results of one block", lie(&said, 3, &results, 3), Code::Malformed, "that is a fault and no lie"),
        ("another number of the node", lie_bytes(renumbered), Code::BadSignature, "the number of the node is signed"),
        (
            "a statement that was not signed",
            lie_bytes(forged),
            Code::BadSignature,
            "the second signature is of another one",
        ),
        ("a member of the name of a node", lie_bytes(by_member), Code::Untrusted, "only nodes make statements"),
    ];
    let mut lies = vec![json!({"name": "a lie", "lie": hex::encode(&good), "signer": "Org2/node3"})];
    lies.extend(refused.into_iter().map(
        |(name, lie, code, why)| json!({"name": name, "lie": hex::encode(lie), "refused": code.name(), "why": why}),
    ));
    let longer = [&good[..], &[0]].concat();
    lies.push(json!({"name": "a byte behind it", "lie": hex::encode(longer), "refused": Code::Malformed.name(),
                     "why": "nothing stands behind the end"}));
    lies
}

/// The vectors of proofs of a fault.
pub(crate) fn faults(world: &World, said: Statement) -> Vec<Value> {
    let other = Statement { results: Hash([9; 32]), ..said };
    let fault = |first: &Statement, by: u64, second: &Statement, and: u64| {
        let fault = Fault { first: world.sign(first, by), second: world.sign(second, and) };
        hex::encode(Misbehaviour::Fault(fault).to_bytes())
    };
    let block = Statement { block: Hash([9; 32]), ..other };
    let mut faults = vec![json!({"name": "a fault", "fault": fault(&said, 3, &other, 3), "signer": "Org2/node3"})];
    for (name, fault, why) in [
        ("the same twice", fault(&said, 3, &said, 3), "the statements do not contradict each other"),
        ("two nodes", fault(&said, 3, &other, 1), "each has its own results"),
        ("two blocks", fault(&said, 3, &block, 3), "that is a lie and no fault"),
    ] {
        faults.push(json!({"name": name, "fault": fault, "refused": Code::Malformed.name(), "why": why}));
    }
    faults
}
