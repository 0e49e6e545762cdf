//! The fields that are read from a certificate.

use crate::authority::{Ca, NONE, NOW, attributes, network, params, with_attributes};
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::certificate::{ATTRIBUTES_MAX, CERTIFICATE_BYTES_MAX, encode_attributes};
use ledger_identity::msp::Msp;
use ledger_identity::{IdentityError, Role};
use rcgen::{DnType, SanType};
use rustls_pki_types::CertificateDer;
use rustls_pki_types::pem::PemObject;
use std::collections::BTreeMap;

fn refused_attributes(json: &[u8]) -> IdentityError {
    let ca = Ca::new("ca.org1");
    let certificate = ca.issue(&with_attributes(params("Salma", None), json));
    network([ca.msp("Org1")]).verify(&certificate, NONE, NOW).unwrap_err()
}

#[test]
fn a_certificate_in_the_form_of_fabric_is_read_with_its_role_and_attributes() {
    let root = CertificateDer::from_pem_slice(include_bytes!("fixtures/fabric-root.pem")).unwrap();
    let user = CertificateDer::from_pem_slice(include_bytes!("fixtures/fabric-user.pem")).unwrap();
    let network = network([Msp::new("Org1", &[root], NONE).unwrap()]);
    let salma = network.verify(&user, NONE, NOW).unwrap();
    assert_eq!(salma.id(), "Org1/Salma");
    assert_eq!(salma.role, Role::Member);
    assert_eq!(salma.attributes.get("Turtlebot4").map(String::as_str), Some("true"));
    assert_eq!(salma.attributes.len(), 4);
    assert_eq!(hex::encode(&salma.serial), "2e0534ac85772ccb66afa2f13245c77791516ceb");
    assert_eq!(salma.revocation_key().len(), 32 + 20);
}

#[test]
fn roles_are_read_in_our_words_and_fabrics() {
    let ca = Ca::new("ca.org1");
    let network = network([ca.msp("Org1")]);
    for (unit, role) in [
        (None, Role::Member),
        (Some("department1"), Role::Member),
        (Some("member"), Role::Member),
        (Some("client"), Role::Member),
        (Some("admin"), Role::Admin),
        (Some("node"), Role::Node),
        (Some("peer"), Role::Node),
        (Some("orderer"), Role::Node),
        (Some("robot"), Role::Robot),
        (Some("Admin"), Role::Member),
    ] {
        let certificate = ca.issue(&params("x", unit));
        assert_eq!(network.verify(&certificate, NONE, NOW).unwrap().role, role, "{unit:?}");
    }
}

#[test]
fn a_role_is_found_in_several_units_of_their_own_rdn() {
    let root = CertificateDer::from_pem_slice(include_bytes!("fixtures/units-root.pem")).unwrap();
    let network = network([Msp::new("Org1", &[root], NONE).unwrap()]);
    let robot = CertificateDer::from_pem_slice(include_bytes!("fixtures/units-robot.pem")).unwrap();
    assert_eq!(network.verify(&robot, NONE, NOW).unwrap().role, Role::Robot);
    let both = CertificateDer::from_pem_slice(include_bytes!("fixtures/units-two-roles.pem")).unwrap();
    let refused = network.verify(&both, NONE, NOW).unwrap_err().to_string();
    assert!(refused.contains("the roles admin and member"), "{refused}");
}

#[test]
fn a_certificate_without_the_extension_has_no_attributes() {
    let ca = Ca::new("ca.org1");
    let salma = network([ca.msp("Org1")]).verify(&ca.user("Salma"), NONE, NOW).unwrap();
    assert!(salma.attributes.is_empty());
}

#[test]
fn attributes_are_read_as_they_were_written() {
    let ca = Ca::new("ca.org1");
    let json = attributes(&[("Turtlebot4", "true"), ("Husky", ""), ("ö", "\"quoted\"")]);
    let certificate = ca.issue(&with_attributes(params("Salma", None), &json));
    let salma = network([ca.msp("Org1")]).verify(&certificate, NONE, NOW).unwrap();
    assert_eq!(encode_attributes(&salma.attributes).unwrap(), json);
    assert_eq!(salma.attributes.get("ö").map(String::as_str), Some("\"quoted\""));
}

#[test]
fn attributes_in_any_other_form_are_refused() {
    let nested = [&[0x0c, 12][..], br#"{"attrs":{}}"#].concat();
    for json in [
        b"".as_slice(),
        b"garbage",
        br#"{}"#,
        br#"{"attrs":null}"#,
        br#"{"attrs":[]}"#,
        br#"{"attrs":{"a":1}}"#,
        br#"{"attrs":{"a":{"b":"c"}}}"#,
        br#"{"attrs":{"a":"1"}}x"#,
        br#"{"attrs":{"a":"1"},"more":"2"}"#,
        br#"{"attrs":{"":"1"}}"#,
        br#"{"attrs":{},"attrs":{"a":"1"}}"#,
        b"{\"attrs\":{\"a\":\"\xff\"}}",
        &nested,
    ] {
        let refused = refused_attributes(json);
        assert!(matches!(refused, IdentityError::Malformed { .. }), "{} gave {refused}", json.escape_ascii());
    }
}

#[test]
fn an_attribute_that_is_given_twice_is_refused() {
    let refused = refused_attributes(br#"{"attrs":{"Husky":"false","Husky":"true"}}"#).to_string();
    assert!(refused.contains("a name given twice"), "{refused}");
}

#[test]
fn too_many_or_too_long_attributes_are_refused_when_read_and_when_written() {
    let pairs: Vec<String> = (0..=ATTRIBUTES_MAX).map(|n| format!("\"{n}\":\"\"")).collect();
    let refused = refused_attributes(format!("{{\"attrs\":{{{}}}}}", pairs.join(",")).as_bytes()).to_string();
    assert!(refused.contains("more than 64 names"), "{refused}");
    let refused = refused_attributes(format!("{{\"attrs\":{{\"a\":\"{}\"}}}}", "x".repeat(4096)).as_bytes());
    assert!(matches!(refused, IdentityError::TooLarge { max: 4096, .. }), "{refused}");

    let many: BTreeMap<_, _> = (0..=ATTRIBUTES_MAX).map(|n| (n.to_string(), String::new())).collect();
    assert!(matches!(encode_attributes(&many), Err(IdentityError::TooLarge { found: 65, .. })));
    let long = BTreeMap::from([("a".to_owned(), "x".repeat(4096))]);
    assert!(matches!(encode_attributes(&long), Err(IdentityError::TooLarge { .. })));
    let unnamed = BTreeMap::from([(String::new(), "x".to_owned())]);
    assert!(matches!(encode_attributes(&unnamed), Err(IdentityError::Malformed { .. })));
}

#[test]
fn two_attribute_extensions_are_refused() {
    let ca = Ca::new("ca.org1");
    let json = attributes(&[("Husky", "true")]);
    let certificate = ca.issue(&with_attributes(with_attributes(params("Salma", None), &json), &json));
    let refused = network([ca.msp("Org1")]).verify(&certificate, NONE, NOW).unwrap_err();
    assert!(matches!(refused, IdentityError::Malformed { .. }), "{refused}");
}

#[test]
fn names_that_could_be_mistaken_are_refused() {
    let ca = Ca::new("ca.org1");
    let network = network([ca.msp("Org1")]);
    for name in ["", "Org2/Salma", "Sal\nma", "Sal\u{7f}ma", &"x".repeat(129)] {
        let refused = network.verify(&ca.user(name), NONE, NOW).unwrap_err();
        assert!(matches!(refused, IdentityError::BadName { .. }), "{name:?} gave {refused}");
        assert!(!refused.to_string().contains('\n'), "{refused}");
        assert!(Msp::new(name, &[ca.der()], NONE).is_err(), "{name:?} as organisation");
    }
    assert_eq!(network.verify(&ca.user(&"x".repeat(128)), NONE, NOW).unwrap().name.len(), 128);
    let mut nameless = params("x", None);
    nameless.distinguished_name = rcgen::DistinguishedName::new();
    nameless.distinguished_name.push(DnType::OrganizationName, "Org1");
    let refused = network.verify(&ca.issue(&nameless), NONE, NOW).unwrap_err().to_string();
    assert!(refused.contains("0 common names"), "{refused}");
}

#[test]
fn the_organisation_in_the_subject_is_not_believed() {
    let ca = Ca::new("ca.org1");
    let mut params = params("Salma", None);
    params.distinguished_name.push(DnType::OrganizationName, "Org2");
    let salma = network([ca.msp("Org1")]).verify(&ca.issue(&params), NONE, NOW).unwrap();
    assert_eq!(salma.id(), "Org1/Salma");
}

#[test]
fn an_oversized_certificate_is_refused_before_it_is_parsed() {
    let ca = Ca::new("ca.org1");
    let network = network([ca.msp("Org1")]);
    let mut params = params("Salma", None);
    let host: String = format!("{}.example", "x".repeat(50));
    params.subject_alt_names = (0..400).map(|_| SanType::DnsName(host.clone().try_into().unwrap())).collect();
    let certificate = ca.issue(&params);
    assert!(certificate.len() > CERTIFICATE_BYTES_MAX);
    let refused = network.verify(&certificate, NONE, NOW).unwrap_err();
    assert!(matches!(refused, IdentityError::TooLarge { max: CERTIFICATE_BYTES_MAX, .. }), "{refused}");
}

#[test]
fn a_refusal_carries_its_code_and_what_to_do() {
    let ca = Ca::new("ca.org1");
    let refused = network([ca.msp("Org1")]).verify(&Ca::new("ca.org9").user("Eve"), NONE, NOW).unwrap_err();
    let rejection = Rejection::from(refused);
    assert_eq!(rejection.code, Code::Untrusted);
    assert_eq!(rejection.message, "the certificate is not trusted");
    assert!(rejection.found.contains("ca.org9") && rejection.wanted.contains("Org1"), "{rejection}");
    assert!(!rejection.advice().is_empty());
}
