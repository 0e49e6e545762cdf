//! The voters whose signatures count for a block, and how many of them are enough: those as of the block before it.
//!
//! **How many.** Without another decision: a majority, from two organisations if the voters have two. One organisation that
//! lies can then complete two certificates for one height: with the voters {A, B, C}, A signs one block with B and another
//! one with C. Two certificates exclude that if they overlap in more voters than one hand has. With N voters, of whom the
//! largest hand has m, that takes more than (N + m) / 2 signatures: this is a *strict* certificate. A hand is an
//! organisation, or several that are declared to be under one.
//!
//! N, m and the rule are records of the ledger as of the block before, and nothing else. So every reader counts the same,
//! whatever lies it knows of.

use crate::complaint::Complaint;
use crate::statement::{Signature, Statement};
use crate::transfer::Transfer;
use crate::vote::Vote;
use ledger_base::mutation::{Mutation, active};
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::{Identity, Role};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

/// A node as the ledger knows it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Voter {
    /// The organisation that runs it.
    pub organisation: String,
    /// Common name of its certificates.
    pub name: String,
}

/// How many signatures make a certificate: a record of the ledger.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CertificateRule {
    /// Height of the block that made certificates strict; those of later blocks are. None: they are not.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub strict_since: Option<u64>,
    /// The organisations decided that they are not strict, so that only a proposal makes them strict again.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub cleared: bool,
    /// Organisations under one hand. One that is in none of these sets is a hand of its own.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub hands: Vec<BTreeSet<String>>,
}

/// The faults that a set of voters survives: blocks are ordered and certified, and no two certificates contradict each
/// other.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Survives {
    /// How many voters may crash at once, whichever they are.
    pub crashes: usize,
    /// One hand may lie with all its voters: two certificates for one height cannot be completed.
    pub lie: bool,
    /// One hand may be silent with all its voters, whichever it is.
    pub silence: bool,
}

impl fmt::Display for Survives {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.crashes {
            0 => f.write_str("no crash")?,
            1 => f.write_str("1 crash")?,
            crashes => write!(f, "{crashes} crashes")?,
        }
        let of = |survived| if survived { "of one organisation" } else { "of none" };
        write!(f, ", lies {}, silence {}", of(self.lie), of(self.silence))
    }
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
    /// Number of forced recoveries: statements and votes of another number are for another place.
    pub recoveries: u64,
    /// How many signatures are enough.
    pub rule: CertificateRule,
}

/// The signatures of a strict certificate, of `voters` of whom the largest hand has `largest`: more than half of their sum,
/// and never more than all. Two such sets overlap in more than `largest` voters, unless it is all of them.
pub fn strict_quorum(voters: usize, largest: usize) -> usize {
    let largest = if active(Mutation::ForgetTheHands) { 0 } else { largest };
    ((voters + largest) / 2 + 1).min(voters)
}

impl CertificateRule {
    /// The hand that an organisation belongs to: the first name of those under it, or its own.
    pub fn hand<'a>(&'a self, organisation: &'a str) -> &'a str {
        let shared = self.hands.iter().find(|hand| hand.contains(organisation));
        shared.and_then(|hand| hand.first()).map_or(organisation, String::as_str)
    }
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
        self.check_place("a statement", statement.recoveries)?;
        self.check_signer("a statement", &statement.signed_by(node), signature, identity)
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
        self.check_place("a vote", vote.recoveries)?;
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
        self.check_place("a transfer of leadership", transfer.recoveries)?;
        self.check_signer("a transfer of leadership", &transfer.to_bytes(), signature, identity)
    }

    /// Checks the signature of a complaint, as [`Voters::check_vote`] does.
    ///
    /// # Errors
    /// As [`Voters::check_vote`].
    pub fn check_complaint(
        &self,
        complaint: &Complaint,
        signature: &Signature,
        identity: &Identity,
    ) -> Result<(), Rejection> {
        if signature.node != complaint.node {
            return Err(Rejection::new(Code::BadSignature, "a complaint is signed by another node")
                .found(format!("node {}", signature.node))
                .wanted(format!("node {}", complaint.node)));
        }
        self.check_place("a complaint", complaint.recoveries)?;
        self.check_signer("a complaint", &complaint.to_bytes(), signature, identity)
    }

    /// Are these more voters than the largest hand has? Then one of them at least is honest, if one hand lies. While voters
    /// change, of both sets.
    pub fn outnumber_a_hand(&self, nodes: &BTreeSet<u64>) -> bool {
        self.sets().all(|voters| voters.intersection(nodes).count() > self.largest_hand(voters))
    }

    fn check_place(&self, what: &str, recoveries: u64) -> Result<(), Rejection> {
        if recoveries == self.recoveries {
            return Ok(());
        }
        Err(Rejection::new(Code::Untrusted, format!("{what} was signed before or after another forced recovery"))
            .found(format!("forced recoveries: {recoveries}"))
            .wanted(format!("forced recoveries: {}", self.recoveries))
            .next("ask another node for it"))
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

    /// Are these signers enough? For a strict certificate see [`strict_quorum`]; otherwise a majority of the voters, from two
    /// hands at least if the voters have two. While voters change, of both sets.
    ///
    /// # Errors
    /// [`Code::Untrusted`] with what is missing.
    pub fn enough(&self, signers: &BTreeSet<u64>) -> Result<(), Rejection> {
        self.sets().try_for_each(|voters| self.enough_of(voters, signers))
    }

    /// How many signatures are enough at least; while voters change, for the set that needs more.
    pub fn quorum(&self) -> usize {
        self.sets().map(|voters| self.quorum_of(voters)).max().unwrap_or_default()
    }

    /// The faults that these voters survive; while they change, those that both sets do.
    pub fn survives(&self) -> Survives {
        let each = self.sets().map(|voters| self.survives_of(voters));
        let both = |one: Survives, other: Survives| Survives {
            crashes: one.crashes.min(other.crashes),
            lie: one.lie && other.lie,
            silence: one.silence && other.silence,
        };
        each.reduce(both).unwrap_or(Survives { crashes: 0, lie: false, silence: false })
    }

    /// Could certificates be strict, and any one of the voters be lost?
    pub fn can_be_strict(&self) -> bool {
        let spares = |voters: &BTreeSet<u64>| strict_quorum(voters.len(), self.largest_hand(voters)) < voters.len();
        self.sets().all(spares)
    }

    /// The voters, and those before while they change.
    fn sets(&self) -> impl Iterator<Item = &BTreeSet<u64>> {
        std::iter::once(&self.voters).chain((!self.outgoing.is_empty()).then_some(&self.outgoing))
    }

    fn quorum_of(&self, voters: &BTreeSet<u64>) -> usize {
        match self.rule.strict_since {
            Some(_) => strict_quorum(voters.len(), self.largest_hand(voters)),
            None => voters.len() / 2 + 1,
        }
    }

    fn enough_of(&self, voters: &BTreeSet<u64>, signers: &BTreeSet<u64>) -> Result<(), Rejection> {
        let signed: BTreeSet<u64> = voters.intersection(signers).copied().collect();
        let short = |found: String, wanted: String| {
            Err(Rejection::new(Code::Untrusted, "too few voters have signed").found(found).wanted(wanted))
        };
        let quorum = self.quorum_of(voters);
        if signed.len() < quorum {
            return short(format!("{} of {} voters", signed.len(), voters.len()), format!("at least {quorum}"));
        }
        // A strict certificate has them anyway.
        match (self.hands(&signed).len(), self.hands(voters).len()) {
            (0..2, of @ 2..) => {
                short("voters of one organisation".to_owned(), format!("of two at least, as voters have {of}"))
            }
            _ => Ok(()),
        }
    }

    fn survives_of(&self, voters: &BTreeSet<u64>) -> Survives {
        let (all, quorum, largest) = (voters.len(), self.quorum_of(voters), self.largest_hand(voters));
        let is_strict = self.rule.strict_since.is_some();
        // Without strict certificates the rest must be of two hands, too: more than the largest one has.
        let needed = if is_strict || largest == all { quorum } else { quorum.max(largest + 1) };
        // Two certificates by the hand that lies need this number of honest voters each, and those are not the same ones.
        let others = usize::from(largest < all);
        let goes_on_without = |hand: &str| {
            let rest: BTreeSet<u64> = voters.iter().copied().filter(|node| self.hand_of(*node) != Some(hand)).collect();
            rest.len() * 2 > all && self.enough_of(voters, &rest).is_ok()
        };
        Survives {
            crashes: all.saturating_sub(needed.max(all / 2 + 1)),
            lie: self
                .hands(voters)
                .into_values()
                .all(|liars| 2 * quorum.saturating_sub(liars).max(others) > all - liars),
            silence: self.hands(voters).keys().all(|hand| goes_on_without(hand)),
        }
    }

    /// The hands that these nodes belong to, with how many each has.
    fn hands(&self, nodes: &BTreeSet<u64>) -> BTreeMap<&str, usize> {
        let mut hands = BTreeMap::new();
        for hand in nodes.iter().filter_map(|node| self.hand_of(*node)) {
            *hands.entry(hand).or_default() += 1;
        }
        hands
    }

    fn largest_hand(&self, nodes: &BTreeSet<u64>) -> usize {
        self.hands(nodes).into_values().max().unwrap_or_default()
    }

    fn hand_of(&self, node: u64) -> Option<&str> {
        self.nodes.get(&node).map(|voter| self.rule.hand(&voter.organisation))
    }
}
