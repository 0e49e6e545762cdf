#![expect(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]

use super::*;
use ledger_identity::certificate::Certificate;
use rcgen::{
    BasicConstraints, CertificateParams, CertificateRevocationListParams, CertifiedIssuer, DnType, IsCa, KeyIdMethod,
    KeyPair, KeyUsagePurpose, SerialNumber, date_time_ymd,
};
use std::os::unix::fs::symlink;
use tempfile::TempDir;

/// 2030-01-01, microseconds since the UNIX epoch.
const NOW: u64 = 1_893_456_000_000_000;

type Issuer = CertifiedIssuer<'static, KeyPair>;

fn params(name: &str) -> CertificateParams {
    let mut params = CertificateParams::default();
    params.distinguished_name.push(DnType::CommonName, name);
    params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
    params.key_usages = vec![KeyUsagePurpose::KeyCertSign, KeyUsagePurpose::CrlSign];
    params
}

fn key() -> KeyPair {
    KeyPair::generate_for(&rcgen::PKCS_ECDSA_P256_SHA256).unwrap()
}

fn crl(ca: &Issuer, day: u8) -> String {
    let params = CertificateRevocationListParams {
        this_update: date_time_ymd(2030, 1, day),
        next_update: date_time_ymd(2030, 2, 1),
        crl_number: SerialNumber::from(u64::from(day)),
        issuing_distribution_point: None,
        revoked_certs: Vec::new(),
        key_identifier_method: KeyIdMethod::Sha256,
    };
    params.signed_by(ca).unwrap().pem().unwrap()
}

const CONFIG: &str = "\
NodeOUs:
  Enable: true
  ClientOUIdentifier:
    Certificate: cacerts/ca.pem
    OrganizationalUnitIdentifier: client
  PeerOUIdentifier:
    Certificate: cacerts/ca.pem
    OrganizationalUnitIdentifier: peer
  AdminOUIdentifier:
    OrganizationalUnitIdentifier: \"admin\"
  OrdererOUIdentifier:
    Certificate: intermediatecerts/below.pem
    OrganizationalUnitIdentifier: orderer
";

struct Place {
    directory: TempDir,
    root: Issuer,
}

impl Place {
    fn new() -> Self {
        let root = CertifiedIssuer::self_signed(params("ca.org3"), key()).unwrap();
        let below = CertifiedIssuer::signed_by(params("below.org3"), key(), &root).unwrap();
        let tls = CertifiedIssuer::self_signed(params("tls.org3"), key()).unwrap();
        let place = Self { directory: tempfile::tempdir().unwrap(), root };
        place.write("cacerts/ca.pem", &place.root.pem());
        place.write("intermediatecerts/below.pem", &below.pem());
        place.write("tlscacerts/tls.pem", &tls.pem());
        place.write("config.yaml", CONFIG);
        place.write("crls/crl.pem", &crl(&place.root, 2));
        place.write("crls/old.pem", &crl(&place.root, 1));
        place.write("keystore/secret_sk", "never read");
        place
    }

    fn write(&self, name: &str, content: &str) {
        let path = self.directory.path().join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, content).unwrap();
    }

    fn read(&self) -> Result<MspDirectory, Rejection> {
        MspDirectory::read(self.directory.path(), "Org3", NOW)
    }

    /// The refusal with this file.
    fn refused_with(name: &str, content: &str) -> Rejection {
        let place = Self::new();
        place.write(name, content);
        place.read().unwrap_err()
    }
}

#[test]
fn a_directory_gives_authorities_units_and_the_newest_list_of_each_authority() {
    let place = Place::new();
    let read = place.read().unwrap();
    assert_eq!((read.roots.len(), read.intermediates.len(), read.lists.len()), (1, 1, 1));
    assert_eq!(RevocationList::parse(&read.lists[0]).unwrap().number, Some(vec![2]), "the newer one");
    let issuer = |der: &[u8]| Some(ledger_base::hash::Hash::of(&[der]));
    let units: Vec<_> = read.units.iter().map(|unit| (unit.unit.as_str(), unit.role, unit.issuer)).collect();
    assert_eq!(
        units,
        [
            ("client", Role::Member, issuer(&read.roots[0])),
            ("admin", Role::Admin, None),
            ("peer", Role::Node, issuer(&read.roots[0])),
            ("orderer", Role::Node, issuer(&read.intermediates[0])),
        ]
    );
    assert_eq!(read.warnings.len(), 1, "{:?}", read.warnings);
    assert!(read.warnings[0][0].contains("tlscacerts"));
}

#[test]
fn without_node_units_everybody_is_a_member_and_that_is_said() {
    for config in ["", "NodeOUs:\n  Enable: false\n", "---\n"] {
        let place = Place::new();
        place.write("config.yaml", config);
        let read = place.read().unwrap();
        assert_eq!(read.units, Units::default());
        assert!(read.warnings.iter().any(|[warning, _]| warning.contains("no unit of admins")));
    }
    let place = Place::new();
    fs::remove_file(place.directory.path().join("config.yaml")).unwrap();
    assert_eq!(place.read().unwrap().units, Units::default());
}

#[test]
fn a_configuration_that_is_not_understood_is_refused_and_never_overlooked() {
    let deep = format!("NodeOUs: {}1{}", "{a: ".repeat(20_000), "}".repeat(20_000));
    let flow = format!("NodeOUs: {}", "{a: ".repeat(3_000));
    let big = format!("NodeOUs:\n  Enable: true\n{}", " ".repeat(20_000));
    let wide = format!("{}\n", "? ".repeat(5_000));
    for (config, part) in [
        (deep.as_str(), "bytes"),
        (flow.as_str(), "too deep"),
        (big.as_str(), "bytes"),
        (wide.as_str(), ""),
        ("OrganizationalUnitIdentifiers:\n- OrganizationalUnitIdentifier: sales\n", "list"),
        ("OrganizationalUnitIdentifiers: x\n", "OrganizationalUnitIdentifiers"),
        ("NodeOUs:\n  Enable: true\n  Enable: false\n", "twice"),
        ("NodeOUs:\n  Enable: perhaps\n", "perhaps"),
        ("NodeOUs:\n  Enable: true\n", "name no unit"),
        ("NodeOUs: &a\n  Enable: *a\n", ""),
        (
            "NodeOUs:\n  Enable: true\n  RobotOUIdentifier:\n    OrganizationalUnitIdentifier: robot\n",
            "RobotOUIdentifier",
        ),
        (
            "NodeOUs:\n  Enable: true\n  AdminOUIdentifier:\n    Certificate: ../../etc/passwd\n    OrganizationalUnitIdentifier: a\n",
            "passwd",
        ),
        ("a: 1\n---\nb: 2\n", ""),
        ("just text", "a text alone"),
        ("\u{1b}[2J: 1\n", ""),
    ] {
        let refused = Place::refused_with("config.yaml", config);
        assert_eq!(refused.code, Code::BadFile, "{refused}");
        assert!(refused.message.contains("config.yaml") && refused.found.contains(part), "{part:?}: {refused}");
        assert!(!refused.found.contains('\u{1b}'), "{refused:?}");
    }
}

#[test]
fn garbage_in_any_part_is_refused_with_the_name_of_its_file() {
    let stranger = CertifiedIssuer::self_signed(params("ca.org9"), key()).unwrap();
    let root = Place::new().root.pem();
    let cut = &root[..root.len() / 2];
    let half = root.replace("-----END", "AAAA\n-----END");
    let many = root.repeat(9);
    let huge = "x".repeat(FILE_BYTES_MAX + 1);
    for part in ["cacerts", "intermediatecerts", "tlscacerts"] {
        for content in ["", "garbage", cut, &half, &many, &huge] {
            let refused = Place::refused_with(&format!("{part}/odd.pem"), content);
            assert!(refused.code == Code::BadFile && refused.message.contains("odd.pem"), "{part}: {refused}");
        }
    }
    for content in ["", "garbage", &crl(&stranger, 3), &root, &huge] {
        let refused = Place::refused_with("crls/odd.pem", content);
        assert!(refused.code == Code::BadFile && refused.message.contains("odd.pem"), "{refused}");
    }
    let user = {
        let mut params = CertificateParams::default();
        params.distinguished_name.push(DnType::CommonName, "Salma");
        params.signed_by(&key(), &stranger).unwrap().pem()
    };
    assert_eq!(Place::refused_with("cacerts/user.pem", &user).code, Code::CertificateMalformed, "no authority");
}

#[test]
fn links_and_what_is_no_file_are_not_followed() {
    for (name, target) in
        [("cacerts/link.pem", "/dev/zero"), ("crls/link.pem", "../cacerts/ca.pem"), ("tlscacerts/x.pem", "x.pem")]
    {
        let place = Place::new();
        symlink(target, place.directory.path().join(name)).unwrap();
        let refused = place.read().unwrap_err();
        assert!(refused.found == "a link" && refused.advice().contains("cp -rL"), "{refused}");
    }
    let place = Place::new();
    fs::create_dir(place.directory.path().join("cacerts/directory")).unwrap();
    assert_eq!(place.read().unwrap_err().found, "no file");
    let place = Place::new();
    fs::remove_dir_all(place.directory.path().join("crls")).unwrap();
    symlink("/etc", place.directory.path().join("crls")).unwrap();
    assert_eq!(place.read().unwrap_err().wanted, "a directory");
    let place = Place::new();
    for number in 0..=ENTRIES_MAX {
        place.write(&format!("crls/{number}.pem"), "");
    }
    assert!(place.read().unwrap_err().found.contains("entries"));
    let empty = tempfile::tempdir().unwrap();
    let refused = MspDirectory::read(empty.path(), "Org3", NOW).unwrap_err();
    assert!(refused.wanted.contains("cacerts/*.pem"), "{refused}");
}

#[test]
fn a_list_is_read_in_either_form() {
    let place = Place::new();
    let pem = place.directory.path().join("crls/crl.pem");
    let der = list(&pem).unwrap();
    fs::write(place.directory.path().join("crl.der"), &der).unwrap();
    assert_eq!(list(&place.directory.path().join("crl.der")).unwrap(), der);
    let chain = chain(&place.directory.path().join("cacerts/ca.pem")).unwrap();
    assert!(Certificate::parse(&chain[0]).is_ok() && chain.len() == 1);
}
