//! The voters whose signatures count for a block, and how many of them are enough: those as of the block before it.

use crate::statement::{Signature, Statement};
use crate::transfer::Transfer;
use crate::vote::Vote;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::{Identity, Role};
use std::collections::{BTreeMap, BTreeSet};

/// A node as the ledger knows it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Voter {
    /// The organisation that runs it.
    pub organisation: String,
    /// Common name of its certificates.
    pub name: String,
}

/// The voters of a height.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Voters {
    /// The nodes by their numbers; more than the voters does no harm.
    pub nodes: BTreeMap<u64, Voter>,
    /// The voters.
    pub voters: BTreeSet<u64>,
    /// While they change: the voters before, of whom a majority is needed, too. Empty otherwise.
    pub outgoing: BTreeSet<u64>,
}

impl Voters {
    /// The node's signature counts.
    pub fn is_voter(&self, node: u64) -> bool {
        self.voters.contains(&node) || self.outgoing.contains(&node)
    }

    /// Checks one signature: that the node votes, that this is its identity, and that it signed this. `identity` is what
    /// the caller found for the certificate in the signature, by the organisations as of the block before.
    ///
    /// # Errors
    /// [`Code::NotAMember`], [`Code::Untrusted`], [`Code::BadSignature`].
    pub fn check(&self, statement: &Statement, signature: &Signature, identity: &Identity) -> Result<(), Rejection> {
        let node = signature.node;
        if !self.is_voter(node) {
            return Err(Rejection::new(Code::NotAMember, "a statement is signed by a node that does not vote")
                .found(format!("node {node}, {}", identity.id()))
                .wanted(format!("a voter of block {}", statement.height))
                .next("ask another node for it"));
        }
        self.check_signer("a statement", &statement.to_bytes(), signature, identity)
    }

    /// Checks the signature of one vote: that this is the identity of the voter, and that it signed this. Whether the node
    /// votes, the caller knows. `identity` as for [`Voters::check`].
    ///
    /// # Errors
    /// [`Code::NotAMember`], [`Code::Untrusted`], [`Code::BadSignature`].
    pub fn check_vote(&self, vote: &Vote, signature: &Signature, identity: &Identity) -> Result<(), Rejection> {
        if signature.node != vote.voter {
            return Err(Rejection::new(Code::BadSignature, "a vote is signed by another node")
                .found(format!("node {}", signature.node))
                .wanted(format!("node {}", vote.voter)));
        }
        self.check_signer("a vote", &vote.to_bytes(), signature, identity)
    }

    /// Checks the signature of a leader's word that it hands over, as [`Voters::check_vote`] does.
    ///
    /// # Errors
    /// As [`Voters::check_vote`].
    pub fn check_transfer(
        &self,
        transfer: &Transfer,
        signature: &Signature,
        identity: &Identity,
    ) -> Result<(), Rejection> {
        if signature.node != transfer.leader {
            return Err(Rejection::new(Code::BadSignature, "a transfer of leadership is signed by another node")
                .found(format!("node {}", signature.node))
                .wanted(format!("node {}", transfer.leader)));
        }
        self.check_signer("a transfer of leadership", &transfer.to_bytes(), signature, identity)
    }

    fn check_signer(
        &self,
        what: &str,
        signed: &[u8],
        signature: &Signature,
        identity: &Identity,
    ) -> Result<(), Rejection> {
        let (node, signer) = (signature.node, identity.id());
        let known = self.nodes.get(&node).ok_or_else(|| {
            Rejection::new(Code::NotAMember, format!("{what} is signed by a node that nobody knows"))
                .found(format!("node {node}, {signer}"))
                .wanted("a node of this network")
                .next("ask another node for it")
        })?;
        if identity.role != Role::Node || identity.organisation != known.organisation || identity.name != known.name {
            return Err(Rejection::new(
                Code::Untrusted,
                format!("{what} is signed with the certificate of somebody else"),
            )
            .found(format!("{signer} with role {}", identity.role))
            .wanted(format!("node {node}, {}/{}", known.organisation, known.name)));
        }
        identity.public_key.verify(signed, &signature.signature).map_err(|error| {
            Rejection::told(Code::BadSignature, &format!("{what} of {signer} is not what it signed: {error}"))
        })
    }

    /// Are these signers enough? A majority of the voters, from two organisations at least if the voters have two; while
    /// voters change, of both sets.
    ///
    /// # Errors
    /// [`Code::Untrusted`] with what is missing.
    pub fn enough(&self, signers: &BTreeSet<u64>) -> Result<(), Rejection> {
        self.enough_of(&self.voters, signers)?;
        if self.outgoing.is_empty() { Ok(()) } else { self.enough_of(&self.outgoing, signers) }
    }

    fn enough_of(&self, voters: &BTreeSet<u64>, signers: &BTreeSet<u64>) -> Result<(), Rejection> {
        let signed: BTreeSet<u64> = voters.intersection(signers).copied().collect();
        let short = |found: String, wanted: String| {
            Err(Rejection::new(Code::Untrusted, "too few voters have signed").found(found).wanted(wanted))
        };
        if signed.len() * 2 <= voters.len() {
            return short(format!("{} of {} voters", signed.len(), voters.len()), "more than half of them".to_owned());
        }
        match (self.organisations(&signed), self.organisations(voters)) {
            (0..2, of @ 2..) => {
                short("voters of one organisation".to_owned(), format!("of two at least, as voters have {of}"))
            }
            _ => Ok(()),
        }
    }

    fn organisations(&self, nodes: &BTreeSet<u64>) -> usize {
        let known = nodes.iter().filter_map(|node| self.nodes.get(node));
        known.map(|voter| &voter.organisation).collect::<BTreeSet<_>>().len()
    }
}
