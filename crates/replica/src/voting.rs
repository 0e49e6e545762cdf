//! Signatures for the engine: votes in elections, transfers of leadership, heads of logs.
//!
//! The signer's certificate is in the signature of a vote and of a transfer, so that renewed keys work. It is checked by the
//! organisations, the nodes and the revocations of the newest state that this node has executed, at the time of the node's clock.
//! A head is checked with the certificate in the leader's vote for itself.

use crate::certifier::Signing;
use bytes::Bytes;
use ledger::Ledger;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::Identity;
use ledger_light::{Head, Signature, Transfer, Vote};
use ledger_raft::{Ballot, Ballots, Handover, LogHead};
use std::sync::{Arc, Mutex, PoisonError};

/// A leader's certificate is looked at again after this time, microseconds: it may have been revoked.
const LEADER_KNOWN_MAX: u64 = 1_000_000;

/// Signs and checks for the engine of one node.
pub struct Voting<S> {
    ledger: Arc<Ledger>,
    signing: S,
    /// The leader whose heads were checked last.
    leader: Mutex<Option<Leader>>,
}

/// A leader whose vote for itself was checked.
struct Leader {
    vote: Bytes,
    identity: Arc<Identity>,
    number: u64,
    term: u64,
    /// When, by the node's clock.
    at: u64,
}

impl<S: Signing> Voting<S> {
    /// With the key of the node, for the network of this ledger.
    pub fn new(ledger: Arc<Ledger>, signing: S) -> Self {
        Self { ledger, signing, leader: Mutex::default() }
    }

    fn vote(&self, ballot: Ballot, recoveries: u64) -> Vote {
        let Ballot { term, candidate, voter } = ballot;
        Vote { network: self.ledger.network(), recoveries, term, candidate, voter }
    }

    fn transfer(&self, handover: Handover, recoveries: u64) -> Transfer {
        let Handover { term, leader, to } = handover;
        Transfer { network: self.ledger.network(), recoveries, term, leader, to }
    }

    fn head(&self, head: LogHead, recoveries: u64) -> Head {
        let LogHead { term, leader, height, hash } = head;
        Head { network: self.ledger.network(), recoveries, leader, term, height, hash }
    }

    /// The leader that has given itself this vote.
    fn leader(&self, head: LogHead, vote: &[u8], now: u64) -> Result<Arc<Identity>, Rejection> {
        let mut known = self.leader.lock().unwrap_or_else(PoisonError::into_inner);
        let is_known = |leader: &&Leader| {
            leader.vote == vote
                && (leader.number, leader.term) == (head.leader, head.term)
                && now.abs_diff(leader.at) < LEADER_KNOWN_MAX
        };
        if let Some(leader) = known.as_ref().filter(is_known) {
            return Ok(Arc::clone(&leader.identity));
        }
        let (term, number) = (head.term, head.leader);
        let signature = Signature::from_bytes(vote)?;
        let identity = self.signing.identify(&self.ledger.msps(), &signature.certificate, now)?;
        let voters = self.ledger.voters()?;
        let ballot = self.vote(Ballot { term, candidate: number, voter: number }, voters.recoveries);
        voters.check_vote(&ballot, &signature, &identity)?;
        let identity = Arc::new(identity);
        let vote = Bytes::copy_from_slice(vote);
        *known = Some(Leader { vote, identity: Arc::clone(&identity), number, term, at: now });
        Ok(identity)
    }
}

impl<S: Signing + Send + Sync> Ballots for Voting<S> {
    fn sign(&self, ballot: Ballot) -> Result<Bytes, Rejection> {
        let vote = self.vote(ballot, self.ledger.recoveries()?);
        self.signing.sign_vote(&vote).map(|signature| signature.to_bytes())
    }

    fn check(&self, ballot: Ballot, signed: &[u8], now: u64) -> Result<(), Rejection> {
        let signature = Signature::from_bytes(signed)?;
        let identity = self.signing.identify(&self.ledger.msps(), &signature.certificate, now)?;
        let voters = self.ledger.voters()?;
        voters.check_vote(&self.vote(ballot, voters.recoveries), &signature, &identity)
    }

    fn sign_handover(&self, handover: Handover) -> Result<Bytes, Rejection> {
        self.signing
            .sign_transfer(&self.transfer(handover, self.ledger.recoveries()?))
            .map(|signature| signature.to_bytes())
    }

    fn check_handover(&self, handover: Handover, signed: &[u8], now: u64) -> Result<(), Rejection> {
        let signature = Signature::from_bytes(signed)?;
        let identity = self.signing.identify(&self.ledger.msps(), &signature.certificate, now)?;
        let voters = self.ledger.voters()?;
        voters.check_transfer(&self.transfer(handover, voters.recoveries), &signature, &identity)
    }

    fn sign_head(&self, head: LogHead) -> Result<(Bytes, Bytes), Rejection> {
        let Signature { certificate, signature, .. } =
            self.signing.sign_head(&self.head(head, self.ledger.recoveries()?))?;
        Ok((certificate, signature))
    }

    fn check_head(&self, head: LogHead, vote: &[u8], signature: &[u8], now: u64) -> Result<(), Rejection> {
        let leader = self.leader(head, vote, now)?;
        let head = self.head(head, self.ledger.recoveries()?);
        let verified = leader.public_key.verify(&head.to_bytes(), signature);
        verified.map_err(|error| Rejection::told(Code::BadSignature, &error.to_string()))
    }
}
