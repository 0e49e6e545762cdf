//! The proofs of lies: two different statements of one node about one height, or two votes of one node in one term.

use crate::codec::{Reader, put};
use crate::statement::{ENCLOSED_BYTES_MAX, SIGNED_BYTES_MAX, Signature, Signed};
use crate::vote::Vote;
use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::{Identity, Role};

const DOMAIN: &[u8] = b"ledgerd lie v1\0";
/// Longest encoding.
pub const LIE_BYTES_MAX: usize = DOMAIN.len() + 2 * (4 + SIGNED_BYTES_MAX);

const VOTES_DOMAIN: &[u8] = b"ledgerd double vote v1\0";
/// Longest encoding of a [`DoubleVote`].
pub const DOUBLE_VOTE_BYTES_MAX: usize = VOTES_DOMAIN.len() + 32 + 2 * 8 + 2 * (8 + 4 + ENCLOSED_BYTES_MAX);

/// Two statements of one node that cannot both be honest.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Lie {
    /// The one that came first.
    pub first: Signed,
    /// The other one.
    pub second: Signed,
}

impl Lie {
    /// Its bytes.
    pub fn to_bytes(&self) -> Bytes {
        let mut bytes = DOMAIN.to_vec();
        put(&mut bytes, &self.first.to_bytes());
        put(&mut bytes, &self.second.to_bytes());
        bytes.into()
    }

    /// Reads its bytes. No signature is checked.
    ///
    /// # Errors
    /// [`Code::TooLarge`], [`Code::Malformed`].
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, Rejection> {
        let mut reader = Reader::new("the proof of a lie", LIE_BYTES_MAX, DOMAIN, bytes)?;
        let first = Signed::from_bytes(reader.part(SIGNED_BYTES_MAX)?)?;
        let second = Signed::from_bytes(reader.part(SIGNED_BYTES_MAX)?)?;
        reader.end()?;
        Ok(Self { first, second })
    }

    /// Does it prove that one node has lied? Both statements are about one height of one network, differ, and both
    /// signatures are by a node of the same organisation and name. Its number is not signed: the record of that node in
    /// the governing state tells. `identify` as for [`Certificate::verify`](crate::Certificate::verify).
    ///
    /// # Errors
    /// [`Code::Malformed`] if it proves nothing, [`Code::Untrusted`] if the signer is no node, [`Code::BadSignature`], or
    /// what `identify` says.
    pub fn verify(
        &self,
        mut identify: impl FnMut(&[u8], u64) -> Result<Identity, Rejection>,
    ) -> Result<Identity, Rejection> {
        let (one, other) = (&self.first.statement, &self.second.statement);
        let nothing = || {
            Rejection::new(Code::Malformed, "two statements prove no lie")
                .found(format!("heights {} and {}", one.height, other.height))
                .wanted("two different statements of one node about one height of one network")
        };
        if one == other || one.height != other.height || one.network != other.network {
            return Err(nothing());
        }
        let mut signer = |signed: &Signed| {
            let identity = identify(&signed.signature.certificate, signed.statement.time)?;
            check(&identity, &signed.statement.to_bytes(), &signed.signature).map(|()| identity)
        };
        let (first, second) = (signer(&self.first)?, signer(&self.second)?);
        if first.id() != second.id() || self.first.signature.node != self.second.signature.node {
            return Err(nothing());
        }
        Ok(first)
    }
}

/// Two votes of one node that cannot both be honest: in one term, for two candidates.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DoubleVote {
    /// Name of the network.
    pub network: Hash,
    /// The term.
    pub term: u64,
    /// When a node saw them, microseconds since the UNIX epoch: the signers' certificates must be valid then. Nobody has
    /// signed it.
    pub time: u64,
    /// The candidates, each with the signature of the vote for it. The voter is the signer.
    pub votes: [(u64, Signature); 2],
}

impl DoubleVote {
    /// The voter.
    pub fn voter(&self) -> u64 {
        self.votes[0].1.node
    }

    /// Its bytes.
    pub fn to_bytes(&self) -> Bytes {
        let mut bytes = [VOTES_DOMAIN, &self.network.0, &self.term.to_be_bytes(), &self.time.to_be_bytes()].concat();
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
        let (network, term, time) = (reader.hash()?, reader.u64()?, reader.u64()?);
        let mut vote = || -> Result<(u64, Signature), Rejection> {
            Ok((reader.u64()?, Signature::from_bytes(reader.part(ENCLOSED_BYTES_MAX)?)?))
        };
        let votes = [vote()?, vote()?];
        reader.end()?;
        Ok(Self { network, term, time, votes })
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
            let vote = Vote { network: self.network, term: self.term, candidate: *candidate, voter: signature.node };
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
