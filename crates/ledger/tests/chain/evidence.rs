//! Evidence from files that real nodes made: it proves what it says, and nothing after the smallest change.

use ledger::evidence::{Evidence, Step};
use ledger_base::hash::Hash;
use ledger_base::rejection::Code;
use ledger_light::Change;
use ledger_light::fact::Fact;
use serde_json::Value;

fn vectors() -> (Vec<u8>, Vec<Value>) {
    let text = std::fs::read_to_string("../../../tests/fixtures/evidence.json").unwrap();
    let vectors: Value = serde_json::from_str(&text).unwrap();
    (hex::decode(vectors["genesis"].as_str().unwrap()).unwrap(), vectors["files"].as_array().unwrap().clone())
}

fn bytes(file: &Value) -> Vec<u8> {
    hex::decode(file["evidence"].as_str().unwrap()).unwrap()
}

#[test]
fn evidence_proves_what_its_vector_says() {
    let (genesis, files) = vectors();
    assert_eq!(files.len(), 2);
    for file in files {
        let evidence = Evidence::from_bytes(&bytes(&file)).unwrap();
        assert_eq!(evidence.to_bytes(), bytes(&file));
        let proved = evidence.check(&genesis, None).unwrap();
        assert_eq!(proved.transaction.id().to_string(), file["transaction"].as_str().unwrap());
        assert_eq!(
            (proved.signer.id(), proved.header.height),
            (file["signer"].as_str().unwrap().into(), file["height"].as_u64().unwrap())
        );
        assert_eq!(Some(u64::from(proved.verdict.code)), file["code"].as_u64());
    }
}

#[test]
fn a_verdict_is_proved_by_the_certificate_of_a_later_block() {
    let (genesis, files) = vectors();
    let mut evidence = Evidence::from_bytes(&bytes(&files[1])).unwrap();
    let proved = evidence.check(&genesis, None).unwrap();
    assert!(proved.certified.0 > proved.header.height, "the block of this one is not certified");
    assert_eq!(evidence.link.verdict.later.len() as u64, proved.certified.0 - proved.header.height);
    // Another verdict leads to another digest.
    let Fact::Verdict { index, id, response, .. } = Fact::from_bytes(&evidence.link.verdict.verdict.fact).unwrap()
    else {
        panic!("another fact")
    };
    let made_up = Fact::Verdict { index, id, code: 3002, response };
    evidence.link.verdict.verdict.fact = made_up.to_bytes().into();
    assert_eq!(evidence.check(&genesis, None).unwrap_err().code, Code::Untrusted);
}

#[test]
fn no_changed_byte_and_no_part_of_evidence_is_believed() {
    let (genesis, files) = vectors();
    for file in files {
        let whole = bytes(&file);
        let end = whole.len() - 32;
        for at in 0..whole.len() {
            let mut changed = whole.clone();
            changed[at] ^= 1;
            assert!(Evidence::from_bytes(&changed).is_err(), "byte {at}");
            assert!(Evidence::from_bytes(&whole[..at]).is_err(), "cut at {at}");
            // Whoever changes a byte makes the hash at the end anew.
            let hash = Hash::of(&[&changed[..end]]);
            changed[end..].copy_from_slice(&hash.0);
            let forged = Evidence::from_bytes(&changed).and_then(|evidence| evidence.check(&genesis, None));
            assert!(at >= end || forged.is_err(), "byte {at}");
        }
    }
}

#[test]
fn changes_that_stand_where_the_way_does_not_look_are_not_believed() {
    let (genesis, files) = vectors();
    let mut evidence = Evidence::from_bytes(&bytes(&files[0])).unwrap();
    let writes = vec![(bytes::Bytes::from_static(b"msp\0revoked/x"), Some("{}".into()))];
    let proof = Some(evidence.link.proof.clone());
    evidence.steps.push(Step { changes: Vec::new(), proof });
    evidence.steps.push(Step { changes: vec![Change { height: 1, writes }], proof: None });
    assert_eq!(evidence.check(&genesis, None).unwrap_err().code, Code::Untrusted);
}

#[test]
fn evidence_of_one_network_proves_nothing_in_another() {
    let (genesis, files) = vectors();
    let other = String::from_utf8(genesis).unwrap().replace("\"label\": \"", "\"label\": \"x");
    let evidence = Evidence::from_bytes(&bytes(&files[0])).unwrap();
    assert!(evidence.check(other.as_bytes(), None).is_err());
}
