//! Messages of confidential services.

use super::*;
use crate::fixture::{grant, service};
use ledger_base::hash::Hash;
use ledger_confidential::{Keyring, ReadingKey, Sealer};
use ledger_contract::{Limits, Reader, Readers, Share};

const ID: &str = "T/cmd_vel";

fn confidential() -> Service {
    Service { confidential: true, ..service("exclusive") }
}

fn twist(linear: f64) -> Bytes {
    let mut message = vec![0, 1, 0, 0];
    message.extend([linear, 0.0, 0.0, 0.0, 0.0, 0.0].iter().flat_map(|number: &f64| number.to_le_bytes()));
    message.into()
}

/// A reader, and what Salma shares with it.
fn shared(network: &Network) -> (Keyring, Share, Sealer) {
    let id: Hash = network.salma.network;
    let keyring = Keyring::new(id, "Org2/T".to_owned(), ReadingKey::generate());
    let reader = Reader { reader: "Org2/T".into(), key: keyring.public_hex(), serial: String::new(), may_read: true };
    let readers = Readers { service: ID.into(), readers: vec![reader], keys: vec![] };
    let (share, fresh) = Sealer::share(&id, "Org1/Salma", &readers).unwrap();
    (keyring, share, fresh.shared_at(9))
}

fn keyed(gate: &mut Gate, user: &User, signer: &User, share: &Share, service: &'static str) -> Result<(), Refused> {
    let args = vec![Bytes::from(service), Bytes::from("3"), Bytes::from(serde_json::to_vec(share).unwrap())];
    let signed = signer.sign("abac", "share", args);
    let delivered = Delivered { block_time: NOW, transaction: signed.encoded(), certificate: &user.certificate };
    gate.keyed(9, delivered)
}

#[test]
fn a_gate_without_the_content_key_lets_nothing_pass_and_with_it_slows_down_what_is_too_fast() {
    let network = Network::default();
    let (salma, (keyring, share, sealer)) = (&network.salma, shared(&network));
    let limits = Limits { max_linear_mm_s: Some(500), ..Limits::default() };
    let mut gate = network.gate(&confidential(), &[Grant { limits, ..grant("Org1/Salma", 3) }]);
    let sealed = |seq: u64, speed: f64| sealer.seal(3, seq, &twist(speed)).unwrap();
    let one = salma.set(3, 1, &[sealed(1, 0.2)]);
    assert_eq!(deliver(&mut gate, salma, &one), Err(Refused::NoKey), "no reader");
    gate.read_with(keyring);
    assert_eq!(deliver(&mut gate, salma, &one), Err(Refused::NoKey), "no content key yet");
    keyed(&mut gate, salma, salma, &share, ID).unwrap();
    let two = salma.set(3, 2, &[sealed(2, 0.2), sealed(3, 2.0)]);
    let delivered = Delivered { block_time: NOW, transaction: two.encoded(), certificate: &salma.certificate };
    let passed = gate.pass(delivered, now()).unwrap();
    assert_eq!((passed.samples.len(), passed.clamped), (2, 1));
    assert_eq!(passed.samples[0].wire(), &twist(0.2));
    assert!(passed.samples[1].wire() != &twist(2.0) && !passed.samples[1].wire().is_empty());
}

#[test]
fn what_is_not_encrypted_for_this_place_does_not_pass() {
    let network = Network::default();
    let (salma, (keyring, share, sealer)) = (&network.salma, shared(&network));
    let mut gate = network.gate(&confidential(), &[grant("Org1/Salma", 3)]);
    gate.read_with(keyring);
    keyed(&mut gate, salma, salma, &share, ID).unwrap();
    let good = sealer.seal(3, 1, &TWIST[0]).unwrap();
    let mut changed = good.to_vec();
    *changed.last_mut().unwrap() ^= 1;
    for (seq, payload) in [(1, TWIST[0].clone()), (2, good.clone()), (1, Bytes::from(changed))] {
        let signed = salma.set(3, seq, &[payload]);
        assert_eq!(deliver(&mut gate, salma, &signed), Err(Refused::Unreadable), "sequence {seq}");
    }
    assert_eq!(
        deliver(&mut gate, salma, &salma.set(3, 1, &[sealer.seal(3, 1, b"no CDR").unwrap()])),
        Err(Refused::BadPayload)
    );
    assert_eq!(deliver(&mut gate, salma, &salma.set(3, 1, &[vec![0; 2000].into()])), Err(Refused::TooLarge));
    assert_eq!(deliver(&mut gate, salma, &salma.set(3, 1, &[good])), Ok(1), "what was refused uses up nothing");
    let mut plain = network.gate(&service("exclusive"), &[grant("Org1/Salma", 3)]);
    let signed = salma.set(3, 1, &[sealer.seal(3, 1, &TWIST[0]).unwrap()]);
    assert_eq!(deliver(&mut plain, salma, &signed), Err(Refused::BadPayload), "a service that is not confidential");
}

#[test]
fn a_content_key_is_taken_from_its_publisher_only() {
    let network = Network::default();
    let (salma, farhad, (keyring, share, sealer)) = (&network.salma, &network.farhad, shared(&network));
    let mut gate = network.gate(&confidential(), &[grant("Org1/Salma", 3)]);
    assert_eq!(keyed(&mut gate, salma, salma, &share, ID), Ok(()), "a gate that reads nothing takes none");
    gate.read_with(keyring);
    assert_eq!(keyed(&mut gate, salma, salma, &share, "Husky/cmd_vel"), Err(Refused::WrongCall));
    let forger = User { key: farhad.key.clone(), ..salma.clone() };
    assert_eq!(keyed(&mut gate, salma, &forger, &share, ID), Err(Refused::BadSignature));
    assert_eq!(
        keyed(&mut gate, farhad, farhad, &share, ID),
        Ok(()),
        "one that was wrapped in another's name opens nothing"
    );
    let signed = salma.set(3, 1, &[sealer.seal(3, 1, &TWIST[0]).unwrap()]);
    assert_eq!(deliver(&mut gate, salma, &signed), Err(Refused::NoKey));
    for args in [vec![], vec![ID, "3"], vec![ID, "3", "{"], vec![ID, "3", "{}"]] {
        let signed = salma.sign("abac", "share", args.into_iter().map(Bytes::from).collect());
        let delivered = Delivered { block_time: NOW, transaction: signed.encoded(), certificate: &salma.certificate };
        assert!(gate.keyed(9, delivered).is_err());
    }
    keyed(&mut gate, salma, salma, &share, ID).unwrap();
    assert_eq!(deliver(&mut gate, salma, &signed), Ok(1));
}
