//! Votes in elections: this node's key for them, and whose signatures it believes.
//!
//! The voter's certificate is in the signature, so that renewed keys work. It is checked by the organisations, the nodes
//! and the revocations of the newest state that this node has executed, at the time of the node's clock.

use crate::certifier::Signing;
use bytes::Bytes;
use ledger::Ledger;
use ledger_base::rejection::Rejection;
use ledger_light::{Signature, Vote};
use ledger_raft::{Ballot, Ballots};
use std::sync::Arc;

/// Signs and checks votes for the engine of one node.
pub struct Voting<S> {
    ledger: Arc<Ledger>,
    signing: S,
}

impl<S: Signing> Voting<S> {
    /// With the key of the node, for the network of this ledger.
    pub fn new(ledger: Arc<Ledger>, signing: S) -> Self {
        Self { ledger, signing }
    }

    fn vote(&self, ballot: Ballot, recoveries: u64) -> Vote {
        let Ballot { term, candidate, voter } = ballot;
        Vote { network: self.ledger.network(), recoveries, term, candidate, voter }
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
}
