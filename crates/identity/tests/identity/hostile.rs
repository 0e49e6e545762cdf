//! Bytes that nobody honest sends.

use crate::authority::{Ca, NONE, NOW, attributes, network, params, with_attributes};
use ledger_identity::msp::Msp;
use proptest::prelude::*;
use rustls_pki_types::CertificateDer;
use std::sync::LazyLock;

static CA: LazyLock<Ca> = LazyLock::new(|| Ca::new("ca.org1"));
static CERTIFICATE: LazyLock<CertificateDer<'_>> =
    LazyLock::new(|| CA.issue(&with_attributes(params("Salma", Some("member")), &attributes(&[("Husky", "true")]))));

#[test]
fn a_certificate_cut_at_any_byte_is_refused() {
    let network = network([CA.msp("Org1")]);
    network.verify(&CERTIFICATE, NONE, NOW).unwrap();
    for cut in 0..CERTIFICATE.len() {
        assert!(network.verify(&CERTIFICATE[..cut], NONE, NOW).is_err(), "cut at {cut}");
        assert!(Msp::new("Org1", &[&CA.der()[..cut.min(CA.der().len() - 1)]], NONE).is_err(), "root cut at {cut}");
    }
    let trailing = [&CERTIFICATE[..], &[0]].concat();
    assert!(network.verify(&trailing, NONE, NOW).is_err());
}

#[test]
fn a_certificate_changed_in_any_byte_is_refused() {
    let network = network([CA.msp("Org1")]);
    for place in 0..CERTIFICATE.len() {
        for bit in [0x01, 0x80] {
            let mut changed = CERTIFICATE.to_vec();
            changed[place] ^= bit;
            assert!(network.verify(&changed, NONE, NOW).is_err(), "bit {bit} of byte {place}");
        }
    }
}

proptest! {
    #[test]
    fn no_bytes_pass_as_a_certificate(bytes in proptest::collection::vec(any::<u8>(), 0..600)) {
        let network = network([CA.msp("Org1")]);
        prop_assert!(network.verify(&bytes, NONE, NOW).is_err());
        prop_assert!(network.verify(&CERTIFICATE, &[CertificateDer::from(bytes.as_slice())], NOW).is_err());
        prop_assert!(Msp::new("Org1", &[&bytes], NONE).is_err());
    }

    #[test]
    fn no_overwritten_bytes_pass(at in 0usize..500, bytes in proptest::collection::vec(any::<u8>(), 1..40)) {
        let mut changed = CERTIFICATE.to_vec();
        for (to, from) in changed.iter_mut().skip(at).zip(&bytes) {
            *to = *from;
        }
        prop_assume!(changed != CERTIFICATE.as_ref());
        prop_assert!(network([CA.msp("Org1")]).verify(&changed, NONE, NOW).is_err());
    }

    #[test]
    fn no_attributes_panic(json in proptest::collection::vec(any::<u8>(), 0..300)) {
        let certificate = CA.issue(&with_attributes(params("Salma", None), &json));
        let _ = network([CA.msp("Org1")]).verify(&certificate, NONE, NOW);
    }
}
