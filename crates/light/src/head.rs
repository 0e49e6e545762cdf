//! The head of a leader's log, signed once a batch, and the proof that a leader has shown two logs in one term.

use crate::codec::{Reader, put};
use crate::statement::{ENCLOSED_BYTES_MAX, Signature};
use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::key::SigningKey;
use ledger_identity::{Identity, Role};

/// In front of the bytes that are signed, so that they are of no other kind.
const DOMAIN: &[u8] = b"ledgerd head v1\0";

pub(crate) const DOUBLE_DOMAIN: &[u8] = b"ledgerd double head v1\0";
/// Most links of a branch: the entries of one message between nodes.
pub const LINKS_MAX: usize = 1024;
const BRANCH_BYTES_MAX: usize = 32 + 4 + LINKS_MAX * BranchLink::BYTES + 4 + ENCLOSED_BYTES_MAX;
/// Longest encoding of a [`DoubleHead`].
pub const DOUBLE_HEAD_BYTES_MAX: usize = DOUBLE_DOMAIN.len() + 32 + 5 * 8 + 2 * BRANCH_BYTES_MAX;

/// The log of a leader up to a height. An honest leader has one log in a term, which only grows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Head {
    /// Name of the network.
    pub network: Hash,
    /// Number of forced recoveries before.
    pub recoveries: u64,
    /// The leader.
    pub leader: u64,
    /// Its term.
    pub term: u64,
    /// Height of the last entry.
    pub height: u64,
    /// Hash of the chain up to that entry.
    pub hash: Hash,
}

impl Head {
    /// The bytes that are signed.
    pub fn to_bytes(&self) -> Vec<u8> {
        let numbers = [self.recoveries, self.leader, self.term, self.height].map(u64::to_be_bytes);
        [DOMAIN, &self.network.0, &numbers.concat(), &self.hash.0].concat()
    }

    /// Signs it as the leader, with this certificate.
    ///
    /// # Errors
    /// [`Code::Internal`] if the system's randomness fails.
    pub fn sign(&self, certificate: Bytes, key: &SigningKey) -> Result<Signature, Rejection> {
        Signature::make(self.leader, certificate, key, &self.to_bytes())
    }
}

/// A block of a branch: all of its header that the block before and its height do not give.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BranchLink {
    /// Term in which the entry was proposed.
    pub term: u64,
    /// Block time, microseconds since the UNIX epoch.
    pub time: u64,
    /// Merkle root over the content.
    pub root: Hash,
}

/// One of the two logs of a leader: from the height at which they differ up to a signed head.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Branch {
    /// Hash of its block at the height at which the two differ.
    pub base: Hash,
    /// The blocks after it, up to the head.
    pub links: Vec<BranchLink>,
    /// The leader's signature of the head.
    pub signature: Signature,
}

/// Two heads of one leader that cannot both be honest: in one term, above two different blocks of one height.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DoubleHead {
    /// Name of the network.
    pub network: Hash,
    /// Number of forced recoveries before.
    pub recoveries: u64,
    /// The leader.
    pub leader: u64,
    /// The term.
    pub term: u64,
    /// The height at which the two logs differ.
    pub height: u64,
    /// When a node saw them, microseconds since the UNIX epoch: the signer's certificates must be valid then. It is not signed.
    pub time: u64,
    /// The two logs.
    pub branches: [Branch; 2],
}

/// The hash of a block: SHA-256 over the domain tag and the fields of its header in order.
pub fn block_hash(height: u64, link: &BranchLink, previous: Hash) -> Hash {
    let [height, term, time] = [height, link.term, link.time].map(u64::to_be_bytes);
    Hash::of(&[b"ledgerd block v1\0", &height, &term, &time, &previous.0, &link.root.0])
}

impl BranchLink {
    /// Length of its encoding, in bytes.
    pub const BYTES: usize = 8 + 8 + 32;

    /// Appends its bytes.
    pub fn write(&self, bytes: &mut Vec<u8>) {
        bytes.extend_from_slice(&self.term.to_be_bytes());
        bytes.extend_from_slice(&self.time.to_be_bytes());
        bytes.extend_from_slice(&self.root.0);
    }

    /// Reads its bytes.
    ///
    /// # Errors
    /// [`Code::Malformed`] if there are too few.
    pub fn read(reader: &mut Reader<'_>) -> Result<Self, Rejection> {
        Ok(Self { term: reader.u64()?, time: reader.u64()?, root: reader.hash()? })
    }
}

impl Branch {
    /// The head that its signature is for.
    fn head(&self, of: &DoubleHead) -> Head {
        let (mut height, mut hash) = (of.height, self.base);
        for link in &self.links {
            height = height.saturating_add(1);
            hash = block_hash(height, link, hash);
        }
        let DoubleHead { network, recoveries, leader, term, .. } = *of;
        Head { network, recoveries, leader, term, height, hash }
    }

    fn write(&self, bytes: &mut Vec<u8>) {
        bytes.extend_from_slice(&self.base.0);
        bytes.extend_from_slice(&(self.links.len() as u32).to_be_bytes());
        self.links.iter().for_each(|link| link.write(bytes));
        put(bytes, &self.signature.to_bytes());
    }

    fn read(reader: &mut Reader<'_>) -> Result<Self, Rejection> {
        let (base, count) = (reader.hash()?, reader.u32()? as usize);
        if count > LINKS_MAX {
            return Err(reader.malformed(&format!("{count} blocks"), &format!("at most {LINKS_MAX}")));
        }
        let links = (0..count).map(|_| BranchLink::read(reader)).collect::<Result<_, _>>()?;
        Ok(Self { base, links, signature: Signature::from_bytes(reader.part(ENCLOSED_BYTES_MAX)?)? })
    }
}

impl DoubleHead {
    /// Its bytes.
    pub fn to_bytes(&self) -> Bytes {
        let numbers = [self.recoveries, self.leader, self.term, self.height, self.time].map(u64::to_be_bytes);
        let mut bytes = [DOUBLE_DOMAIN, &self.network.0, &numbers.concat()].concat();
        self.branches.iter().for_each(|branch| branch.write(&mut bytes));
        bytes.into()
    }

    /// Reads its bytes. No signature is checked.
    ///
    /// # Errors
    /// [`Code::TooLarge`], [`Code::Malformed`].
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, Rejection> {
        let mut reader = Reader::new("the proof of two heads", DOUBLE_HEAD_BYTES_MAX, DOUBLE_DOMAIN, bytes)?;
        let (network, recoveries, leader) = (reader.hash()?, reader.u64()?, reader.u64()?);
        let (term, height, time) = (reader.u64()?, reader.u64()?, reader.u64()?);
        let branches = [Branch::read(&mut reader)?, Branch::read(&mut reader)?];
        reader.end()?;
        Ok(Self { network, recoveries, leader, term, height, time, branches })
    }

    /// Does it prove that one leader has shown two logs in one term? `identify` as for
    /// [`Certificate::verify`](crate::Certificate::verify).
    ///
    /// # Errors
    /// [`Code::Malformed`] if it proves nothing, [`Code::Untrusted`] if the signer is no node, [`Code::BadSignature`], or
    /// what `identify` says.
    pub fn verify(
        &self,
        mut identify: impl FnMut(&[u8], u64) -> Result<Identity, Rejection>,
    ) -> Result<Identity, Rejection> {
        let mut signer = |branch: &Branch| {
            let signature = &branch.signature;
            let identity = identify(&signature.certificate, self.time)?;
            if identity.role != Role::Node {
                return Err(Rejection::new(Code::Untrusted, "a head is signed by an identity that is no node")
                    .found(format!("{} with role {}", identity.id(), identity.role))
                    .wanted("the certificate of a node"));
            }
            let verified = identity.public_key.verify(&branch.head(self).to_bytes(), &signature.signature);
            verified.map_err(|error| Rejection::told(Code::BadSignature, &error.to_string()))?;
            Ok(identity)
        };
        let [first, second] = &self.branches;
        let (one, other) = (signer(first)?, signer(second)?);
        let is_leader = |branch: &Branch| branch.signature.node == self.leader;
        if first.base == second.base || one.id() != other.id() || !is_leader(first) || !is_leader(second) {
            return Err(Rejection::new(Code::Malformed, "two heads prove no lie")
                .found(format!("{} of {}, {} of {}", first.base, one.id(), second.base, other.id()))
                .wanted("two heads of one leader in one term above different blocks of one height"));
        }
        Ok(one)
    }
}
