//! Votes with real certificates: whose signature is believed, and on what.

use bytes::Bytes;
use ledger::network::{FoundingNode, FoundingOrganisation, Genesis};
use ledger::{Ledger, Registry};
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::Identity;
use ledger_identity::key::KeyKind;
use ledger_identity::msp::Msps;
use ledger_light::{Signature, Signed, Statement, Vote};
use ledger_raft::{Ballot, Ballots};
use ledger_replica::Voting;
use ledger_replica::certifier::Signing;
use ledger_storage::disk::SimDisk;
use ledger_storage::results::ResultStore;
use ledger_storage::state::{MemoryState, State};
use std::sync::Arc;
use testkit::{Ca, User};

/// 2030-01-01, in microseconds since the UNIX epoch.
const NOW: u64 = 1_893_456_000_000_000;

struct Keys(User);

impl Signing for Keys {
    fn sign(&self, _statement: &Statement) -> Result<Signed, Rejection> {
        unreachable!("nothing is certified here")
    }

    fn sign_vote(&self, vote: &Vote) -> Result<Signature, Rejection> {
        vote.sign(self.0.certificate.clone(), &self.0.key)
    }

    fn identify(&self, msps: &Arc<Msps>, certificate: &[u8], time: u64) -> Result<Identity, Rejection> {
        Ok(msps.verify(certificate, &[], time)?)
    }
}

/// The nodes 1 and 2 of Org1, in a network of this name.
fn voting(ca: &Ca, label: &str, name: &str, unit: &str) -> Voting<Keys> {
    let node = |id: u64| FoundingNode {
        id,
        name: format!("node{id}"),
        organisation: "Org1".into(),
        address: format!("127.0.0.1:{}", 7000 + id),
        voter: true,
    };
    let genesis = Genesis {
        rules: ledger::Rules::NEWEST.number(),
        label: label.into(),
        created: NOW,
        salt: Hash::ZERO,
        organisations: vec![FoundingOrganisation::below("Org1", ca.root())],
        nodes: vec![node(1), node(2)],
        snapshot_every: 1000,
    };
    let genesis = genesis.to_bytes().unwrap();
    let (_, network) = Genesis::from_bytes(&genesis).unwrap();
    let results = Arc::new(ResultStore::open(Arc::new(SimDisk::new(2)), network).unwrap());
    let state = Arc::new(State::open(Box::new(MemoryState::default())).unwrap());
    let ledger = Ledger::open(&genesis, Registry::new(), state, results).unwrap();
    Voting::new(Arc::new(ledger), Keys(ca.user(name, unit, KeyKind::P256)))
}

#[test]
fn a_vote_counts_only_with_the_voters_own_signature_on_network_term_candidate_and_voter() {
    let (ca, stranger) = (Ca::new("org1-ca"), Ca::new("org1-ca"));
    let vote = Ballot { term: 5, candidate: 1, voter: 2 };
    let here = voting(&ca, "here", "node1", "node");
    let refused = |signed: &[u8], ballot| here.check(ballot, signed, NOW).unwrap_err().code;
    let signed = voting(&ca, "here", "node2", "node").sign(vote).unwrap();
    here.check(vote, &signed, NOW).unwrap();
    for other in [
        Ballot { term: 6, ..vote },
        Ballot { candidate: 2, ..vote },
        Ballot { voter: 1, ..vote },
        Ballot { voter: 7, ..vote },
    ] {
        assert_eq!(refused(&signed, other), Code::BadSignature, "{other:?}");
    }
    let elsewhere = voting(&ca, "elsewhere", "node2", "node").sign(vote).unwrap();
    assert_eq!(refused(&elsewhere, vote), Code::BadSignature, "a vote of another network");
    for (ca, name, unit) in [(&ca, "node1", "node"), (&ca, "node2", "member"), (&ca, "Salma", "member")] {
        let forged = voting(ca, "here", name, unit).sign(vote).unwrap();
        assert_eq!(refused(&forged, vote), Code::Untrusted, "{name}, {unit}");
    }
    let unknown = Ballot { voter: 7, ..vote };
    let signed_by_unknown = voting(&ca, "here", "node7", "node").sign(unknown).unwrap();
    assert_eq!(refused(&signed_by_unknown, unknown), Code::NotAMember);
    let of_stranger = voting(&stranger, "here", "node2", "node").sign(vote);
    let of_stranger = of_stranger.unwrap();
    here.check(vote, &of_stranger, NOW).unwrap_err();
    assert_eq!(refused(&Bytes::new(), vote), Code::Malformed);
    assert_eq!(refused(&signed.slice(1..), vote), Code::Malformed);
    let late = NOW + 1_000 * 365 * 24 * 3600 * 1_000_000;
    here.check(vote, &signed, late).unwrap_err();
}
