//! One organisation: its CA, somebody who submits transactions, and a node that attests.

use bytes::Bytes;
use ledger::network::FoundingOrganisation;
use ledger::transaction::{Body, NONCE_BYTES, Transaction};
use ledger_base::hash::Hash;
use ledger_identity::key::KeyKind;
use std::sync::LazyLock;
use testkit::{Ca, User};

/// The organisation's name.
pub const ORGANISATION: &str = "Org1";
/// How long a transaction may be executed, microseconds.
const LIFE: u64 = 100_000_000;

/// Everybody; made once, as the same seed gives the same run.
pub static PEOPLE: LazyLock<People> = LazyLock::new(|| {
    let ca = Ca::new("org1-ca");
    let [salma, node] =
        [("Salma", "member"), ("node1", "node")].map(|(name, unit)| ca.user(name, unit, KeyKind::Ed25519));
    People { root: ca.root(), salma, node }
});

pub struct People {
    root: Bytes,
    pub salma: User,
    pub node: User,
}

impl People {
    pub fn organisation(&self) -> FoundingOrganisation {
        FoundingOrganisation {
            name: ORGANISATION.into(),
            roots: vec![self.root.clone()],
            intermediates: Vec::new(),
            units: None,
        }
    }
}

/// A signed call, which is the same whenever it is made of the same.
pub fn call(user: &User, network: Hash, now: u64, (chaincode, function): (&str, &str), argument: Bytes) -> Transaction {
    let Hash(nonce) = Hash::of(&[function.as_bytes(), &argument]);
    let body = Body {
        network: Bytes::copy_from_slice(&network.0),
        creator: Bytes::copy_from_slice(&Hash::of(&[&user.certificate]).0),
        nonce: Bytes::copy_from_slice(&nonce[..NONCE_BYTES]),
        not_after: now + LIFE,
        chaincode: chaincode.into(),
        function: function.into(),
        args: vec![argument],
        known_block: None,
    };
    Transaction::sign(&body, &user.key).unwrap().with_certificate(user.certificate.clone()).unwrap()
}
