//! The organisations, their nodes and people, and the keys of all.

use crate::clock::EPOCH;
use crate::people::{Person, authority, key, params};
use bytes::Bytes;
use ledger::network::FoundingOrganisation;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::Identity;
use ledger_identity::certificate::{ATTRIBUTES_OID, encode_attributes};
use ledger_identity::msp::{Msp, Msps};
use ledger_light::{Complaint, Head, Signature, Signed, Statement, Transfer, Vote};
use ledger_replica::certifier::Signing;
use rcgen::{CustomExtension, SerialNumber};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Most organisations.
const ORGANISATIONS: usize = 7;
/// Most nodes of one.
const NODES: usize = 3;

/// Everybody.
pub struct Cast {
    /// As the genesis names them, in the order of the shape.
    pub organisations: Vec<FoundingOrganisation>,
    people: BTreeMap<String, Person>,
    by_certificate: BTreeMap<Hash, String>,
}

impl Cast {
    /// Makes all keys and certificates; the same ones every time.
    pub fn new() -> Self {
        let mut cast = Self { organisations: Vec::new(), people: BTreeMap::new(), by_certificate: BTreeMap::new() };
        let mut serial = 1000_u64;
        for number in 1..=ORGANISATIONS {
            let organisation = format!("Org{number}");
            let authority = authority(&organisation);
            let root = Bytes::copy_from_slice(authority.der());
            let mut msps = Msps::new();
            msps.insert(Msp::new(&organisation, std::slice::from_ref(&root), &[] as &[Bytes]).unwrap()).unwrap();
            cast.organisations.push(FoundingOrganisation::below(&organisation, root));
            let nodes = (1..=NODES).map(|node| (format!("node{node}"), "node"));
            let people = [("admin".to_owned(), "admin"), ("driver".to_owned(), "member")];
            for (name, role) in people.into_iter().chain(nodes) {
                let key = key(&format!("twins/{organisation}/{name}"));
                let public = rcgen::SubjectPublicKeyInfo::from_der(&key.public_key().to_spki()).unwrap();
                let mut params = params(&name, role);
                params.serial_number = Some(SerialNumber::from(serial));
                serial += 1;
                let attributes: BTreeMap<_, _> =
                    ["Turtlebot4", "Husky"].map(|robot| (robot.to_owned(), "true".to_owned())).into();
                let json = encode_attributes(&attributes).unwrap();
                params.custom_extensions.push(CustomExtension::from_oid_content(ATTRIBUTES_OID, json));
                let certificate = params.signed_by(&public, &authority).unwrap();
                let certificate = Bytes::copy_from_slice(certificate.der());
                let identity = msps.verify(&certificate, &[], EPOCH).unwrap();
                let person = Person { identity, certificate, key, nth: 0 };
                cast.by_certificate.insert(person.fingerprint(), person.id());
                cast.people.insert(person.id(), person);
            }
        }
        cast
    }

    /// A person or a node, by `ORGANISATION/NAME`.
    pub fn person(&self, id: &str) -> &Person {
        self.people.get(id).unwrap_or_else(|| panic!("nobody is called {id}"))
    }

    /// The owner of a certificate, by its fingerprint.
    pub fn by_fingerprint(&self, fingerprint: &Hash) -> Option<&Person> {
        self.by_certificate.get(fingerprint).map(|id| self.person(id))
    }
}

impl Default for Cast {
    fn default() -> Self {
        Self::new()
    }
}

/// The key of a node, and the certificates that it believes.
#[derive(Clone)]
pub(super) struct Keys {
    /// The number of the node.
    pub(super) id: u64,
    /// Its full name.
    pub(super) name: String,
    /// Everybody.
    pub(super) cast: Arc<Cast>,
}

impl Keys {
    fn own(&self) -> &Person {
        self.cast.person(&self.name)
    }
}

impl Signing for Keys {
    fn sign(&self, statement: &Statement) -> Result<Signed, Rejection> {
        statement.sign(self.id, self.own().certificate.clone(), &self.own().key)
    }

    fn sign_vote(&self, vote: &Vote) -> Result<Signature, Rejection> {
        vote.sign(self.own().certificate.clone(), &self.own().key)
    }

    fn sign_transfer(&self, transfer: &Transfer) -> Result<Signature, Rejection> {
        transfer.sign(self.own().certificate.clone(), &self.own().key)
    }

    fn sign_complaint(&self, complaint: &Complaint) -> Result<Signature, Rejection> {
        complaint.sign(self.own().certificate.clone(), &self.own().key)
    }

    fn sign_head(&self, head: &Head) -> Result<Signature, Rejection> {
        head.sign(self.own().certificate.clone(), &self.own().key)
    }

    fn identify(&self, msps: &Arc<Msps>, certificate: &[u8], _time: u64) -> Result<Identity, Rejection> {
        // Every certificate was verified when it was made.
        let found = self.cast.by_certificate.get(&Hash::of(&[certificate])).map(|id| &self.cast.person(id).identity);
        let trusted = found.filter(|identity| msps.get(&identity.organisation).is_some());
        trusted.cloned().ok_or_else(|| Rejection::new(Code::Untrusted, "nobody knows this certificate"))
    }
}
