//! For tests: a network of two organisations, its people, and what they sign.
#![expect(clippy::unwrap_used, reason = "tests")]

use std::{
    collections::BTreeSet,
    sync::{Arc, OnceLock},
    time::{Duration, SystemTime, UNIX_EPOCH},
};

use bytes::Bytes;
use ledger::transaction::{Body, KnownBlock, Transaction};
use ledger_base::hash::Hash;
use ledger_contract::{Capabilities, Direction, Grant, Limits, Mode};
use ledger_identity::key::{KeyKind, SigningKey};
use ledger_identity::msp::{Msp, Msps};
use rcgen::{
    BasicConstraints, CertificateParams, CertifiedIssuer, DistinguishedName, DnType, IsCa, KeyPair, KeyUsagePurpose,
    date_time_ymd,
};
use ring::rand::SystemRandom;

use crate::gate::{Gate, Now, Settings};
use crate::service::{Revoked, Service};
use crate::speed::Speeds;
use crate::standing::{Members, Standing};

/// 2030-01-01, in microseconds since the UNIX epoch. Certificates are valid until 2031.
pub const NOW: u64 = 1_893_456_000_000_000;
/// One second in microseconds.
pub const SECOND: u64 = 1_000_000;
/// One small message.
pub static TWIST: [Bytes; 1] = [Bytes::from_static(&[0, 1, 0, 0, 42])];

/// Somebody with a key and a certificate.
#[derive(Clone)]
pub struct User {
    /// The network for which it signs.
    pub network: Hash,
    /// Signs.
    pub key: Arc<SigningKey>,
    /// The certificate in DER.
    pub certificate: Bytes,
    /// The call that is signed as `not_after`.
    pub not_after: u64,
    /// The newest block that it knows, as it names it.
    pub known_block: Option<KnownBlock>,
}

/// A network of two organisations.
pub struct Network {
    /// The authorities.
    pub msps: Arc<Msps>,
    /// Names and roots (DER) of the organisations.
    pub roots: [(&'static str, Bytes); 2],
    /// Of Org1.
    pub salma: User,
    /// Of Org1, too.
    pub farhad: User,
    /// Of the owner's organisation.
    pub robot: User,
}

/// An authority, and the year at whose start everything ends that it issues.
struct Ca(CertifiedIssuer<'static, KeyPair>, i32);

impl Ca {
    fn new(name: &str, last_year: i32) -> Self {
        let mut params = params(name, "ca", last_year);
        params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
        params.key_usages = vec![KeyUsagePurpose::KeyCertSign];
        let issuer = CertifiedIssuer::self_signed(params, KeyPair::generate().unwrap()).unwrap();
        Self(issuer, last_year)
    }

    fn user(&self, name: &str, unit: &str) -> User {
        let key = SigningKey::generate(KeyKind::Ed25519, &SystemRandom::new()).unwrap();
        let pair = KeyPair::from_pem(&key.to_pkcs8_pem()).unwrap();
        let certificate = params(name, unit, self.1).signed_by(&pair, &self.0).unwrap();
        User {
            network: Hash([1; 32]),
            key: Arc::new(key),
            certificate: Bytes::copy_from_slice(certificate.der()),
            not_after: NOW + 2 * SECOND,
            known_block: None,
        }
    }

    fn msp(&self, organisation: &str) -> Msp {
        Msp::new(organisation, &[self.0.der()], &[] as &[Bytes]).unwrap()
    }
}

fn params(name: &str, unit: &str, last_year: i32) -> CertificateParams {
    let mut params = CertificateParams::default();
    params.distinguished_name = DistinguishedName::new();
    params.distinguished_name.push(DnType::CommonName, name);
    params.distinguished_name.push(DnType::OrganizationalUnitName, unit);
    params.not_before = date_time_ymd(2020, 1, 1);
    params.not_after = date_time_ymd(last_year, 1, 1);
    params
}

impl User {
    /// Signs a call.
    pub fn sign(&self, chaincode: &str, function: &str, args: Vec<Bytes>) -> Transaction {
        let body = Body {
            network: Bytes::copy_from_slice(&self.network.0),
            creator: Bytes::copy_from_slice(&Hash::of(&[&self.certificate]).0),
            nonce: Bytes::from_static(&[7; 16]),
            not_after: self.not_after,
            chaincode: chaincode.into(),
            function: function.into(),
            args,
            known_block: self.known_block.clone(),
        };
        Transaction::sign(&body, &self.key).unwrap()
    }

    /// Signs `abac set` of `T/cmd_vel`.
    pub fn set(&self, epoch: u64, first_seq: u64, payloads: &[Bytes]) -> Transaction {
        let head = ["T/cmd_vel".to_owned(), epoch.to_string(), first_seq.to_string()];
        let args = head.into_iter().map(Bytes::from).chain(payloads.iter().cloned()).collect();
        self.sign("abac", "set", args)
    }

    /// The revocation of its certificate.
    pub fn revocation(&self, network: &Network) -> Revoked {
        let identity = network.msps.verify(&self.certificate, &[], NOW).unwrap();
        Revoked { issuer: Hash(identity.issuer), serial: hex::encode(&identity.serial) }
    }
}

impl Default for Network {
    /// With certificates that are valid long enough.
    fn default() -> Self {
        Self::until(2031)
    }
}

impl Network {
    /// With certificates that are valid until the start of that year.
    pub fn until(year: i32) -> Self {
        let (first, second) = (Ca::new("ca.org1", year), Ca::new("ca.org2", year));
        let mut msps = Msps::new();
        msps.insert(first.msp("Org1")).unwrap();
        msps.insert(second.msp("Org2")).unwrap();
        Self {
            msps: Arc::new(msps),
            roots: [("Org1", &first), ("Org2", &second)].map(|(name, ca)| (name, Bytes::copy_from_slice(ca.0.der()))),
            salma: first.user("Salma", "member"),
            farhad: first.user("Farhad", "member"),
            robot: second.user("T", "robot"),
        }
    }

    /// A gate that has learnt of the service and these grants.
    pub fn gate(&self, service: &Service, grants: &[Grant]) -> Gate {
        self.gate_with(service, grants, None)
    }

    /// The same with an age limit of its own.
    pub fn gate_with(&self, service: &Service, grants: &[Grant], max_age_ms: Option<u64>) -> Gate {
        let settings = Settings {
            network: self.salma.network,
            sample_bytes_max: 1024,
            max_age: max_age_ms.map(Duration::from_millis),
            stale_after: Duration::from_secs(1),
            command_timeout: None,
        };
        let mut gate = Gate::new(settings, "T/cmd_vel", now());
        assert_eq!(gate.learn(service, &self.standing(1, grants), now().steady, now()), None);
        gate
    }

    /// How the robot stands after that block.
    pub fn standing(&self, height: u64, grants: &[Grant]) -> Standing {
        Standing {
            services: Vec::new(),
            grants: grants.to_vec(),
            tasks: Vec::new(),
            stopped: false,
            settled: BTreeSet::new(),
            members: self.members(&[]),
            height,
            time: NOW,
        }
    }

    /// The members after the revocation of these.
    pub fn members(&self, revoked: &[&User]) -> Members {
        let revoked = revoked.iter().filter_map(|user| user.revocation(self).key()).collect();
        Members { msps: Arc::clone(&self.msps), revoked: Arc::new(revoked), barred: Arc::default() }
    }
}

/// One network for many cases: keys cost time.
pub fn shared() -> &'static Network {
    static NETWORK: OnceLock<Network> = OnceLock::new();
    NETWORK.get_or_init(Network::default)
}

/// The service `T/cmd_vel` in a mode.
pub fn service(mode: &str) -> Service {
    Service {
        service: "T/cmd_vel".into(),
        robot: "T".into(),
        organisation: "Org2".into(),
        topic: "/cmd_vel".into(),
        type_name: "geometry_msgs/msg/Twist".into(),
        capabilities: Capabilities::of_mode(&Mode::from(mode)).unwrap(),
        direction: Direction::Command,
        max_age_ms: 1000,
        lease_ms: 10_000,
        stop_hex: None,
        epoch: 0,
        confidential: false,
        speeds: Speeds::default(),
    }
}

/// A grant of `T/cmd_vel`.
pub fn grant(holder: &str, epoch: u64) -> Grant {
    Grant {
        service: "T/cmd_vel".into(),
        holder: holder.into(),
        epoch,
        expires: NOW + 4 * SECOND,
        mode: Mode::from("exclusive"),
        acquired_at: NOW,
        lease_ms: 4000,
        next_seq: 0,
        taken: None,
        limits: Limits::default(),
        givers: Vec::new(),
        may_delegate: false,
        follows: None,
        task: None,
        policy_version: 0,
        policies: Vec::new(),
    }
}

/// [`NOW`] on both clocks.
pub fn now() -> Now {
    now_at(NOW)
}

/// Another moment on both clocks.
pub fn now_at(wall: u64) -> Now {
    Now { wall, steady: wall - NOW + SECOND }
}

/// The clock of this machine, microseconds since the UNIX epoch.
pub fn micros() -> u64 {
    u64::try_from(SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_micros()).unwrap()
}
