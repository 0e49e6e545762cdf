//! Good bytes of the vectors, with each bit of them turned, and with parts of them moved: no voter has signed these.

use crate::vectors::{bytes, hash, members, number, text, vectors};
use crate::ways::{begun, stepped};
use ledger_base::hash::Hash;
use ledger_base::rejection::Rejection;
use ledger_light::{Certificate, Change, Checkpoint, Governance, Misbehaviour, Proof, Signature, Vote};
use proptest::prelude::*;
use serde_json::{Value, json};
use std::collections::BTreeSet;

/// The bytes with one bit turned, for each bit.
fn flips(bytes: &[u8]) -> impl Iterator<Item = (usize, Vec<u8>)> {
    (0..bytes.len() * 8).map(|bit| {
        let mut flipped = bytes.to_vec();
        flipped[bit / 8] ^= 1 << (bit % 8);
        (bit, flipped)
    })
}

fn way(name: &str) -> (Governance, &'static Value) {
    let way = vectors()["ways"].as_array().unwrap().iter().find(|way| way["name"] == name);
    let way = way.unwrap_or_else(|| panic!("no way {name}"));
    (begun(&vectors()["beginnings"][text(way, "begin")]).unwrap(), &way["steps"])
}

#[test]
fn a_proof_with_one_bit_turned_is_refused() {
    let (known, steps) = way("two voters of three, of two organisations");
    assert!(stepped(&known, &steps[0]).is_ok());
    for (bit, flipped) in flips(&bytes(&steps[0], "proof")) {
        let step = json!({"changes": [], "proof": hex::encode(flipped)});
        assert!(stepped(&known, &step).is_err(), "bit {bit}");
    }
}

#[test]
fn a_change_with_one_bit_turned_is_refused() {
    let (known, steps) = way("voters hand over in one step");
    let proof = Proof::from_bytes(&bytes(&steps[0], "proof")).unwrap();
    let shown = steps[0]["changes"].as_array().unwrap();
    let changes: Vec<_> = shown
        .iter()
        .map(|change| Change::from_bytes(number(change, "height"), &bytes(change, "writes")).unwrap())
        .collect();
    assert!(known.follow(&changes, &proof).is_ok());
    for (at, change) in changes.iter().enumerate() {
        for (bit, flipped) in flips(&change.to_bytes()) {
            let Ok(flipped) = Change::from_bytes(change.height, &flipped) else { continue };
            let mut changed = changes.clone();
            changed[at] = flipped;
            assert!(known.follow(&changed, &proof).is_err(), "bit {bit} of change {at}");
        }
    }
}

#[test]
fn a_checkpoint_with_one_bit_turned_is_refused_or_says_something_else_about_who_governs() {
    let begin = &vectors()["beginnings"]["checkpoint"];
    let (network, good) = (hash(begin, "network"), bytes(begin, "checkpoint"));
    let checkpoint = Checkpoint::from_bytes(&network, &good).unwrap();
    // Nobody has signed the values, so whoever keeps a checkpoint keeps them. They end where the proof begins.
    let values = good.len() - checkpoint.proof.to_bytes().len() - 4;
    for (bit, flipped) in flips(&good) {
        let Ok(found) = Checkpoint::from_bytes(&network, &flipped) else { continue };
        assert_eq!(found.to_bytes(), flipped, "bit {bit}");
        let checked = found.governance.check(&found.proof.certificate);
        assert!(checked.is_err() || (bit / 8 < values && found.governance != checkpoint.governance), "bit {bit}");
    }
}

#[test]
fn a_vote_with_one_bit_turned_is_refused() {
    let (voters, msps) = members(vectors());
    let vector = &vectors()["votes"][0];
    let fields = ["recoveries", "term", "candidate", "voter"];
    let [recoveries, term, candidate, voter] = fields.map(|field| number(vector, field));
    let vote = Vote { network: hash(vector, "network"), recoveries, term, candidate, voter };
    let check = |vote: &Vote, signature: &[u8]| {
        let signature = Signature::from_bytes(signature)?;
        let identity = msps.verify(&signature.certificate, &[], number(vectors(), "time"))?;
        voters.check_vote(vote, &signature, &identity)
    };
    let signature = bytes(vector, "signature");
    assert!(check(&vote, &signature).is_ok());
    for (bit, flipped) in flips(&signature) {
        assert!(check(&vote, &flipped).is_err(), "bit {bit} of the signature");
    }
    for bit in 0..64 {
        let turned = 1 << bit;
        for vote in [
            Vote { recoveries: vote.recoveries ^ turned, ..vote },
            Vote { term: vote.term ^ turned, ..vote },
            Vote { candidate: vote.candidate ^ turned, ..vote },
            Vote { voter: vote.voter ^ turned, ..vote },
        ] {
            assert!(check(&vote, &signature).is_err(), "bit {bit}: {vote:?}");
        }
    }
    for (bit, flipped) in flips(&vote.network.0) {
        let network = Hash(flipped.try_into().unwrap());
        assert!(check(&Vote { network, ..vote }, &signature).is_err(), "bit {bit} of the network");
    }
}

#[test]
fn a_lie_with_one_bit_turned_proves_nothing() {
    let (_, msps) = members(vectors());
    let good = bytes(&vectors()["lies"][0], "lie");
    let proves = |lie: &[u8]| {
        let lie = Misbehaviour::from_bytes(lie)?;
        lie.signer(|der, time| msps.verify(der, &[], time).map_err(Rejection::from))
    };
    assert!(proves(&good).is_ok());
    for (bit, flipped) in flips(&good) {
        assert!(proves(&flipped).is_err(), "bit {bit}");
    }
}

/// The bytes of all proofs and checkpoints of the vectors.
fn all() -> Vec<Vec<u8>> {
    let steps = vectors()["ways"].as_array().unwrap().iter().flat_map(|way| way["steps"].as_array().unwrap());
    let proofs = steps.map(|step| bytes(step, "proof"));
    let beginnings = vectors()["beginnings"].as_object().unwrap().values();
    let checkpoints = beginnings.filter(|begin| begin["genesis"].is_null()).map(|begin| bytes(begin, "checkpoint"));
    proofs.chain(checkpoints).collect()
}

/// Everything that voters of the vectors have signed.
fn signed() -> BTreeSet<Vec<u8>> {
    let good = vectors()["ways"].as_array().unwrap().iter().filter(|way| way["refused"].is_null());
    let steps = good.flat_map(|way| way["steps"].as_array().unwrap());
    let proofs = steps.map(|step| Proof::from_bytes(&bytes(step, "proof")).unwrap());
    proofs.map(|proof| proof.certificate.statement.to_bytes()).collect()
}

proptest! {
    #[test]
    fn parts_of_good_bytes_put_together_are_never_believed_beyond_what_was_signed(
        one in any::<prop::sample::Index>(),
        other in any::<prop::sample::Index>(),
        cuts in [any::<prop::sample::Index>(), any::<prop::sample::Index>(), any::<prop::sample::Index>()],
        noise in prop::collection::vec(any::<u8>(), 0..9),
    ) {
        let all = all();
        let (one, other) = (one.get(&all), other.get(&all));
        let [end, begin, behind] = cuts;
        let (end, begin) = (end.index(one.len() + 1), begin.index(other.len() + 1));
        let behind = begin + behind.index(other.len() - begin + 1);
        let mixed = [&one[..end], &noise, &other[begin..behind], &one[end..]].concat();
        let spliced = [&one[..end], &noise, &other[begin..]].concat();
        for bytes in [mixed, spliced] {
            let network = hash(&vectors()["beginnings"]["genesis"], "network");
            if let Ok(found) = Checkpoint::from_bytes(&network, &bytes) {
                prop_assert_eq!(&found.to_bytes()[..], &bytes[..]);
            }
            if let Ok(found) = Certificate::from_bytes(&bytes) {
                prop_assert_eq!(&found.to_bytes()[..], &bytes[..]);
            }
            let Ok(proof) = Proof::from_bytes(&bytes) else { continue };
            prop_assert_eq!(&proof.to_bytes()[..], &bytes[..]);
            let known = begun(&vectors()["beginnings"]["genesis"]).unwrap();
            if known.follow(&[], &proof).is_ok() {
                prop_assert!(signed().contains(&proof.certificate.statement.to_bytes()));
            }
        }
    }

    #[test]
    fn checkpoints_of_garbage_are_refused_without_a_panic(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
        let inner = [b"ledgerd checkpoint v1\0".as_slice(), &bytes].concat();
        prop_assert!(Checkpoint::from_bytes(&Hash::ZERO, &bytes).is_err());
        prop_assert!(Checkpoint::from_bytes(&Hash::ZERO, &inner).is_err());
    }
}
