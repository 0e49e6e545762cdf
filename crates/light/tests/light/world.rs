//! Two organisations and their nodes.

use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_base::rejection::Rejection;
use ledger_identity::Identity;
use ledger_identity::key::KeyKind;
use ledger_identity::msp::{Msp, Msps};
use ledger_light::{Certificate, CertificateRule, Head, Signature, Signed, Statement, Vote, Voter, Voters};
use testkit::{Ca, User};

/// 2030-01-01, microseconds.
pub(crate) const NOW: u64 = 1_893_456_000_000_000;
pub(crate) const NETWORK: Hash = Hash([7; 32]);

/// Nodes 1, 2 of Org1 and 3 of Org2 vote; 4 of Org2 follows.
pub(crate) struct World {
    pub(crate) cas: [Ca; 2],
    pub(crate) nodes: Vec<User>,
    pub(crate) voters: Voters,
    msps: Msps,
}

pub(crate) fn name(node: u64) -> [&'static str; 2] {
    match node {
        1 => ["Org1", "node1"],
        2 => ["Org1", "node2"],
        3 => ["Org2", "node3"],
        _ => ["Org2", "node4"],
    }
}

impl World {
    pub(crate) fn new() -> Self {
        let cas = [Ca::new("Org1 CA"), Ca::with_key("Org2 CA", KeyKind::P256)];
        let mut msps = Msps::new();
        for (ca, organisation) in cas.iter().zip(["Org1", "Org2"]) {
            msps.insert(Msp::new(organisation, &[ca.root()], &[] as &[Bytes]).unwrap()).unwrap();
        }
        let ca = |node| &cas[usize::from(name(node)[0] == "Org2")];
        let kind = |node| if node == 2 { KeyKind::Ed25519 } else { KeyKind::P256 };
        let nodes = (1..=4).map(|node| ca(node).user(name(node)[1], "node", kind(node))).collect();
        let known = (1..=4).map(|node| {
            let [organisation, name] = name(node).map(str::to_owned);
            (node, Voter { organisation, name })
        });
        let voters = Voters {
            nodes: known.collect(),
            voters: [1, 2, 3].into(),
            outgoing: [].into(),
            rule: CertificateRule::default(),
            recoveries: 0,
        };
        Self { cas, nodes, voters, msps }
    }

    pub(crate) fn identify(&self, der: &[u8], time: u64) -> Result<Identity, Rejection> {
        self.msps.verify(der, &[], time).map_err(Rejection::from)
    }

    pub(crate) fn sign(&self, statement: &Statement, node: u64) -> Signed {
        let User { key, certificate } = &self.nodes[node as usize - 1];
        statement.sign(node, certificate.clone(), key).unwrap()
    }

    pub(crate) fn vote(&self, vote: &Vote) -> Signature {
        let User { key, certificate } = &self.nodes[vote.voter as usize - 1];
        vote.sign(certificate.clone(), key).unwrap()
    }

    pub(crate) fn head(&self, head: &Head, signer: u64) -> Signature {
        let User { key, certificate } = &self.nodes[signer as usize - 1];
        head.sign(certificate.clone(), key).unwrap()
    }

    pub(crate) fn certificate(&self, statement: Statement, signers: &[u64]) -> Certificate {
        let sign = |node: &u64| -> Signature { self.sign(&statement, *node).signature };
        Certificate { statement, signatures: signers.iter().map(sign).collect() }
    }

    pub(crate) fn verify(&self, certificate: &Certificate) -> Result<(), Rejection> {
        certificate.verify(&NETWORK, &self.voters, |der, time| self.identify(der, time))
    }
}

pub(crate) fn statement(height: u64) -> Statement {
    Statement { network: NETWORK, recoveries: 0, height, time: NOW, block: Hash([1; 32]), results: Hash([2; 32]) }
}
