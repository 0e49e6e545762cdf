//! Keys and signatures.

use ledger_identity::key::{KeyError, KeyKind, PublicKey, SignatureError, SigningKey};
use proptest::prelude::*;
use ring::rand::SystemRandom;

const KINDS: [KeyKind; 3] = [KeyKind::Ed25519, KeyKind::P256, KeyKind::P384];

/// The kinds of ECDSA, each with the order of its group (least significant byte last), and as a lax verifier has it.
const CURVES: [(KeyKind, &str, &ring::signature::EcdsaVerificationAlgorithm, usize); 2] = [
    (
        KeyKind::P256,
        "ffffffff00000000ffffffffffffffffbce6faada7179e84f3b9cac2fc632551",
        &ring::signature::ECDSA_P256_SHA256_ASN1,
        26,
    ),
    (
        KeyKind::P384,
        "ffffffffffffffffffffffffffffffffffffffffffffffffc7634d81f4372ddf581a0db248b0a77aecec196accc52973",
        &ring::signature::ECDSA_P384_SHA384_ASN1,
        23,
    ),
];

fn key(kind: KeyKind) -> SigningKey {
    SigningKey::generate(kind, &SystemRandom::new()).unwrap()
}

/// Reads the two integers of a DER signature, without any of the rules.
fn numbers(der: &[u8]) -> (Vec<u8>, Vec<u8>) {
    let r = usize::from(der[3]);
    (der[4..4 + r].to_vec(), der[6 + r..].to_vec())
}

fn signature(r: &[u8], s: &[u8]) -> Vec<u8> {
    let content = [&[2, r.len() as u8], r, &[2, s.len() as u8], s].concat();
    [&[0x30, content.len() as u8], content.as_slice()].concat()
}

/// n - s, as a DER integer.
fn negated(s: &[u8], order: &str) -> Vec<u8> {
    let order = hex::decode(order).unwrap();
    let padded = [vec![0; order.len() + 1 - s.len()], s.to_vec()].concat();
    let mut result = vec![0; order.len()];
    let mut borrow = 0;
    for place in (0..order.len()).rev() {
        let difference = i32::from(order[place]) - i32::from(padded[place + 1]) - borrow;
        borrow = i32::from(difference < 0);
        result[place] = difference.rem_euclid(256) as u8;
    }
    let digits = result.iter().position(|byte| *byte != 0).unwrap();
    let padding: &[u8] = if result[digits] >= 0x80 { &[0] } else { &[] };
    [padding, &result[digits..]].concat()
}

#[test]
fn a_signature_verifies_only_with_its_message_and_key() {
    for kind in KINDS {
        let signer = key(kind);
        let signature = signer.sign(b"forward");
        signer.public_key().verify(b"forward", &signature).unwrap();
        assert_eq!(signer.public_key().verify(b"back", &signature), Err(SignatureError::Mismatch(kind)));
        assert_eq!(key(kind).public_key().verify(b"forward", &signature), Err(SignatureError::Mismatch(kind)));
    }
}

#[test]
fn every_ecdsa_signature_we_make_is_low_and_its_high_twin_is_refused() {
    for (kind, order, lax, head) in CURVES {
        let signer = key(kind);
        for round in 0..64u32 {
            let message = round.to_be_bytes();
            let ours = signer.sign(&message);
            signer.public_key().verify(&message, &ours).unwrap();
            let (r, s) = numbers(&ours);
            let twin = signature(&r, &negated(&s, order));
            // The twin is a valid signature to whoever does not insist on low s.
            ring::signature::UnparsedPublicKey::new(lax, &signer.public_key().to_spki()[head..])
                .verify(&message, &twin)
                .unwrap();
            assert_eq!(signer.public_key().verify(&message, &twin), Err(SignatureError::HighS));
        }
    }
}

#[test]
fn another_encoding_of_an_ecdsa_signature_is_refused() {
    for (kind, ..) in CURVES {
        no_other_encoding(&key(kind));
    }
}

fn no_other_encoding(signer: &SigningKey) {
    let ours = signer.sign(b"stop");
    let (r, s) = numbers(&ours);
    let padded = [&[0], r.as_slice()].concat();
    let mut indefinite = ours.clone();
    indefinite[1] = 0x80;
    let long_form = [&[0x30, 0x81, ours[1]], &ours[2..]].concat();
    let trailing = [ours.as_slice(), &[0]].concat();
    let inner_trailing = [&[0x30, ours[1] + 1], &ours[2..], &[0]].concat();
    let fixed = [r.as_slice(), s.as_slice()].concat();
    for other in [
        signature(&padded, &s),
        indefinite,
        long_form,
        trailing,
        inner_trailing,
        fixed,
        signature(&[], &s),
        signature(&[0], &s),
        signature(&[0xff], &s),
        signature(&[1; 50], &s),
        Vec::new(),
    ] {
        let found = other.len();
        assert_eq!(
            signer.public_key().verify(b"stop", &other),
            Err(SignatureError::Encoding { found }),
            "{other:02x?}"
        );
    }
}

#[test]
fn an_ed25519_signature_of_another_length_is_refused() {
    let signer = key(KeyKind::Ed25519);
    let ours = signer.sign(b"stop");
    for cut in 0..ours.len() {
        let refused = signer.public_key().verify(b"stop", &ours[..cut]);
        assert_eq!(refused, Err(SignatureError::Length { found: cut }));
    }
}

/// A key, a message and a signature on which verifiers of Ed25519 disagree: a point of order 8 is added to R. An owner
/// of the key can make such signatures; RFC 8032 allows to accept and to refuse them, ZIP 215 accepts them.
fn disputed() -> (PublicKey, &'static [u8], Vec<u8>) {
    let key = hex::decode("ea4a6c63e29c520abef5507b132ec5f9954776aebebe7b92421eea691446d22c").unwrap();
    let signature = "c57077b154392b0b71e903bd8831bf29222550dad8280c56d2b0cc32ee16ee1f\
                     2d062d74e83c8e006e7162646149b6e8a3dbf81e3d2131b7e62d6b296a88b203";
    (PublicKey::from_ed25519(key.try_into().unwrap()), b"forward", hex::decode(signature).unwrap())
}

fn together(signed: &[(PublicKey, &[u8], Vec<u8>)]) -> bool {
    PublicKey::verify_together(signed.iter().map(|(key, message, signature)| (key, *message, signature.as_slice())))
}

#[test]
fn signatures_verify_together_exactly_if_each_verifies_alone() {
    let signers = [key(KeyKind::Ed25519), key(KeyKind::Ed25519)];
    let messages: [&[u8]; 3] = [b"forward", b"back", b"stop"];
    let mut signed: Vec<_> =
        signers.iter().flat_map(|key| messages.map(|message| (key.public_key(), message, key.sign(message)))).collect();
    signed.push(disputed());
    for (key, message, signature) in &signed {
        key.verify(message, signature).unwrap();
    }
    assert!(together(&signed));
    for place in 0..signed.len() {
        for (wrong_key, wrong_message, change) in [(true, false, 0), (false, true, 0), (false, false, 1)] {
            let mut changed = signed.clone();
            let (key, message, signature) = &mut changed[place];
            if wrong_key {
                *key = self::key(KeyKind::Ed25519).public_key();
            }
            if wrong_message {
                *message = b"faster";
            }
            signature[40] ^= change;
            assert!(key.verify(message, signature).is_err());
            assert!(!together(&changed), "{place} {wrong_key} {wrong_message} {change}");
        }
    }
}

#[test]
fn two_wrong_signatures_do_not_make_up_for_each_other() {
    // One s too large by as much as the other is too small: their plain sum is right.
    let signer = key(KeyKind::Ed25519);
    let mut signed = [b"forward", b"stop..."]
        .map(|message: &[u8; 7]| (signer.public_key(), message.as_slice(), signer.sign(message)));
    assert!(together(&signed));
    // Bytes in the middle of s, far from both ends of its range.
    signed[0].2[48] = signed[0].2[48].wrapping_add(1);
    signed[1].2[48] = signed[1].2[48].wrapping_sub(1);
    assert!(!together(&signed));
}

#[test]
fn keys_of_other_kinds_are_not_checked_together() {
    let signed = KINDS.map(key).map(|key| (key.public_key(), b"stop".as_slice(), key.sign(b"stop")));
    assert!(!together(&signed));
    assert!(together(&signed[..1]));
}

#[test]
fn a_key_under_which_one_signature_fits_every_message_is_refused() {
    // The points of order 1, 2, 4 and 8, and other encodings of the first two.
    let weak = [
        "0100000000000000000000000000000000000000000000000000000000000000",
        "ecffffffffffffffffffffffffffffffffffffffffffffffffffffffffffff7f",
        "0000000000000000000000000000000000000000000000000000000000000000",
        "0000000000000000000000000000000000000000000000000000000000000080",
        "26e8958fc2b227b045c3f489f2ef98f0d5dfac05d3c63339b13802886d53fc05",
        "26e8958fc2b227b045c3f489f2ef98f0d5dfac05d3c63339b13802886d53fc85",
        "c7176a703d4dd84fba3c0b760d10670f2a2053fa2c39ccc64ec7fd7792ac037a",
        "c7176a703d4dd84fba3c0b760d10670f2a2053fa2c39ccc64ec7fd7792ac03fa",
        "0100000000000000000000000000000000000000000000000000000000000080",
        "eeffffffffffffffffffffffffffffffffffffffffffffffffffffffffffff7f",
    ];
    for weak in weak {
        let key = PublicKey::from_ed25519(hex::decode(weak).unwrap().try_into().unwrap());
        assert_eq!(PublicKey::from_spki(&key.to_spki()), Err(KeyError::WeakPublicKey), "{weak}");
    }
    let sound = disputed().0;
    assert_eq!(PublicKey::from_spki(&sound.to_spki()), Ok(sound));
}

#[test]
fn bytes_that_stand_for_no_point_are_no_key() {
    // No point of the curve has y = 2.
    let mut no_point = [0; 32];
    no_point[0] = 2;
    let key = PublicKey::from_ed25519(no_point);
    assert!(matches!(PublicKey::from_spki(&key.to_spki()), Err(KeyError::UnsupportedPublicKey { .. })));
    assert_eq!(key.verify(b"forward", &[0; 64]), Err(SignatureError::Mismatch(KeyKind::Ed25519)));
}

#[test]
fn a_key_survives_being_written_and_read() {
    for kind in KINDS {
        let made = key(kind);
        let from_pem = SigningKey::from_pkcs8_pem(&made.to_pkcs8_pem()).unwrap();
        let from_der = SigningKey::from_pkcs8_der(made.to_pkcs8_der()).unwrap();
        for read in [from_pem, from_der] {
            assert_eq!(read.kind(), kind);
            assert_eq!(read.public_key(), made.public_key());
            made.public_key().verify(b"turn", &read.sign(b"turn")).unwrap();
        }
        assert_eq!(PublicKey::from_spki(&made.public_key().to_spki()).unwrap(), made.public_key());
        rcgen::KeyPair::from_pem(&made.to_pkcs8_pem()).unwrap();
    }
}

#[test]
fn keys_made_by_openssl_are_read() {
    for (pem, kind) in [
        (include_str!("fixtures/openssl-ed25519.pem"), KeyKind::Ed25519),
        (include_str!("fixtures/openssl-p256.pem"), KeyKind::P256),
    ] {
        let key = SigningKey::from_pkcs8_pem(pem).unwrap();
        assert_eq!(key.kind(), kind);
        key.public_key().verify(b"go", &key.sign(b"go")).unwrap();
    }
}

#[test]
fn a_key_of_another_algorithm_is_refused_with_what_is_wanted() {
    let p521 = include_str!("fixtures/openssl-p521.pem");
    let refused = SigningKey::from_pem(p521).unwrap_err().to_string();
    assert!(refused.contains("wanted Ed25519, ECDSA P-256 or P-384"), "{refused}");
    let compressed = [&key(KeyKind::P384).public_key().to_spki()[..23], &[2; 49]].concat();
    assert!(matches!(PublicKey::from_spki(&compressed), Err(KeyError::UnsupportedPublicKey { .. })));
}

#[test]
fn a_key_in_an_old_form_is_refused_with_the_command_that_converts_it() {
    let text = "-----BEGIN EC PRIVATE KEY-----\nAAAA\n-----END EC PRIVATE KEY-----\n";
    let refused = SigningKey::from_pkcs8_pem(text).unwrap_err().to_string();
    assert!(refused.contains("try `openssl pkcs8 -topk8"), "{refused}");
}

#[test]
fn keys_of_other_software_are_read_in_either_form_and_told_apart_from_what_is_no_key() {
    for (pem, kind) in [
        (include_str!("fixtures/openssl-p256.pem"), KeyKind::P256),
        (include_str!("fixtures/openssl-p256-sec1.pem"), KeyKind::P256),
        (include_str!("fixtures/openssl-p384.pem"), KeyKind::P384),
        (include_str!("fixtures/openssl-p384-sec1.pem"), KeyKind::P384),
        (include_str!("fixtures/openssl-ed25519.pem"), KeyKind::Ed25519),
    ] {
        let key = SigningKey::from_pem(pem).unwrap();
        assert_eq!(key.kind(), kind);
        key.public_key().verify(b"go", &key.sign(b"go")).unwrap();
        let kept = SigningKey::from_pkcs8_pem(&key.to_pkcs8_pem()).unwrap();
        assert_eq!(kept.public_key(), key.public_key());
    }
    let cut = "-----BEGIN EC PRIVATE KEY-----\nMHcCAQEEIA==\n-----END EC PRIVATE KEY-----\n";
    assert!(matches!(SigningKey::from_pem(cut), Err(KeyError::Rejected { .. })));
    let locked = "-----BEGIN ENCRYPTED PRIVATE KEY-----\nAAAA\n-----END ENCRYPTED PRIVATE KEY-----\n";
    for none in [locked, "", "-----BEGIN CERTIFICATE-----"] {
        let refused = SigningKey::from_pem(none).unwrap_err().to_string();
        assert!(refused.contains("without a passphrase") && refused.contains("openssl pkey"), "{refused}");
    }
}

#[test]
fn an_oversized_key_is_refused_before_it_is_read() {
    assert_eq!(SigningKey::from_pkcs8_der(&[0; 5000]).unwrap_err(), KeyError::TooLarge { found: 5000 });
    assert_eq!(SigningKey::from_pkcs8_pem(&" ".repeat(5000)).unwrap_err(), KeyError::TooLarge { found: 5000 });
}

#[test]
fn a_kind_is_read_from_its_name_and_others_are_refused() {
    for kind in KINDS {
        assert_eq!(kind.to_string().parse(), Ok(kind));
    }
    let refused = "rsa".parse::<KeyKind>().unwrap_err().to_string();
    assert_eq!(refused, "found key kind \"rsa\", wanted \"ed25519\", \"p256\" or \"p384\"");
}

#[test]
fn the_secret_is_never_in_the_debug_text() {
    for kind in KINDS {
        let key = key(kind);
        let text = format!("{key:?}");
        assert!(text.contains("public_key") && text.len() < 250, "{text}");
        // The secret begins after at most 36 bytes of header in either form.
        let secret = hex::encode(&key.to_pkcs8_der()[36..44]);
        assert!(!text.contains(&secret), "{text}");
    }
}

proptest! {
    #[test]
    fn no_bytes_panic_as_signature_or_key(bytes in proptest::collection::vec(any::<u8>(), 0..160)) {
        for kind in KINDS {
            prop_assert!(key(kind).public_key().verify(b"go", &bytes).is_err());
        }
        prop_assert!(SigningKey::from_pkcs8_der(&bytes).is_err());
        prop_assert!(PublicKey::from_spki(&bytes).is_err());
    }
}
