//! The identities that a network believes.

use crate::authority::{Ca, NONE, NOW, YEAR, ca_params, network, params};
use ledger_identity::IdentityError;
use ledger_identity::msp::{Msp, Msps, PRESENTED_MAX, Usage};
use rcgen::{
    BasicConstraints, CertificateParams, CustomExtension, ExtendedKeyUsagePurpose, IsCa, KeyPair, KeyUsagePurpose,
    date_time_ymd,
};

fn refusal(network: &Msps, ca: &Ca, params: &CertificateParams) -> IdentityError {
    network.verify(&ca.issue(params), NONE, NOW).unwrap_err()
}

#[test]
fn a_certificate_of_an_organisation_is_that_organisations_identity() {
    let (one, two) = (Ca::new("ca.org1"), Ca::new("ca.org2"));
    let network = network([one.msp("Org1"), two.msp("Org2")]);
    let certificate = one.user("Salma");
    let salma = network.verify(&certificate, NONE, NOW).unwrap();
    assert_eq!(salma.id(), "Org1/Salma");
    assert_eq!(salma.fingerprint, ledger_base::hash::Hash::of(&[&certificate]).0);
    assert_eq!(network.verify(&two.user("Salma"), NONE, NOW).unwrap().id(), "Org2/Salma");
}

#[test]
fn a_certificate_of_an_unknown_authority_is_refused_with_both_names() {
    let network = network([Ca::new("ca.org1").msp("Org1"), Ca::new("ca.org2").msp("Org2")]);
    let refused = network.verify(&Ca::new("ca.org9").user("Eve"), NONE, NOW).unwrap_err();
    assert_eq!(
        refused.to_string(),
        "the certificate is not trusted: found issuer \"CN=ca.org9\", wanted a CA of Org1 or Org2"
    );
    assert!(matches!(Msps::new().verify(&Ca::new("ca").user("Eve"), NONE, NOW), Err(IdentityError::Untrusted { .. })));
}

#[test]
fn an_authority_that_only_has_the_right_name_is_refused() {
    let network = network([Ca::new("ca.org1").msp("Org1")]);
    let refused = network.verify(&Ca::new("ca.org1").user("Eve"), NONE, NOW).unwrap_err();
    assert!(matches!(refused, IdentityError::BadSignature { .. }), "{refused}");
}

#[test]
fn a_changed_certificate_is_refused() {
    let ca = Ca::new("ca.org1");
    let network = network([ca.msp("Org1")]);
    let certificate = ca.user("Salma");
    let place = certificate.windows(5).position(|found| found == b"Salma").unwrap();
    let mut changed = certificate.to_vec();
    changed[place] = b'X';
    let refused = network.verify(&changed, NONE, NOW).unwrap_err();
    assert!(matches!(refused, IdentityError::BadSignature { .. }), "{refused}");
}

#[test]
fn a_certificate_is_valid_from_its_first_to_its_last_microsecond() {
    let ca = Ca::new("ca.org1");
    let network = network([ca.msp("Org1")]);
    let mut params = params("Salma", None);
    params.not_before = date_time_ymd(2029, 12, 31);
    params.not_after = date_time_ymd(2030, 1, 2);
    let certificate = ca.issue(&params);
    let day = 24 * 3600 * 1_000_000;
    let (first, last) = (NOW - day, NOW + day + 999_999);
    let salma = network.verify(&certificate, NONE, NOW).unwrap();
    assert_eq!((salma.not_before, salma.not_after), (first, last));
    for at in [first, last] {
        network.verify(&certificate, NONE, at).unwrap();
        salma.check_validity(at).unwrap();
    }
    for refused in [network.verify(&certificate, NONE, first - 1).map(|_| ()), salma.check_validity(first - 1)] {
        assert!(matches!(refused, Err(IdentityError::NotYetValid { not_before, .. }) if not_before == first));
    }
    for refused in [network.verify(&certificate, NONE, last + 1).map(|_| ()), salma.check_validity(last + 1)] {
        assert!(matches!(refused, Err(IdentityError::Expired { not_after, .. }) if not_after == last));
    }
    let text = salma.check_validity(last + 1).unwrap_err().to_string();
    assert!(text.contains("2030") && text.contains("Salma"), "{text}");
}

#[test]
fn an_expired_root_verifies_nothing_any_more() {
    let mut short = ca_params("ca.org1");
    short.not_after = date_time_ymd(2029, 6, 1);
    let ca = Ca::from_params(short);
    let certificate = ca.user("Salma");
    let network = network([ca.msp("Org1")]);
    let salma = network.verify(&certificate, NONE, NOW - YEAR / 2 - YEAR / 4).unwrap();
    assert!(salma.not_after < NOW, "an identity is not valid for longer than its root");
    let refused = network.verify(&certificate, NONE, NOW).unwrap_err();
    assert!(matches!(&refused, IdentityError::Expired { subject, .. } if subject.contains("ca.org1")), "{refused}");
}

#[test]
fn a_root_that_is_not_valid_yet_verifies_nothing() {
    let mut late = ca_params("ca.org1");
    late.not_before = date_time_ymd(2030, 6, 1);
    let ca = Ca::from_params(late);
    let refused = network([ca.msp("Org1")]).verify(&ca.user("Salma"), NONE, NOW).unwrap_err();
    assert!(matches!(refused, IdentityError::NotYetValid { .. }), "{refused}");
}

#[test]
fn a_renewed_root_of_the_same_name_verifies_beside_the_old_one() {
    let mut old = ca_params("ca.org1");
    old.not_after = date_time_ymd(2029, 6, 1);
    let (old, new) = (Ca::from_params(old), Ca::new("ca.org1"));
    let network = network([Msp::new("Org1", &[old.der(), new.der()], NONE).unwrap()]);
    assert_eq!(network.verify(&new.user("Salma"), NONE, NOW).unwrap().id(), "Org1/Salma");
    let refused = network.verify(&old.user("Salma"), NONE, NOW).unwrap_err();
    assert!(matches!(refused, IdentityError::Expired { .. }), "{refused}");
}

#[test]
fn an_intermediate_verifies_when_declared_and_when_presented() {
    let root = Ca::new("root.org1");
    let intermediate = root.below(ca_params("ica.org1"));
    let certificate = intermediate.user("Salma");
    let declared = network([Msp::new("Org1", &[root.der()], &[intermediate.der()]).unwrap()]);
    assert_eq!(declared.verify(&certificate, NONE, NOW).unwrap().id(), "Org1/Salma");
    let undeclared = network([root.msp("Org1")]);
    assert_eq!(undeclared.verify(&certificate, &[intermediate.der()], NOW).unwrap().id(), "Org1/Salma");
    assert_eq!(undeclared.verify(&certificate, &[intermediate.der(), root.der()], NOW).unwrap().id(), "Org1/Salma");
    let refused = undeclared.verify(&certificate, NONE, NOW).unwrap_err();
    assert!(matches!(refused, IdentityError::Untrusted { .. }), "{refused}");
}

#[test]
fn an_authority_stands_while_it_leads_to_a_root() {
    let (root, other) = (Ca::new("root.org1"), Ca::new("root.org2"));
    let middle = root.below(ca_params("middle.org1"));
    let low = middle.below(ca_params("low.org1"));
    let names = |intermediates: &[&Ca]| {
        let ders: Vec<_> = intermediates.iter().map(|ca| ca.der()).collect();
        Msp::new("Org1", &[root.der()], &ders).unwrap().standing().len()
    };
    let foreign = other.below(ca_params("foreign"));
    assert_eq!((names(&[]), names(&[&middle]), names(&[&low, &middle])), (1, 2, 3));
    assert_eq!((names(&[&low]), names(&[&foreign])), (1, 1));
    let salma = network([Msp::new("Org1", &[root.der()], &[low.der(), middle.der()]).unwrap()]);
    let salma = salma.verify(&low.user("Salma"), NONE, NOW).unwrap();
    assert!(Msp::new("Org1", &[root.der()], &[middle.der(), low.der()]).unwrap().standing().contains(&salma.issuer));
}

#[test]
fn an_expired_intermediate_verifies_nothing_any_more() {
    let root = Ca::new("root.org1");
    let mut short = ca_params("ica.org1");
    short.not_after = date_time_ymd(2029, 6, 1);
    let intermediate = root.below(short);
    let network = network([Msp::new("Org1", &[root.der()], &[intermediate.der()]).unwrap()]);
    let refused = network.verify(&intermediate.user("Salma"), NONE, NOW).unwrap_err();
    assert!(
        matches!(&refused, IdentityError::Expired { subject, .. } if subject.contains("intermediate")),
        "{refused}"
    );
}

#[test]
fn a_presented_root_is_not_believed() {
    let network = network([Ca::new("ca.org1").msp("Org1")]);
    let eve = Ca::new("ca.eve");
    let refused = network.verify(&eve.user("Eve"), &[eve.der()], NOW).unwrap_err();
    assert!(matches!(refused, IdentityError::Untrusted { .. }), "{refused}");
}

#[test]
fn a_user_cannot_issue_certificates() {
    let ca = Ca::new("ca.org1");
    let network = network([ca.msp("Org1")]);
    let eve = ca.below(params("Eve", None));
    let refused = network.verify(&eve.user("Admin"), &[eve.der()], NOW).unwrap_err();
    assert!(matches!(refused, IdentityError::NotAnAuthority { found: "no CA:TRUE", .. }), "{refused}");
    let mut no_usage = ca_params("ica");
    no_usage.key_usages = vec![KeyUsagePurpose::DigitalSignature];
    let ica = ca.below(no_usage);
    let refused = network.verify(&ica.user("Admin"), &[ica.der()], NOW).unwrap_err();
    assert!(matches!(refused, IdentityError::NotAnAuthority { wanted: "keyCertSign", .. }), "{refused}");
}

#[test]
fn a_root_must_be_an_authority() {
    let user = Ca::from_params(params("Salma", None));
    assert!(matches!(Msp::new("Org1", &[user.der()], NONE), Err(IdentityError::NotAnAuthority { .. })));
    let mut no_usage = ca_params("ca.org1");
    no_usage.key_usages = vec![KeyUsagePurpose::CrlSign];
    let root = Ca::from_params(no_usage);
    assert!(matches!(Msp::new("Org1", &[root.der()], NONE), Err(IdentityError::NotAnAuthority { .. })));
    assert!(matches!(Msp::new("Org1", NONE, NONE), Err(IdentityError::Malformed { .. })));
}

#[test]
fn the_path_length_of_a_root_is_kept() {
    let mut flat = ca_params("root.org1");
    flat.is_ca = IsCa::Ca(BasicConstraints::Constrained(0));
    let root = Ca::from_params(flat);
    let intermediate = root.below(ca_params("ica.org1"));
    let network = network([root.msp("Org1")]);
    network.verify(&root.user("Salma"), NONE, NOW).unwrap();
    let refused = network.verify(&intermediate.user("Salma"), &[intermediate.der()], NOW).unwrap_err();
    assert!(matches!(refused, IdentityError::BadPath { .. }), "{refused}");
}

#[test]
fn an_authority_is_not_an_identity() {
    let ca = Ca::new("ca.org1");
    let network = network([ca.msp("Org1")]);
    for certificate in [ca.der(), ca.below(ca_params("ica.org1")).der()] {
        let refused = network.verify(&certificate, NONE, NOW).unwrap_err();
        assert!(matches!(refused, IdentityError::Authority { .. }), "{refused}");
    }
}

#[test]
fn a_certificate_is_used_for_what_it_was_issued() {
    let ca = Ca::new("ca.org1");
    let network = network([ca.msp("Org1")]);
    let mut encryption = params("Salma", None);
    encryption.key_usages = vec![KeyUsagePurpose::KeyEncipherment];
    assert!(matches!(refusal(&network, &ca, &encryption), IdentityError::WrongUsage { .. }));
    let mut signing = params("Salma", None);
    signing.key_usages = vec![KeyUsagePurpose::DigitalSignature];
    network.verify(&ca.issue(&signing), NONE, NOW).unwrap();

    let accepts = |purposes: &[ExtendedKeyUsagePurpose], usage| {
        let mut params = params("node1", Some("node"));
        params.extended_key_usages = purposes.to_vec();
        network.verify_for(usage, &ca.issue(&params), NONE, NOW).is_ok()
    };
    use ExtendedKeyUsagePurpose::{Any, ClientAuth, EmailProtection, ServerAuth};
    for (purposes, client, server) in [
        (vec![], true, true),
        (vec![Any], true, true),
        (vec![ClientAuth, ServerAuth], true, true),
        (vec![ClientAuth], true, false),
        (vec![ServerAuth], false, true),
        (vec![EmailProtection], false, false),
    ] {
        assert_eq!(accepts(&purposes, Usage::Client), client, "{purposes:?} as client");
        assert_eq!(accepts(&purposes, Usage::Server), server, "{purposes:?} as server");
    }
}

#[test]
fn an_unreadable_extension_does_not_pass_as_an_absent_one() {
    let ca = Ca::new("ca.org1");
    let network = network([ca.msp("Org1")]);
    for oid in [[2, 5, 29, 15], [2, 5, 29, 19], [2, 5, 29, 37]] {
        let mut params = params("Salma", None);
        params.custom_extensions.push(CustomExtension::from_oid_content(&oid, vec![0x04, 0x01, 0xff]));
        let refused = refusal(&network, &ca, &params);
        assert!(matches!(refused, IdentityError::Malformed { .. }), "{oid:?} gave {refused}");
    }
}

#[test]
fn authorities_may_sign_with_ed25519_p256_and_p384() {
    for algorithm in [&rcgen::PKCS_ED25519, &rcgen::PKCS_ECDSA_P256_SHA256, &rcgen::PKCS_ECDSA_P384_SHA384] {
        let ca = Ca::with_algorithm("ca.org1", algorithm);
        network([ca.msp("Org1")]).verify(&ca.user("Salma"), NONE, NOW).unwrap();
    }
}

#[test]
fn a_key_of_p384_is_accepted() {
    let ca = Ca::new("ca.org1");
    let key = KeyPair::generate_for(&rcgen::PKCS_ECDSA_P384_SHA384).unwrap();
    let certificate = params("Salma", None).signed_by(&key, &ca.0).unwrap().der().clone();
    network([ca.msp("Org1")]).verify(&certificate, NONE, NOW).unwrap();
}

#[test]
fn an_authority_belongs_to_one_organisation() {
    let ca = Ca::new("ca.org1");
    let mut network = network([ca.msp("Org1")]);
    let refused = network.insert(ca.msp("Org2")).unwrap_err();
    assert!(matches!(refused, IdentityError::SharedAuthority { .. }), "{refused}");
    let refused = network.insert(Ca::new("ca.org1").msp("Org2")).unwrap_err();
    assert!(matches!(refused, IdentityError::SharedAuthority { .. }), "only the name is the same: {refused}");
    assert!(network.get("Org2").is_none(), "a refused organisation leaves no trace");
    network.insert(ca.msp("Org1")).unwrap();
    assert!(network.remove("Org1"));
    network.insert(ca.msp("Org2")).unwrap();
    assert_eq!(network.verify(&ca.user("Salma"), NONE, NOW).unwrap().id(), "Org2/Salma");
}

#[test]
fn an_organisation_cannot_speak_in_the_name_of_anothers_authority() {
    let (one, two) = (Ca::new("ca.org1"), Ca::new("ca.org2"));
    let network = network([one.msp("Org1"), two.msp("Org2")]);
    // Org2 issues an intermediate with the name of Org1's authority: revocations name issuers, so they would mix.
    let pretender = two.below(ca_params("ca.org1"));
    let refused = network.verify(&pretender.user("Salma"), &[pretender.der()], NOW).unwrap_err();
    assert!(matches!(refused, IdentityError::BadSignature { .. }), "{refused}");
}

#[test]
fn a_removed_organisation_is_not_believed_any_more() {
    let ca = Ca::new("ca.org1");
    let mut network = network([ca.msp("Org1")]);
    assert!(network.remove("Org1"));
    assert!(!network.remove("Org1"));
    assert!(matches!(network.verify(&ca.user("Salma"), NONE, NOW), Err(IdentityError::Untrusted { .. })));
}

#[test]
fn more_presented_certificates_than_a_path_needs_are_refused() {
    let root = Ca::new("root.org1");
    let network = network([root.msp("Org1")]);
    let presented: Vec<_> = (0..=PRESENTED_MAX).map(|n| root.below(ca_params(&n.to_string())).der()).collect();
    let refused = network.verify(&root.user("Salma"), &presented, NOW).unwrap_err();
    assert!(matches!(refused, IdentityError::TooLarge { max: PRESENTED_MAX, .. }), "{refused}");
    let twins = [root.below(ca_params("ica")).der(), root.below(ca_params("ica")).der()];
    let refused = network.verify(&root.user("Salma"), &twins, NOW).unwrap_err();
    assert!(matches!(refused, IdentityError::Malformed { .. }), "{refused}");
}
