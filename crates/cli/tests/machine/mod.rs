//! A machine for tests of `ledgerctl` without a node.

use ledger_api::Context;
use ledger_base::hash::Hash;
use ledger_identity::key::SigningKey;
use ledger_identity::msp::{Msp, Msps};
use rcgen::{
    BasicConstraints, CertificateParams, CustomExtension, DnType, IsCa, Issuer, KeyPair, KeyUsagePurpose, date_time_ymd,
};
use std::process::{Command, Output, Stdio};
use std::sync::Arc;
use tempfile::TempDir;

/// A machine on which nobody has enrolled yet.
pub(crate) struct Machine {
    pub(crate) home: TempDir,
}

/// The output of one run.
#[derive(Debug)]
pub(crate) struct Transcript {
    pub(crate) stdout: String,
    pub(crate) stderr: String,
    pub(crate) code: i32,
}

impl Machine {
    pub(crate) fn new() -> Self {
        Self { home: tempfile::tempdir().unwrap() }
    }

    /// Stores a context as `enroll` would have: Org1 certified this name with the attribute Husky, and its node is
    /// said to be at that address.
    pub(crate) fn enrolled(&self, name: &str, node: &str) {
        self.enrolled_until(name, node, 4096);
    }

    /// The same, with a certificate that ends with this year.
    pub(crate) fn enrolled_until(&self, name: &str, node: &str, year: i32) {
        let mut params = CertificateParams::default();
        params.distinguished_name.push(DnType::CommonName, "Org1 CA");
        params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
        params.key_usages = vec![KeyUsagePurpose::KeyCertSign];
        let ca_key = KeyPair::generate_for(&rcgen::PKCS_ED25519).unwrap();
        let ca = params.self_signed(&ca_key).unwrap();

        let mut leaf = CertificateParams::default();
        leaf.not_after = date_time_ymd(year, 12, 31);
        leaf.distinguished_name.push(DnType::CommonName, name);
        leaf.distinguished_name.push(DnType::OrganizationalUnitName, "member");
        leaf.key_usages = vec![KeyUsagePurpose::DigitalSignature];
        let attributes = br#"{"attrs":{"Husky":"true"}}"#.to_vec();
        leaf.custom_extensions = vec![CustomExtension::from_oid_content(&[1, 2, 3, 4, 5, 6, 7, 8, 1], attributes)];
        let key = KeyPair::generate_for(&rcgen::PKCS_ED25519).unwrap();
        let certificate = leaf.signed_by(&key, &Issuer::from_params(&params, &ca_key)).unwrap();

        let mut msps = Msps::new();
        msps.insert(Msp::new("Org1", &[ca.der()], &[] as &[&[u8]]).unwrap()).unwrap();
        let context = Context {
            name: name.to_owned(),
            organisation: "Org1".to_owned(),
            network: Hash::of(&[b"network"]),
            label: "fleet".to_owned(),
            nodes: vec![node.to_owned()],
            chain: vec![certificate.der().clone()],
            key: Arc::new(SigningKey::from_pkcs8_der(&key.serialize_der()).unwrap()),
            msps: Arc::new(msps),
            renew: ledger_api::context::RenewalRule::default(),
            memory: ledger_api::context::Memory::default(),
        };
        context.save(self.home.path()).unwrap();
    }

    pub(crate) fn command(&self, args: &[&str]) -> Command {
        let mut command = Command::new(testkit::program("ledgerctl"));
        command.args(args).env("LEDGERD_HOME", self.home.path()).env("TZ", "UTC").env_remove("LEDGERCTL_CONTEXT");
        for variable in ["ROS_DOMAIN_ID", "ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_STATIC_PEERS", "RMW_IMPLEMENTATION"] {
            command.env_remove(variable);
        }
        command.stdin(Stdio::null());
        command
    }

    pub(crate) fn run(&self, args: &[&str]) -> Transcript {
        transcript(&self.command(args).output().unwrap())
    }
}

pub(crate) fn transcript(output: &Output) -> Transcript {
    Transcript {
        stdout: String::from_utf8(output.stdout.clone()).unwrap(),
        stderr: String::from_utf8(output.stderr.clone()).unwrap(),
        code: output.status.code().unwrap(),
    }
}

impl Transcript {
    /// The four lines, each of which must be there and in this order.
    #[track_caller]
    pub(crate) fn refused(&self, code: i32, lgr: &str, parts: &[&str]) {
        assert_eq!(self.code, code, "{self:?}");
        assert_eq!(self.stdout, "", "an error leaves standard output alone");
        let first = self.stderr.lines().next().unwrap_or_default();
        assert!(first.starts_with("error: ") && first.ends_with(&format!("[{lgr}]")), "{}", self.stderr);
        for part in parts {
            assert!(self.stderr.contains(part), "{part:?} in {}", self.stderr);
        }
    }
}

/// An address of this machine where nobody listens.
pub(crate) fn closed_address() -> String {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    listener.local_addr().unwrap().to_string()
}
