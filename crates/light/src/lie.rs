//! Proofs of misbehaviour: two signed things of one node for one place that differ.
//!
//! | proof | what the node has signed | meaning |
//! |---|---|---|
//! | [`Lie`] | two blocks of one height | the node lies |
//! | [`DoubleVote`] | two candidates in one term | the node lies |
//! | [`DoubleHead`] | two logs in one term, as the leader | the node lies |
//! | [`Fault`] | two results of one block | the node computes something else than before; it does not lie |
//!
//! A place is network, number of forced recoveries, number of the node, and height or term. All of it is signed, so a proof
//! against a former number of a node says nothing about its present one.

use crate::codec::{Reader, put};
use crate::head::{DOUBLE_DOMAIN, DOUBLE_HEAD_BYTES_MAX, DoubleHead};
use crate::statement::{ENCLOSED_BYTES_MAX, SIGNED_BYTES_MAX, Signature, Signed, Statement};
use crate::vote::Vote;
use crate::voters::Voter;
use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::{Identity, Role};
use std::collections::BTreeMap;

const LIE_DOMAIN: &[u8] = b"ledgerd lie v1\0";
const FAULT_DOMAIN: &[u8] = b"ledgerd fault v1\0";
const VOTES_DOMAIN: &[u8] = b"ledgerd double vote v1\0";
/// Longest encoding of a [`Misbehaviour::Lie`].
pub const LIE_BYTES_MAX: usize = LIE_DOMAIN.len() + 2 * (4 + SIGNED_BYTES_MAX);
/// Longest encoding of a [`Misbehaviour::Fault`].
pub const FAULT_BYTES_MAX: usize = FAULT_DOMAIN.len() + 2 * (4 + SIGNED_BYTES_MAX);
/// Longest encoding of a [`DoubleVote`].
pub const DOUBLE_VOTE_BYTES_MAX: usize = VOTES_DOMAIN.len() + 32 + 3 * 8 + 2 * (8 + 4 + ENCLOSED_BYTES_MAX);
/// Longest encoding of a [`Misbehaviour`].
pub const MISBEHAVIOUR_BYTES_MAX: usize = DOUBLE_HEAD_BYTES_MAX;

const _: () = {
    let others = [LIE_BYTES_MAX, FAULT_BYTES_MAX, DOUBLE_VOTE_BYTES_MAX];
    assert!(others[0] <= MISBEHAVIOUR_BYTES_MAX && others[1] <= MISBEHAVIOUR_BYTES_MAX);
    assert!(others[2] <= MISBEHAVIOUR_BYTES_MAX);
};

/// Two statements of one node about different blocks of one place.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Lie {
    /// The one that came first.
    pub first: Signed,
    /// The other one.
    pub second: Signed,
}

/// Two statements of one node about one block that differ, in its results or its time.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Fault {
    /// The one that came first.
    pub first: Signed,
    /// The other one.
    pub second: Signed,
}

/// Two votes of one node for different candidates in one place.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DoubleVote {
    /// Name of the network.
    pub network: Hash,
    /// Number of forced recoveries that the voter has executed.
    pub recoveries: u64,
    /// The term.
    pub term: u64,
    /// When a node saw them, microseconds since the UNIX epoch: the signers' certificates must be valid then. Nobody has
    /// signed it.
    pub time: u64,
    /// The candidates, each with the signature of the vote for it. The voter is the signer.
    pub votes: [(u64, Signature); 2],
}

/// Any of these proofs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Misbehaviour {
    /// Two blocks of one height.
    Lie(Lie),
    /// Two candidates in one term.
    DoubleVote(DoubleVote),
    /// Two logs of a leader in one term.
    DoubleHead(DoubleHead),
    /// Two results of one block.
    Fault(Fault),
}

impl Lie {
    /// Does it prove that one node has lied? Both statements name the same place and different blocks, and a node of one
    /// organisation, name and number has signed both. `identify` as for [`Certificate::verify`](crate::Certificate::verify).
    ///
    /// # Errors
    /// [`Code::Malformed`] if it proves nothing, [`Code::Untrusted`] if the signer is no node, [`Code::BadSignature`], or
    /// what `identify` says.
    pub fn verify(
        &self,
        identify: impl FnMut(&[u8], u64) -> Result<Identity, Rejection>,
    ) -> Result<Identity, Rejection> {
        if self.first.statement.block == self.second.statement.block {
            return Err(nothing_proved(&self.first.statement, &self.second.statement));
        }
        pair_signer(&self.first, &self.second, identify)
    }
}

impl Fault {
    /// Does it prove that one node has computed one block twice, with different results? As [`Lie::verify`], with the same
    /// block in both statements.
    ///
    /// # Errors
    /// As [`Lie::verify`].
    pub fn verify(
        &self,
        identify: impl FnMut(&[u8], u64) -> Result<Identity, Rejection>,
    ) -> Result<Identity, Rejection> {
        let (one, other) = (&self.first.statement, &self.second.statement);
        if one == other || one.block != other.block {
            return Err(nothing_proved(one, other));
        }
        pair_signer(&self.first, &self.second, identify)
    }
}

impl DoubleVote {
    /// The voter.
    pub fn voter(&self) -> u64 {
        self.votes[0].1.node
    }

    /// Its bytes.
    pub fn to_bytes(&self) -> Bytes {
        let numbers = [self.recoveries, self.term, self.time].map(u64::to_be_bytes);
        let mut bytes = [VOTES_DOMAIN, &self.network.0, &numbers.concat()].concat();
        for (candidate, signature) in &self.votes {
            bytes.extend_from_slice(&candidate.to_be_bytes());
            put(&mut bytes, &signature.to_bytes());
        }
        bytes.into()
    }

    /// Reads its bytes. No signature is checked.
    ///
    /// # Errors
    /// [`Code::TooLarge`], [`Code::Malformed`].
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, Rejection> {
        let mut reader = Reader::new("the proof of a double vote", DOUBLE_VOTE_BYTES_MAX, VOTES_DOMAIN, bytes)?;
        let (network, recoveries, term, time) = (reader.hash()?, reader.u64()?, reader.u64()?, reader.u64()?);
        let mut vote = || -> Result<(u64, Signature), Rejection> {
            Ok((reader.u64()?, Signature::from_bytes(reader.part(ENCLOSED_BYTES_MAX)?)?))
        };
        let votes = [vote()?, vote()?];
        reader.end()?;
        Ok(Self { network, recoveries, term, time, votes })
    }

    /// Does it prove that one node has voted for two candidates in one term? `identify` as for [`Lie::verify`].
    ///
    /// # Errors
    /// As [`Lie::verify`].
    pub fn verify(
        &self,
        mut identify: impl FnMut(&[u8], u64) -> Result<Identity, Rejection>,
    ) -> Result<Identity, Rejection> {
        let mut signer = |(candidate, signature): &(u64, Signature)| {
            let Self { network, recoveries, term, .. } = *self;
            let vote = Vote { network, recoveries, term, candidate: *candidate, voter: signature.node };
            let identity = identify(&signature.certificate, self.time)?;
            check(&identity, &vote.to_bytes(), signature).map(|()| identity)
        };
        let [first, second] = &self.votes;
        let (one, other) = (signer(first)?, signer(second)?);
        if first.0 == second.0 || one.id() != other.id() || first.1.node != second.1.node {
            return Err(Rejection::new(Code::Malformed, "two votes prove no lie")
                .found(format!("{} for node {}, {} for node {}", one.id(), first.0, other.id(), second.0))
                .wanted("two votes of one node for two candidates"));
        }
        Ok(one)
    }
}

impl Misbehaviour {
    /// The proof in two statements of one node; none if they do not contradict each other.
    pub fn of(first: Signed, second: Signed) -> Option<Self> {
        let (one, other) = (&first.statement, &second.statement);
        if one == other || !one.is_at_place_of(other) || first.signature.node != second.signature.node {
            return None;
        }
        Some(match one.block == other.block {
            true => Self::Fault(Fault { first, second }),
            false => Self::Lie(Lie { first, second }),
        })
    }

    /// The number of the node.
    pub fn node(&self) -> u64 {
        match self {
            Self::Lie(Lie { first, .. }) | Self::Fault(Fault { first, .. }) => first.signature.node,
            Self::DoubleVote(votes) => votes.voter(),
            Self::DoubleHead(heads) => heads.leader,
        }
    }

    /// Does it prove a lie? A fault is none.
    pub fn is_lie(&self) -> bool {
        !matches!(self, Self::Fault(_))
    }

    /// Its bytes: those of the proof, which begin with its kind.
    pub fn to_bytes(&self) -> Bytes {
        match self {
            Self::Lie(Lie { first, second }) => pair_bytes(LIE_DOMAIN, first, second),
            Self::DoubleVote(votes) => votes.to_bytes(),
            Self::DoubleHead(heads) => heads.to_bytes(),
            Self::Fault(Fault { first, second }) => pair_bytes(FAULT_DOMAIN, first, second),
        }
    }

    /// Reads its bytes. No signature is checked.
    ///
    /// # Errors
    /// [`Code::TooLarge`], [`Code::Malformed`].
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, Rejection> {
        if bytes.starts_with(FAULT_DOMAIN) {
            let reader = Reader::new("the proof of a fault", FAULT_BYTES_MAX, FAULT_DOMAIN, bytes)?;
            return read_pair(reader).map(|(first, second)| Self::Fault(Fault { first, second }));
        }
        if bytes.starts_with(VOTES_DOMAIN) {
            return DoubleVote::from_bytes(bytes).map(Self::DoubleVote);
        }
        if bytes.starts_with(DOUBLE_DOMAIN) {
            return DoubleHead::from_bytes(bytes).map(Self::DoubleHead);
        }
        let reader = Reader::new("the proof of a lie", LIE_BYTES_MAX, LIE_DOMAIN, bytes)?;
        read_pair(reader).map(|(first, second)| Self::Lie(Lie { first, second }))
    }

    /// The node whose misbehaviour it proves, in any network. `identify` as for [`Lie::verify`].
    ///
    /// # Errors
    /// As [`Lie::verify`].
    pub fn signer(
        &self,
        identify: impl FnMut(&[u8], u64) -> Result<Identity, Rejection>,
    ) -> Result<Identity, Rejection> {
        match self {
            Self::Lie(lie) => lie.verify(identify),
            Self::DoubleVote(votes) => votes.verify(identify),
            Self::DoubleHead(heads) => heads.verify(identify),
            Self::Fault(fault) => fault.verify(identify),
        }
    }

    /// Does it prove misbehaviour of a node of this network? `nodes` are those that the ledger knows, former ones among them;
    /// the signer must have the organisation and the name behind its number. `identify` as for [`Lie::verify`].
    ///
    /// # Errors
    /// As [`Lie::verify`]; [`Code::WrongNetwork`]; [`Code::NotAMember`] if the ledger does not know the number.
    pub fn verify(
        &self,
        network: &Hash,
        nodes: &BTreeMap<u64, Voter>,
        identify: impl FnMut(&[u8], u64) -> Result<Identity, Rejection>,
    ) -> Result<Identity, Rejection> {
        let identity = self.signer(identify)?;
        let of = match self {
            Self::Lie(Lie { first, .. }) | Self::Fault(Fault { first, .. }) => first.statement.network,
            Self::DoubleVote(votes) => votes.network,
            Self::DoubleHead(heads) => heads.network,
        };
        if of != *network {
            return Err(Rejection::new(Code::WrongNetwork, "the proof is about a node of another network")
                .found(of.to_string())
                .wanted(network.to_string()));
        }
        let (number, signer) = (self.node(), identity.id());
        let known = nodes.get(&number).ok_or_else(|| {
            Rejection::new(Code::NotAMember, "the proof is about a node that this network never had")
                .found(format!("node {number}, {signer}"))
                .wanted("the number of a node of this network")
        })?;
        if (&identity.organisation, &identity.name) != (&known.organisation, &known.name) {
            return Err(Rejection::new(Code::Untrusted, "the proof is signed with the certificate of another node")
                .found(signer)
                .wanted(format!("node {number}, {}/{}", known.organisation, known.name)));
        }
        Ok(identity)
    }
}

fn pair_bytes(domain: &[u8], first: &Signed, second: &Signed) -> Bytes {
    let mut bytes = domain.to_vec();
    put(&mut bytes, &first.to_bytes());
    put(&mut bytes, &second.to_bytes());
    bytes.into()
}

fn read_pair(mut reader: Reader<'_>) -> Result<(Signed, Signed), Rejection> {
    let first = Signed::from_bytes(reader.part(SIGNED_BYTES_MAX)?)?;
    let second = Signed::from_bytes(reader.part(SIGNED_BYTES_MAX)?)?;
    reader.end()?;
    Ok((first, second))
}

/// The one node that has signed both statements, which name one place.
fn pair_signer(
    first: &Signed,
    second: &Signed,
    mut identify: impl FnMut(&[u8], u64) -> Result<Identity, Rejection>,
) -> Result<Identity, Rejection> {
    let nothing = || nothing_proved(&first.statement, &second.statement);
    if !first.statement.is_at_place_of(&second.statement) || first.signature.node != second.signature.node {
        return Err(nothing());
    }
    let mut signer = |Signed { statement, signature }: &Signed| {
        let identity = identify(&signature.certificate, statement.time)?;
        check(&identity, &statement.signed_by(signature.node), signature).map(|()| identity)
    };
    let (one, other) = (signer(first)?, signer(second)?);
    if one.id() != other.id() {
        return Err(nothing());
    }
    Ok(one)
}

fn nothing_proved(one: &Statement, other: &Statement) -> Rejection {
    let place =
        |of: &Statement| format!("block {} of height {} after {} recoveries", of.block, of.height, of.recoveries);
    Rejection::new(Code::Malformed, "two statements prove nothing")
        .found(format!("{}, and {}", place(one), place(other)))
        .wanted("two statements of one node for one place that differ as their kind of proof says")
}

/// A node with this identity has signed these bytes.
fn check(identity: &Identity, signed: &[u8], signature: &Signature) -> Result<(), Rejection> {
    if identity.role != Role::Node {
        return Err(Rejection::new(Code::Untrusted, "it is signed by somebody who is no node")
            .found(format!("{} with role {}", identity.id(), identity.role))
            .wanted("the certificate of a node"));
    }
    let verified = identity.public_key.verify(signed, &signature.signature);
    verified.map_err(|error| Rejection::told(Code::BadSignature, &error.to_string()))
}
