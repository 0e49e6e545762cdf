//! Revocation lists: who may sign one, and what is no list.

use crate::authority::{Ca, NONE, ca_params};
use ledger_identity::IdentityError;
use ledger_identity::certificate::Certificate;
use ledger_identity::msp::Msp;
use ledger_identity::revocation_list::{LIST_BYTES_MAX, LISTED_MAX, RevocationList, Scope};
use proptest::prelude::*;
use rcgen::{
    CertificateRevocationListParams, KeyIdMethod, KeyUsagePurpose, RevokedCertParams, SerialNumber, date_time_ymd,
};

/// 2030-01-01, in microseconds since the UNIX epoch.
const MADE: u64 = 1_893_456_000_000_000;

fn list(ca: &Ca, serials: &[u64]) -> Vec<u8> {
    let revoked = |serial: &u64| RevokedCertParams {
        serial_number: SerialNumber::from(*serial),
        revocation_time: date_time_ymd(2029, 6, 1),
        reason_code: None,
        invalidity_date: None,
    };
    let params = CertificateRevocationListParams {
        this_update: date_time_ymd(2030, 1, 1),
        next_update: date_time_ymd(2030, 2, 1),
        crl_number: SerialNumber::from(7),
        issuing_distribution_point: None,
        revoked_certs: serials.iter().map(revoked).collect(),
        key_identifier_method: KeyIdMethod::Sha256,
    };
    params.signed_by(&ca.0).unwrap().der().to_vec()
}

#[test]
fn a_list_is_read_and_verified_against_the_authority_it_names_whatever_kind_its_key_has() {
    for algorithm in [&rcgen::PKCS_ED25519, &rcgen::PKCS_ECDSA_P256_SHA256, &rcgen::PKCS_ECDSA_P384_SHA384] {
        let ca = Ca::with_algorithm("ca.org1", algorithm);
        let (read, issuer) = ca.msp("Org1").verify_list(&list(&ca, &[5, 300])).unwrap();
        assert_eq!(issuer.name, Certificate::parse(&ca.der()).unwrap().subject_name.hash());
        assert_eq!(read.scope, Scope::default());
        assert_eq!(read.this_update, MADE);
        assert_eq!(read.next_update, Some(MADE + 31 * 86_400_000_000 + 999_999));
        assert_eq!(read.number, Some(vec![7]));
        assert_eq!(read.serials, [vec![5], vec![1, 44]].into(), "as the serial numbers of certificates");
    }
}

#[test]
fn a_list_of_somebody_else_is_refused_and_one_of_an_intermediate_is_not() {
    let (ca, twin, stranger) = (Ca::new("ca.org1"), Ca::new("ca.org1"), Ca::new("ca.org2"));
    let below = ca.below(ca_params("intermediate.org1"));
    let msp = Msp::new("Org1", &[ca.der()], &[below.der()]).unwrap();
    msp.verify_list(&list(&below, &[1])).unwrap();
    assert!(matches!(msp.verify_list(&list(&stranger, &[1])), Err(IdentityError::Untrusted { .. })));
    assert!(matches!(msp.verify_list(&list(&twin, &[1])), Err(IdentityError::BadSignature { .. })));
    // An authority that was renewed under its name stands there twice.
    let renewed = Msp::new("Org1", &[ca.der(), twin.der()], NONE).unwrap();
    renewed.verify_list(&list(&twin, &[1])).unwrap();
    let mut certificates_only = ca_params("ca.org1");
    certificates_only.key_usages = vec![KeyUsagePurpose::KeyCertSign];
    let may_not = Ca::from_params(certificates_only);
    // rcgen refuses to sign for it, so that the list of the same name and another key stands for it.
    let refused = may_not.msp("Org1").verify_list(&list(&ca, &[1])).unwrap_err();
    assert!(matches!(refused, IdentityError::WrongUsage { .. }), "{refused}");
}

#[test]
fn a_list_cut_or_changed_in_any_byte_says_nothing_else_and_a_huge_one_is_refused() {
    let ca = Ca::new("ca.org1");
    let (msp, good) = (ca.msp("Org1"), list(&ca, &[1, 2, 3]));
    let content = msp.verify_list(&good).unwrap();
    for cut in 0..good.len() {
        assert!(RevocationList::parse(&good[..cut]).is_err(), "cut at {cut}");
    }
    for place in 0..good.len() {
        let mut changed = good.clone();
        changed[place] ^= 1;
        // One byte stands outside of what is signed and says what the signed part says as well.
        let same = msp.verify_list(&changed).map_or(true, |read| read == content);
        assert!(same, "byte {place} of {}: {}", good.len(), hex::encode(&good));
    }
    assert!(RevocationList::parse(&[good, vec![0]].concat()).is_err());
    let too_large = RevocationList::parse(&vec![0x30; LIST_BYTES_MAX + 1]);
    assert!(matches!(too_large, Err(IdentityError::TooLarge { .. })));
    let serials: Vec<u64> = (1..=LISTED_MAX as u64 + 1).collect();
    msp.verify_list(&list(&ca, &serials[1..])).unwrap();
    assert!(matches!(msp.verify_list(&list(&ca, &serials)), Err(IdentityError::TooLarge { .. })));
}

proptest! {
    #[test]
    fn no_bytes_panic_as_a_list(bytes in proptest::collection::vec(any::<u8>(), 0..400)) {
        prop_assert!(RevocationList::parse(&bytes).is_err());
    }
}
