//! Votes with real certificates: whose signature is believed, and on what.

use bytes::Bytes;
use ledger::network::{FoundingNode, FoundingOrganisation, Genesis};
use ledger::{Ledger, Registry};
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::Identity;
use ledger_identity::key::KeyKind;
use ledger_identity::msp::Msps;
use ledger_light::{Head, Signature, Signed, Statement, Transfer, Vote};
use ledger_raft::{Ballot, Ballots, Handover, LogHead};
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

    fn sign_transfer(&self, transfer: &Transfer) -> Result<Signature, Rejection> {
        transfer.sign(self.0.certificate.clone(), &self.0.key)
    }

    fn sign_head(&self, head: &Head) -> Result<Signature, Rejection> {
        head.sign(self.0.certificate.clone(), &self.0.key)
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

#[test]
fn a_transfer_counts_only_with_the_leaders_own_signature_on_network_term_leader_and_transferee() {
    let ca = Ca::new("org1-ca");
    let here = voting(&ca, "here", "node1", "node");
    let transfer = Handover { term: 5, leader: 2, to: 1 };
    let signed = voting(&ca, "here", "node2", "node").sign_handover(transfer).unwrap();
    here.check_handover(transfer, &signed, NOW).unwrap();
    for other in [Handover { term: 6, ..transfer }, Handover { to: 2, ..transfer }, Handover { leader: 1, ..transfer }]
    {
        assert_eq!(here.check_handover(other, &signed, NOW).unwrap_err().code, Code::BadSignature, "{other:?}");
    }
    let elsewhere = voting(&ca, "there", "node2", "node").sign_handover(transfer).unwrap();
    assert_eq!(here.check_handover(transfer, &elsewhere, NOW).unwrap_err().code, Code::BadSignature);
    let another = voting(&ca, "here", "node1", "node").sign_handover(transfer).unwrap();
    assert_eq!(here.check_handover(transfer, &another, NOW).unwrap_err().code, Code::Untrusted);
}

#[test]
fn a_head_counts_only_with_the_signature_of_the_certificate_in_the_leaders_own_vote() {
    let ca = Ca::new("org1-ca");
    let (here, leader) = (voting(&ca, "here", "node1", "node"), voting(&ca, "here", "node2", "node"));
    let own_vote = |of: &Voting<Keys>| of.sign(Ballot { term: 5, candidate: 2, voter: 2 }).unwrap();
    let (head, vote) = (LogHead { term: 5, leader: 2, height: 9, hash: Hash([1; 32]) }, own_vote(&leader));
    let (certificate, signature) = leader.sign_head(head).unwrap();
    assert_eq!(Signature::from_bytes(&vote).unwrap().certificate, certificate);
    let code =
        |head, vote: &[u8], signature: &[u8]| here.check_head(head, vote, signature, NOW).err().map(|no| no.code);
    assert_eq!(code(head, &vote, &signature), None);
    for other in [
        LogHead { term: 6, ..head },
        LogHead { height: 8, ..head },
        LogHead { hash: Hash([2; 32]), ..head },
        LogHead { leader: 1, ..head },
    ] {
        assert_eq!(code(other, &vote, &signature), Some(Code::BadSignature), "{other:?}");
    }
    let renewed = voting(&ca, "here", "node2", "node");
    let (_, signature) = renewed.sign_head(head).unwrap();
    assert_eq!(code(head, &vote, &signature), Some(Code::BadSignature), "another key");
    assert_eq!(code(head, &own_vote(&renewed), &signature), None, "with its certificate");
    let another = voting(&ca, "here", "node1", "node");
    let (_, signature) = another.sign_head(head).unwrap();
    assert_eq!(code(head, &own_vote(&another), &signature), Some(Code::Untrusted), "the vote of another node");
}
