//! The organisations of the simulated network, their people, and what they sign. Keys come from fixed seeds, so that
//! every transaction has the same bytes in every run.

use crate::clock::{EPOCH, SECOND};
use bytes::Bytes;
use ledger::network::FoundingOrganisation;
use ledger_base::hash::Hash;
use ledger_identity::Identity;
use ledger_identity::certificate::{ATTRIBUTES_OID, encode_attributes};
use ledger_identity::key::{KeyKind, SigningKey};
use ledger_identity::msp::{Msp, Msps};
use rcgen::{
    BasicConstraints, CertificateParams, CertifiedIssuer, CustomExtension, DistinguishedName, DnType, IsCa, KeyPair,
    KeyUsagePurpose, PKCS_ED25519, SerialNumber, date_time_ymd,
};
use std::collections::{BTreeMap, BTreeSet};

/// How many certificates each person has: after a revocation they go on with the next.
pub const CERTIFICATES: usize = 3;
/// Most nodes that ever belong to one network.
const NODES: u64 = 40;
/// Most organisations that run nodes.
const NODE_ORGANISATIONS: usize = 3;
/// Everything before the seed of an Ed25519 key in PKCS#8 version 1 (RFC 8410).
const ED25519_PKCS8: &[u8] =
    &[0x30, 0x2e, 0x02, 0x01, 0x00, 0x30, 0x05, 0x06, 0x03, 0x2b, 0x65, 0x70, 0x04, 0x22, 0x04, 0x20];

/// The identity: organisation, name, role, attributes; an attribute without another value is `true`.
const PEOPLE: [(&str, &str, &str, &[&str]); 10] = [
    ("Org1", "admin", "admin", &[]),
    ("Org1", "Salma", "member", &["Turtlebot4", "Husky", "rank=2"]),
    ("Org1", "Farhad", "member", &["Turtlebot4", "rank=1"]),
    ("Org1", "Nina", "member", &["Turtlebot4", "Husky"]),
    ("Org2", "admin", "admin", &[]),
    ("Org2", "Owen", "member", &["Turtlebot4", "Husky", "rank=2"]),
    ("Org3", "admin", "admin", &[]),
    // Trusted by nobody, whatever the own CA signs.
    ("Org3", "Trudy", "member", &["Turtlebot4", "Husky", "rank=9"]),
    ("Org2", "Mallory", "member", &[]),
    // Where two must agree, one is not enough.
    ("Org2", "chief", "admin", &[]),
];

/// Those who have left: a certificate that has ended, by organisation.
const FORMER: [(&str, &str); 4] = [("Org1", "Ada"), ("Org1", "Ben"), ("Org2", "Cleo"), ("Org2", "Dan")];

/// A time at which their certificates counted: 60 days before the simulation begins.
const WHILE_THEY_WERE_THERE: u64 = EPOCH - 60 * 24 * 3600 * SECOND;

/// The certificates of robots: one of a bridge, and one of a robot that reports how far its tasks are.
const ROBOTS: [(&str, &str, &str); 2] = [("Org2", "Rover", "robot"), ("Org2", "Turtlebot4", "robot")];

/// One certificate of a person, with its key.
pub struct Person {
    /// The fields that a node reads from the certificate.
    pub identity: Identity,
    /// The certificate in DER.
    pub certificate: Bytes,
    /// Signs for it.
    pub key: SigningKey,
    /// Which of the person's certificates it is, from 0.
    pub nth: usize,
}

/// Everybody.
pub struct People {
    /// As the genesis names them.
    pub organisations: Vec<FoundingOrganisation>,
    /// Every certificate: those of one person follow each other.
    pub all: Vec<Person>,
    /// The certificates of those who have left, which have ended.
    pub former: Vec<Person>,
    /// How many of all are people's.
    persons: usize,
}

impl Person {
    /// SHA-256 of the certificate: names the creator of a transaction.
    pub fn fingerprint(&self) -> Hash {
        Hash(self.identity.fingerprint)
    }

    /// `Org1/Salma`.
    pub fn id(&self) -> String {
        self.identity.id()
    }
}

impl People {
    /// Makes all keys and certificates; the same ones every time.
    pub fn new() -> Self {
        let names = ["Org1", "Org2", "Org3"];
        let authorities: BTreeMap<&str, CertifiedIssuer<'static, KeyPair>> =
            names.into_iter().map(|name| (name, authority(name))).collect();
        let mut msps = Msps::new();
        let mut organisations = Vec::new();
        for (name, authority) in &authorities {
            let root = Bytes::copy_from_slice(authority.der());
            msps.insert(Msp::new(name, std::slice::from_ref(&root), &[] as &[Bytes]).unwrap()).unwrap();
            organisations.push(FoundingOrganisation::below(name, root));
        }
        let mut all = Vec::new();
        for (organisation, name, role, attributes) in PEOPLE {
            for nth in 0..CERTIFICATES {
                let key = key(&format!("{organisation}/{name}/{nth}"));
                let public = rcgen::SubjectPublicKeyInfo::from_der(&key.public_key().to_spki()).unwrap();
                let mut params = params(name, role);
                params.serial_number = Some(SerialNumber::from(all.len() as u64 + 1000));
                let pairs = attributes.iter().map(|text| text.split_once('=').unwrap_or((text, "true")));
                let attributes: BTreeMap<String, String> =
                    pairs.map(|(name, value)| (name.to_owned(), value.to_owned())).collect();
                let json = encode_attributes(&attributes).unwrap();
                params.custom_extensions.push(CustomExtension::from_oid_content(ATTRIBUTES_OID, json));
                let certificate = params.signed_by(&public, &authorities[organisation]).unwrap();
                let certificate = Bytes::copy_from_slice(certificate.der());
                let identity = msps.verify(&certificate, &[], EPOCH).unwrap();
                all.push(Person { identity, certificate, key, nth });
            }
        }
        let persons = all.len();
        for id in 1..=NODES {
            let mut of: Vec<String> = (2..=NODE_ORGANISATIONS).map(|count| organisation_of(id, count)).collect();
            of.dedup();
            for organisation in of {
                let (name, key) = (format!("node{id}"), key(&format!("{organisation}/node{id}")));
                let public = rcgen::SubjectPublicKeyInfo::from_der(&key.public_key().to_spki()).unwrap();
                let mut params = params(&name, "node");
                params.serial_number = Some(SerialNumber::from(all.len() as u64 + 1000));
                let certificate = params.signed_by(&public, &authorities[&*organisation]).unwrap();
                let certificate = Bytes::copy_from_slice(certificate.der());
                let identity = msps.verify(&certificate, &[], EPOCH).unwrap();
                all.push(Person { identity, certificate, key, nth: 0 });
            }
        }
        for (organisation, name, role) in ROBOTS {
            let key = key(&format!("{organisation}/{name}"));
            let public = rcgen::SubjectPublicKeyInfo::from_der(&key.public_key().to_spki()).unwrap();
            let mut params = params(name, role);
            params.serial_number = Some(SerialNumber::from(all.len() as u64 + 1000));
            let certificate = params.signed_by(&public, &authorities[organisation]).unwrap();
            let certificate = Bytes::copy_from_slice(certificate.der());
            let identity = msps.verify(&certificate, &[], EPOCH).unwrap();
            all.push(Person { identity, certificate, key, nth: 0 });
        }
        let former = FORMER.iter().enumerate().map(|(at, (organisation, name))| {
            let key = key(&format!("{organisation}/{name}"));
            let public = rcgen::SubjectPublicKeyInfo::from_der(&key.public_key().to_spki()).unwrap();
            let mut params = params(name, "member");
            params.not_after = date_time_ymd(2029, 12, 1);
            params.serial_number = Some(SerialNumber::from(at as u64 + 500));
            let certificate = params.signed_by(&public, &authorities[*organisation]).unwrap();
            let certificate = Bytes::copy_from_slice(certificate.der());
            let identity = msps.verify(&certificate, &[], WHILE_THEY_WERE_THERE).unwrap();
            Person { identity, certificate, key, nth: 0 }
        });
        let former = former.collect();
        Self { organisations, all, former, persons }
    }

    /// The certificates of people; the others are those of nodes.
    pub fn persons(&self) -> &[Person] {
        &self.all[..self.persons]
    }

    /// The certificate of a node, in a network in which so many organisations run nodes.
    pub fn node(&self, id: u64, organisations: usize) -> &Person {
        let name = format!("{}/node{id}", organisation_of(id, organisations));
        let index = self.index(&name, 0).unwrap_or_else(|| panic!("more than {NODES} nodes"));
        &self.all[index]
    }

    /// A person's certificate by its fingerprint.
    pub fn by_fingerprint(&self, fingerprint: &Hash) -> Option<&Person> {
        self.all.iter().find(|person| person.fingerprint() == *fingerprint)
    }

    /// How many turns others may have before an identity's next one: its organisation has one after each other
    /// organisation, and it has one after each other identity of its organisation.
    pub fn turns_of_others(&self, who: &str) -> usize {
        let people = PEOPLE.iter().map(|(organisation, ..)| *organisation);
        let all: Vec<&str> = people.chain(ROBOTS.iter().map(|(organisation, ..)| *organisation)).collect();
        let own = who.split_once('/').map_or(who, |(organisation, _)| organisation);
        let organisations: BTreeSet<&str> = all.iter().copied().collect();
        organisations.len() * all.iter().filter(|organisation| **organisation == own).count()
    }

    /// Index of a person's `nth` certificate.
    pub fn index(&self, id: &str, nth: usize) -> Option<usize> {
        self.all.iter().position(|person| person.nth == nth && person.id() == id)
    }
}

impl Default for People {
    fn default() -> Self {
        Self::new()
    }
}

/// The organisation that runs a node: each in its turn.
pub fn organisation_of(id: u64, organisations: usize) -> String {
    format!("Org{}", 1 + (id as usize - 1) % organisations)
}

pub(crate) fn key(name: &str) -> SigningKey {
    let seed = Hash::of(&[b"simulated key", name.as_bytes()]);
    let key = SigningKey::from_pkcs8_der(&[ED25519_PKCS8, &seed.0].concat()).unwrap();
    assert_eq!(key.kind(), KeyKind::Ed25519);
    key
}

/// The key of an organisation's CA.
pub fn ca_key(organisation: &str) -> SigningKey {
    key(&format!("{organisation}-ca"))
}

pub(crate) fn authority(name: &str) -> CertifiedIssuer<'static, KeyPair> {
    let mut params = params(&format!("{name}-ca"), "ca");
    params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
    params.key_usages = vec![KeyUsagePurpose::KeyCertSign, KeyUsagePurpose::CrlSign];
    params.serial_number = Some(SerialNumber::from(1u64));
    let key = ca_key(name);
    let pair = KeyPair::from_pkcs8_der_and_sign_algo(&key.to_pkcs8_der().into(), &PKCS_ED25519).unwrap();
    CertifiedIssuer::self_signed(params, pair).unwrap()
}

pub(crate) fn params(name: &str, unit: &str) -> CertificateParams {
    let mut params = CertificateParams::default();
    params.distinguished_name = DistinguishedName::new();
    params.distinguished_name.push(DnType::CommonName, name);
    params.distinguished_name.push(DnType::OrganizationalUnitName, unit);
    params.not_before = date_time_ymd(2029, 1, 1);
    params.not_after = date_time_ymd(2031, 1, 1);
    params
}
