//! The people of a Fabric organisation come with the certificates that they have: an MSP directory as a Fabric CA leaves it,
//! made here, with real nodes and `ledgerctl`.

use crate::support::readme::console;
use crate::support::{Ctl, Fleet, eventually};
use ledger_base::hash::Hash;
use ledger_identity::Role;
use ledger_identity::certificate::{ATTRIBUTES_OID, Certificate, encode_attributes};
use ledger_identity::key::SigningKey;
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::{Child, Stdio};
use testkit::List;
use testkit::rcgen::{
    self, BasicConstraints, CertificateParams, CertifiedIssuer, CustomExtension, DnType, IsCa, KeyPair, KeyUsagePurpose,
};

type Issuer = CertifiedIssuer<'static, KeyPair>;

/// As `fabric-ca-server` writes it.
const CONFIG: &str = "\
NodeOUs:
  Enable: true
  ClientOUIdentifier:
    Certificate: intermediatecerts/ica-org3-example-com.pem
    OrganizationalUnitIdentifier: client
  PeerOUIdentifier:
    Certificate: intermediatecerts/ica-org3-example-com.pem
    OrganizationalUnitIdentifier: peer
  AdminOUIdentifier:
    Certificate: intermediatecerts/ica-org3-example-com.pem
    OrganizationalUnitIdentifier: admin
  OrdererOUIdentifier:
    Certificate: intermediatecerts/ica-org3-example-com.pem
    OrganizationalUnitIdentifier: orderer
";

/// A Fabric organisation on disk.
pub struct Fabric {
    directory: PathBuf,
    intermediate: Issuer,
}

fn key(algorithm: &'static rcgen::SignatureAlgorithm) -> KeyPair {
    KeyPair::generate_for(algorithm).unwrap()
}

fn authority(name: &str) -> CertificateParams {
    let mut params = CertificateParams::default();
    params.distinguished_name = rcgen::DistinguishedName::new();
    params.distinguished_name.push(DnType::OrganizationName, "org3.example.com");
    params.distinguished_name.push(DnType::CommonName, name);
    params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
    params.key_usages = vec![KeyUsagePurpose::DigitalSignature, KeyUsagePurpose::KeyCertSign, KeyUsagePurpose::CrlSign];
    params
}

fn seconds() -> u64 {
    crate::support::network::now() / 1_000_000
}

impl Fabric {
    pub fn new(directory: &Path) -> Self {
        let root = CertifiedIssuer::self_signed(authority("ca.org3"), key(&rcgen::PKCS_ECDSA_P256_SHA256)).unwrap();
        let params = authority("ica.org3");
        let intermediate = CertifiedIssuer::signed_by(params, key(&rcgen::PKCS_ECDSA_P384_SHA384), &root).unwrap();
        let tls = CertifiedIssuer::self_signed(authority("tlsca.org3"), key(&rcgen::PKCS_ECDSA_P256_SHA256)).unwrap();
        let fabric = Self { directory: directory.to_owned(), intermediate };
        fabric.write("MSP/cacerts/ca-org3-example-com.pem", &root.pem());
        fabric.write("MSP/intermediatecerts/ica-org3-example-com.pem", &fabric.intermediate.pem());
        fabric.write("MSP/tlscacerts/tlsca.pem", &tls.pem());
        fabric.write("MSP/config.yaml", CONFIG);
        fabric
    }

    fn write(&self, name: &str, content: &str) {
        let path = self.directory.join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, content).unwrap();
    }

    /// Somebody with the directories `signcerts` and `keystore`; answers with the serial number.
    pub fn user(
        &self,
        name: &str,
        unit: &str,
        attributes: &[(&str, &str)],
        algorithm: &'static rcgen::SignatureAlgorithm,
    ) -> Vec<u8> {
        let mut params = CertificateParams::default();
        params.distinguished_name = rcgen::DistinguishedName::new();
        params.distinguished_name.push(DnType::OrganizationalUnitName, unit);
        params.distinguished_name.push(DnType::CommonName, name);
        params.key_usages = vec![KeyUsagePurpose::DigitalSignature];
        if !attributes.is_empty() {
            let map = attributes.iter().map(|(name, value)| ((*name).to_owned(), (*value).to_owned())).collect();
            let json = encode_attributes(&map).unwrap();
            params.custom_extensions.push(CustomExtension::from_oid_content(ATTRIBUTES_OID, json));
        }
        let key = key(algorithm);
        let certificate = params.signed_by(&key, &self.intermediate).unwrap();
        self.write(&format!("{name}/signcerts/cert.pem"), &certificate.pem());
        self.write(&format!("{name}/keystore/priv_sk"), &key.serialize_pem());
        Certificate::parse(certificate.der()).unwrap().serial
    }

    /// A revocation list as Fabric's CA writes it: without a number.
    pub fn list(&self, name: &str, age: u64, serials: &[Vec<u8>]) {
        let list = List {
            this_update: seconds() - age,
            next_update: Some(seconds() + 86_400),
            serials: serials.to_vec(),
            ..List::default()
        };
        let issuer = Certificate::parse(self.intermediate.der()).unwrap().subject_name;
        let key = SigningKey::from_pkcs8_der(&self.intermediate.key().serialize_der()).unwrap();
        self.write(name, &pem::encode(&pem::Pem::new("X509 CRL", list.signed_as(issuer.der(), &key).to_vec())));
    }
}

/// Types a line of the document in the directory of the Fabric organisation; `words` stand for words in capitals.
fn type_line(ctl: &Ctl, fabric: &Fabric, line: &str, words: &[(&str, &str)]) -> String {
    let path = |word: &str| fabric.directory.join(word);
    let word = |word: &str| match words.iter().find(|(name, _)| *name == word) {
        Some((_, value)) => (*value).to_owned(),
        None if path(word).exists() => path(word).display().to_string(),
        None => word.to_owned(),
    };
    let typed: Vec<String> = line.split_whitespace().skip(1).map(word).collect();
    ctl.run(&typed).ok().stdout
}

fn begin(ctl: &Ctl, line: &[&str]) -> Child {
    ctl.command(line).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
}

fn held(ctl: &Ctl) -> usize {
    ctl.json(&["queue", "Rover"])["holders"].as_array().unwrap().len()
}

#[test]
fn the_people_of_a_fabric_organisation_move_in_ten_lines_and_its_lists_revoke_them() {
    let fleet = Fleet::found(2);
    fleet.issue("Org1", "Boss", Role::Admin, &[]);
    let owner = ledger_api::Context { name: "Owner".into(), ..fleet.owner() };
    owner.save(&fleet.home()).unwrap();
    let mut nodes = [fleet.nodes[0].start(), fleet.nodes[1].start()];
    let ctl = fleet.ctl();
    let fabric = Fabric::new(&fleet.path().join("fabric"));
    let rover = [("Rover", "true"), ("hf.Affiliation", "org3.sales"), ("hf.Type", "admin")];
    let salma_serial = fabric.user("salma", "client", &rover, &rcgen::PKCS_ECDSA_P256_SHA256);
    fabric.user("chief", "admin", &[], &rcgen::PKCS_ECDSA_P384_SHA384);
    fabric.user("plain", "client", &[], &rcgen::PKCS_ECDSA_P256_SHA256);
    fabric.user("stranger", "member", &rover, &rcgen::PKCS_ECDSA_P256_SHA256);
    let gone_serial = fabric.user("gone", "client", &rover, &rcgen::PKCS_ECDSA_P256_SHA256);
    fabric.list("MSP/crls/crl.pem", 600, std::slice::from_ref(&gone_serial));

    let boss = fleet.ctl().as_("Boss");
    let organisations: Value = eventually("the network is there", || {
        let ran = boss.run(&["network", "organisations", "-o", "json"]);
        (ran.code == 0).then(|| ran.json())
    });
    let fingerprint = organisations[0]["roots"][0]["fingerprint"].as_str().unwrap().to_owned();
    let address = fleet.nodes[0].address.clone();
    fabric.list("CRL", 60, std::slice::from_ref(&gone_serial));
    // Before anybody is asked: who could sign in, without a network?
    let msp = fabric.directory.join("MSP").display().to_string();
    let check = |who: &str| {
        let person = fabric.directory.join(who).display().to_string();
        ctl.run(&["network", "add-org", "Org3", "--msp", &msp, "--check", &person])
    };
    assert!(check("salma").ok().stdout.contains("Org3/salma could sign in"));
    check("gone").refused(2, &["LGR-2004", "could not sign in"]);
    check("stranger").refused(3, &["LGR-2005", "no role in the units"]);
    let lines = console("docs/fabric.md", "## Migration in ten commands");
    assert_eq!(lines.len(), 10);
    let mut printed = Vec::new();
    let mut id = String::new();
    for line in &lines {
        let words = [("NODE", address.as_str()), ("FINGERPRINT", fingerprint.as_str()), ("ID", id.as_str())];
        let text = type_line(&ctl, &fabric, line, &words);
        if let Some((_, rest)) = text.split_once("network approve ") {
            id = rest.split_whitespace().next().unwrap().to_owned();
        }
        if line.contains(" acquire ") {
            // For longer than the rest of this takes.
            ctl.as_("Salma").run(&["renew", "Rover", "--for", "10m"]).ok();
        }
        printed.push(text);
    }
    let root = std::fs::read(fabric.directory.join("MSP/cacerts/ca-org3-example-com.pem")).unwrap();
    let root = Hash::of(&[pem::parse(root).unwrap().contents()]).to_string();
    assert!(printed[0].contains(&root), "who approves sees which authority: {}", printed[0]);
    assert!(printed[6].contains("Org3/salma") && printed[6].contains("member") && printed[6].contains("Rover=true"));
    assert!(printed[6].contains("accepted by the ledger"), "{}", printed[6]);

    // Nobody has more than its certificate says.
    let import = |name: &str, key: &str| {
        let certificate = fabric.directory.join(name).join("signcerts/cert.pem").display().to_string();
        let key = fabric.directory.join(key).join("keystore/priv_sk").display().to_string();
        let line =
            ["identity", "import", "--cert", &certificate, "--key", &key, "--node", &address, "--ca-fingerprint"];
        ctl.as_(name).run(&[&line[..], &[&fingerprint]].concat())
    };
    import("plain", "plain").ok();
    import("gone", "gone").ok();
    import("gone", "plain").refused(3, &["LGR-7002", "the key does not belong to the certificate"]);
    import("stranger", "stranger").refused(3, &["no role in the units \"member\""]);
    let (salma, plain, gone) = (ctl.as_("Salma"), ctl.as_("plain"), ctl.as_("gone"));
    plain.run(&["acquire", "Rover"]).refused(2, &["LGR-3001"]);
    gone.run(&["acquire", "Rover"]).refused(2, &["LGR-2004"]);
    salma.run(&["identity", "list"]).refused(2, &["LGR-3010"]);
    boss.run(&["identity", "crl", &fabric.directory.join("CRL").display().to_string()]).refused(2, &["LGR-2001"]);

    // They are in no registry, so nothing is said about all of them; each asks about itself.
    let chief = ctl.as_("Chief");
    salma.run(&["can", "salma", "acquire", "Rover"]).ok();
    let could = chief.run(&["can", "chief", "acquire", "Rover", "--who-could"]);
    assert_eq!(could.code, 2, "{could:?}");
    assert!(could.stdout.contains("the ledger lists no identity of your organisation"), "{could:?}");
    let matrix = chief.run(&["can", "--matrix"]).ok().stdout;
    assert!(matrix.contains("Org3/chief") && !matrix.contains("salma"), "{matrix}");

    // Salma holds a robot and reads; then a list names her.
    assert_eq!(held(&salma), 1);
    let mut reading = begin(&salma, &["echo", "Rover/cmd_vel"]);
    let file = |name: &str| fabric.directory.join(name).display().to_string();
    fabric.list("older", 3600, &[gone_serial.clone(), salma_serial.clone()]);
    chief.run(&["identity", "crl", &file("older")]).refused(3, &["LGR-2013", "older"]);
    // It leaves out the one that the list before revoked.
    fabric.list("newest", 0, std::slice::from_ref(&salma_serial));
    salma.run(&["identity", "crl", &file("newest")]).refused(2, &["LGR-3010"]);
    let recorded = chief.json(&["identity", "crl", &file("newest")]);
    assert_eq!(recorded["serials"], serde_json::json!([hex::encode(&salma_serial)]));
    assert_eq!(recorded["left_out"], serde_json::json!([hex::encode(&gone_serial)]));
    let height = recorded["height"].as_u64().unwrap();
    assert_eq!(held(&plain), 0, "the grant ended in that block");
    let block = boss.json(&["block", &height.to_string()]);
    let told = block.to_string();
    assert!(told.contains("revocation_list") && told.contains("released"), "{told}");
    for revoked in [&salma, &gone] {
        revoked.run(&["acquire", "Rover"]).refused(2, &["LGR-2004"]);
    }
    eventually("the stream of Salma ends", || reading.try_wait().unwrap());
    // The list has a number, of which the node has seen whose it is.
    eventually("the audit names whom the list has revoked, and who brought it", || {
        let rows = boss.run(&["audit", "--user", "Org3/salma", "-o", "json"]).ok().stdout;
        let mut rows = rows.lines().map(|row| serde_json::from_str::<Value>(row).unwrap());
        rows.find(|row| row["decision"] == "revoked" && row["who"] == "Org3/salma" && row["by"] == "Org3/chief")
    });
    let known = boss.json(&["identity", "crl"]);
    assert_eq!((&known[0]["listed"], &known[0]["stale"]), (&1.into(), &"refuse".into()));
    assert!(boss.run(&["status"]).ok().stdout.contains("ica.org3"), "a node says until when the list holds");

    // Nobody waits for a list: an admin revokes a person by name.
    plain.run(&["whoami"]).ok();
    let shown = chief.run(&["identity", "revoke", "plain", "--reason", "laptop stolen"]).ok().stdout;
    assert!(
        shown.contains("certificates of plain whose validity begins before") && shown.contains("check the spelling"),
        "{shown}"
    );
    plain.run(&["acquire", "Rover"]).refused(2, &["LGR-2004"]);

    // All of it is there after a restart.
    nodes[0].interrupt();
    nodes[0] = fleet.nodes[0].start();
    eventually("the node is back", || (salma.run(&["acquire", "Rover"]).code == 2).then_some(()));
    salma.run(&["acquire", "Rover"]).refused(2, &["LGR-2004"]);
    for node in &mut nodes {
        node.check();
        node.interrupt();
    }
}
