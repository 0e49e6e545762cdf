//! The vectors of whole ways: where a reader begins, the steps that it is shown, and what it believes after them. Or the
//! code with which it refuses the last one of them.

use crate::vectors::{bytes, fact_json, hash, number, text};
use ledger_base::rejection::{Code, Rejection};
use ledger_light::{Change, Checkpoint, Governance, Proof, Way};
use serde_json::{Value, json};

/// Where a way begins. A checkpoint is of use to its reader only if enough voters in it have signed its proof.
pub(crate) fn begun(begin: &Value) -> Result<Governance, Rejection> {
    let network = hash(begin, "network");
    if begin["checkpoint"].is_null() {
        let genesis = Change::from_bytes(0, &bytes(begin, "writes"))?;
        return Governance::founded(network, number(begin, "time"), &genesis);
    }
    let Checkpoint { governance, proof } = Checkpoint::from_bytes(&network, &bytes(begin, "checkpoint"))?;
    governance.check(&proof.certificate)?;
    Ok(governance)
}

/// The belief of a reader after a step, and the facts that it was shown.
pub(crate) fn stepped(known: &Governance, step: &Value) -> Result<(Governance, Vec<Value>), Rejection> {
    let change = |change: &Value| Change::from_bytes(number(change, "height"), &bytes(change, "writes"));
    let changes: Vec<_> = step["changes"].as_array().unwrap().iter().map(change).collect::<Result<_, _>>()?;
    let proof = Proof::from_bytes(&bytes(step, "proof"))?;
    let facts = proof.others()?;
    Ok((known.follow(&changes, &proof)?, facts.iter().map(fact_json).collect()))
}

/// All of a way.
pub(crate) fn gone(begin: &Value, steps: &[Value]) -> Result<Value, Rejection> {
    let mut known = begun(begin)?;
    let mut facts = Vec::new();
    for (number, step) in (1..).zip(steps) {
        let after = stepped(&known, step);
        assert!(after.is_ok() || number == steps.len(), "only the last step is refused: {:?}", after.err());
        (known, facts) = after?;
    }
    let voters = known.voters()?;
    Ok(json!({"height": known.height(), "time": known.time(), "governing": known.chain(), "facts": facts,
              "voters": voters.voters, "outgoing": voters.outgoing}))
}

#[test]
fn readers_end_where_the_vectors_say_and_refuse_as_they_say() {
    let vectors = crate::vectors::vectors();
    let (ways, beginnings) = (vectors["ways"].as_array().unwrap(), &vectors["beginnings"]);
    let refused = ways.iter().filter(|way| way["gives"].is_null()).count();
    assert!(refused > 50 && ways.len() - refused > 15, "{refused} of {} are refused", ways.len());
    for way in ways {
        let found = gone(&beginnings[text(way, "begin")], way["steps"].as_array().unwrap());
        match found {
            Ok(gives) => assert_eq!(gives, way["gives"], "{}", text(way, "name")),
            Err(reason) => {
                assert_eq!(reason.code.name(), text(way, "refused"), "{}: {reason:?}", text(way, "name"));
                assert!(!text(way, "why").is_empty());
            }
        }
    }
}

#[test]
fn changes_that_no_proof_covers_are_bounded_however_often_a_true_proof_is_shown_between_them() {
    let vectors = crate::vectors::vectors();
    let ways = vectors["ways"].as_array().unwrap();
    let good = ways.iter().find(|way| !way["gives"].is_null() && way["steps"].as_array().unwrap().len() == 1).unwrap();
    let step = &good["steps"][0];
    let mut way = Way::from(begun(&vectors["beginnings"][text(good, "begin")]).unwrap());
    for change in step["changes"].as_array().unwrap() {
        way.change(number(change, "height"), &bytes(change, "writes")).unwrap();
    }
    let proof = Proof::from_bytes(&bytes(step, "proof")).unwrap();
    way.follow(proof.clone());
    let large = Change {
        height: u64::MAX,
        writes: (0..12_u8).map(|key| (vec![key].into(), Some(vec![0; 1 << 20].into()))).collect(),
    };
    let mut shown = || {
        way.change(large.height, &large.to_bytes())?;
        way.follow(proof.clone());
        Ok::<_, Rejection>(())
    };
    let refused = (0..16).find_map(|_| shown().err()).unwrap();
    assert_eq!(refused.code, Code::TooLarge, "{refused}");
    assert!(way.end().is_ok(), "the proof was followed each time");
}
