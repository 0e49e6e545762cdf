//! The state digest: a chain over what each block did, so that a verdict is proved by any later certificate.
//!
//! ```text
//! d(h) = H("ledgerd state v1" 00 ‖ d(h-1) ‖ e(h))     the state digest, in the ground of a certified block
//! e(h) = H("ledgerd effects v1" 00 ‖ w(h) ‖ v(h))     the effects of the block
//! w(h)                                                 hash over what it wrote
//! v(h)                                                 Merkle root over its verdicts, each a Fact::Verdict
//! ```
//! A voter signs the ground of the first block of 200 ms. The blocks between have no certificate of their own. Their effects, 32 bytes
//! each, lead from the digest before a block to the certified one.

use crate::codec::{Reader, put};
use crate::fact::{FACT_BYTES_MAX, Fact};
use crate::merkle::{self, PATH_BYTES_MAX, Path};
use crate::proof::Shown;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};

/// In front of what is hashed to a digest.
const STATE: &[u8] = b"ledgerd state v1\0";
/// In front of what is hashed to effects.
const EFFECTS: &[u8] = b"ledgerd effects v1\0";
/// Most blocks between a verdict and the certificate that proves it.
pub const LATER_MAX: usize = 16 * 1024;
/// Longest encoding of a [`ProvedVerdict`].
pub const PROVED_VERDICT_BYTES_MAX: usize = 3 * 4 + 2 * 32 + FACT_BYTES_MAX + PATH_BYTES_MAX + LATER_MAX * 32;

/// The state digest after a block, by the one before it and its effects.
pub fn digest(previous: Hash, effects: Hash) -> Hash {
    Hash::of(&[STATE, &previous.0, &effects.0])
}

/// The effects of a block: by the hash over what it wrote, and the leaves of its verdicts in order.
pub fn effects(writes: Hash, verdicts: Vec<Hash>) -> Hash {
    joined(writes, merkle::root(verdicts))
}

fn joined(writes: Hash, verdicts: Hash) -> Hash {
    Hash::of(&[EFFECTS, &writes.0, &verdicts.0])
}

/// A verdict, with the way from it to the state digest of a later block.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ProvedVerdict {
    /// The state digest before its block.
    pub before: Hash,
    /// Hash over what its block wrote.
    pub writes: Hash,
    /// The verdict, and its path among those of the block.
    pub verdict: Shown,
    /// The effects of each block after its own, up to that of the digest.
    pub later: Vec<Hash>,
}

impl ProvedVerdict {
    /// The number of the code, and the hash of the answer. The transaction has this id and stands at this position of its block,
    /// and `digest` is that of the last of so many blocks.
    ///
    /// # Errors
    /// [`Code::Untrusted`] if it does not, or is that of another transaction; [`Code::Malformed`].
    pub fn check(&self, (index, id): (u32, &Hash), blocks: usize, digest: Hash) -> Result<(u32, Hash), Rejection> {
        let fact = Fact::from_bytes(&self.verdict.fact)?;
        let found = match fact {
            Fact::Verdict { index: at, id: of, code, response } if at == index && of == *id => Some((code, response)),
            _ => None,
        };
        let root = self.verdict.path.root(fact.leaf()).filter(|_| self.verdict.path.index == index);
        let own = root.map(|verdicts| joined(self.writes, verdicts));
        let after = own.map(|own| {
            let effects = std::iter::once(&own).chain(&self.later);
            effects.fold(self.before, |before, effects| self::digest(before, *effects))
        });
        found.filter(|_| after == Some(digest) && self.later.len() + 1 == blocks).ok_or_else(|| {
            Rejection::new(Code::Untrusted, "the verdict is not the one of the certified chain")
                .found(format!(
                    "a way over {} blocks that leads elsewhere, or another transaction",
                    self.later.len() + 1
                ))
                .wanted(format!("one over {blocks} blocks to the state digest {digest}"))
                .next("ask another node")
        })
    }

    /// Appends its bytes.
    pub fn write(&self, bytes: &mut Vec<u8>) {
        bytes.extend_from_slice(&self.before.0);
        bytes.extend_from_slice(&self.writes.0);
        put(bytes, &self.verdict.fact);
        put(bytes, &self.verdict.path.to_bytes());
        bytes.extend_from_slice(&(self.later.len() as u32).to_be_bytes());
        self.later.iter().for_each(|effects| bytes.extend_from_slice(&effects.0));
    }

    /// Reads its bytes. Nothing is checked.
    ///
    /// # Errors
    /// [`Code::TooLarge`], [`Code::Malformed`].
    pub fn read(reader: &mut Reader<'_>) -> Result<Self, Rejection> {
        let (before, writes) = (reader.hash()?, reader.hash()?);
        let fact = reader.part_owned(FACT_BYTES_MAX)?;
        let verdict = Shown { fact, path: Path::from_bytes(reader.part(PATH_BYTES_MAX)?)? };
        let count = reader.u32()? as usize;
        if count > LATER_MAX {
            return Err(reader.malformed(&format!("{count} blocks"), &format!("at most {LATER_MAX}")));
        }
        let later = (0..count).map(|_| reader.hash()).collect::<Result<_, _>>()?;
        Ok(Self { before, writes, verdict, later })
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]
mod tests {
    use super::*;

    fn hash(of: u32) -> Hash {
        Hash::of(&[&of.to_be_bytes()])
    }

    fn verdict(index: u32) -> Fact<'static> {
        Fact::Verdict { index, id: hash(index), code: index % 2, response: hash(100 + index) }
    }

    /// A block of three verdicts, and as many after it; the digest after the last.
    fn proved(index: u32, later: u32) -> (ProvedVerdict, Hash) {
        let leaves: Vec<Hash> = (0..3).map(|index| verdict(index).leaf()).collect();
        let verdict = Shown::of(&verdict(index), &leaves, index).unwrap();
        let later: Vec<Hash> = (0..later).map(|block| effects(hash(block), vec![hash(block)])).collect();
        let own = digest(hash(7), effects(hash(8), leaves));
        let end = later.iter().fold(own, |before, effects| digest(before, *effects));
        (ProvedVerdict { before: hash(7), writes: hash(8), verdict, later }, end)
    }

    #[test]
    fn a_verdict_leads_to_the_digest_of_each_later_block() {
        for later in [0, 1, 50] {
            for index in 0..3 {
                let (proved, end) = proved(index, later);
                let blocks = later as usize + 1;
                assert_eq!(
                    proved.check((index, &hash(index)), blocks, end).unwrap(),
                    (index % 2, hash(100 + index)),
                    "{index} of a block {later} before"
                );
                let other = (index + 1) % 3;
                assert!(proved.check((other, &hash(index)), blocks, end).is_err(), "another position");
                assert!(proved.check((index, &hash(other)), blocks, end).is_err(), "another transaction");
                assert!(proved.check((index, &hash(index)), blocks + 1, end).is_err(), "another length");
                assert!(proved.check((index, &hash(index)), blocks, hash(1)).is_err(), "another digest");
            }
        }
    }

    #[test]
    fn it_is_read_as_it_was_written_and_proves_nothing_once_a_byte_is_changed() {
        let (proved, end) = proved(1, 3);
        let mut bytes = Vec::new();
        proved.write(&mut bytes);
        let read = |bytes: &[u8]| {
            let mut reader = Reader::new("a verdict", PROVED_VERDICT_BYTES_MAX, &[], bytes)?;
            let read = ProvedVerdict::read(&mut reader)?;
            reader.end()?;
            Ok::<_, Rejection>(read)
        };
        assert_eq!(read(&bytes).unwrap(), proved);
        for at in 0..bytes.len() {
            let mut changed = bytes.clone();
            changed[at] ^= 1;
            let checked = read(&changed).and_then(|proved| proved.check((1, &hash(1)), 4, end));
            assert!(checked.is_err(), "byte {at}");
            assert!(read(&bytes[..at]).is_err(), "cut at {at}");
        }
        assert!(bytes.len() < PROVED_VERDICT_BYTES_MAX);
        let count = bytes.len() - 3 * 32 - 4;
        bytes[count..count + 4].copy_from_slice(&(LATER_MAX as u32 + 1).to_be_bytes());
        assert!(read(&bytes).is_err());
    }
}
