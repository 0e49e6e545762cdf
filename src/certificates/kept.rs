//! The files: the proof of the newest certified block, those of blocks that changed who governs, and the proofs of lies.

use ledger_durable::{PUBLIC_MODE, create_directory, failed, read, replace};
use ledger_light::proof::PROOF_BYTES_MAX;
use ledger_light::{Lie, Proof};
use ledger_rejection::{Code, Rejection};
use std::path::{Path, PathBuf};

/// The directory in the data directory.
const DIRECTORY: &str = "certificates";
/// The proof of the newest certified block.
const NEWEST: &str = "newest.proof";
/// Most proofs that are kept of one node: one would be enough.
const LIES_MAX: usize = 4;

/// The directory of certificates.
pub(super) struct Kept(PathBuf);

impl Kept {
    /// Makes the directory if it is not there.
    pub(super) fn open(data: &Path) -> Result<Self, Rejection> {
        let place = data.join(DIRECTORY);
        create_directory(&place)?;
        Ok(Self(place))
    }

    /// The newest proof that was kept. One that cannot be read is as good as none: there will be a newer one.
    pub(super) fn newest(&self) -> Result<Option<Proof>, Rejection> {
        self.read(NEWEST)
    }

    /// The proof of a block that changed who governs.
    pub(super) fn governing(&self, height: u64) -> Result<Option<Proof>, Rejection> {
        self.read(&of_height(height))
    }

    fn read(&self, name: &str) -> Result<Option<Proof>, Rejection> {
        let path = self.0.join(name);
        if !path.exists() {
            return Ok(None);
        }
        Ok(Proof::from_bytes(&read(&path, PROOF_BYTES_MAX)?)
            .inspect_err(|reason| tracing::warn!(path = %path.display(), %reason, "a kept proof is of no use"))
            .ok())
    }

    /// Keeps a proof: as the newest, and for good if its block changed who governs.
    pub(super) fn proof(&self, proof: &Proof, newest: bool, governs: bool) -> Result<(), Rejection> {
        let bytes = proof.to_bytes();
        if governs {
            replace(&self.0.join(of_height(proof.certificate.statement.height)), &bytes, PUBLIC_MODE)?;
        }
        if newest { replace(&self.0.join(NEWEST), &bytes, PUBLIC_MODE) } else { Ok(()) }
    }

    /// Keeps the proof of a lie.
    pub(super) fn lie(&self, lie: &Lie) -> Result<(), Rejection> {
        let (node, height) = (lie.first.signature.node, lie.first.statement.height);
        if self.lies()?.iter().filter(|(liar, _)| *liar == node).count() >= LIES_MAX {
            return Ok(());
        }
        replace(&self.0.join(format!("{height:020}-{node}.lie")), &lie.to_bytes(), PUBLIC_MODE)
    }

    /// The nodes that have lied, and the heights, in order of heights.
    pub(super) fn lies(&self) -> Result<Vec<(u64, u64)>, Rejection> {
        let unreadable = |error| failed("list", &self.0, &error);
        let mut lies = Vec::new();
        for entry in std::fs::read_dir(&self.0).map_err(unreadable)? {
            let name = entry.map_err(unreadable)?.file_name();
            let parts = name.to_str().and_then(|name| name.strip_suffix(".lie")).and_then(|name| name.split_once('-'));
            let Some((height, node)) = parts else { continue };
            let numbers = node.parse().ok().zip(height.parse().ok());
            lies.push(numbers.ok_or_else(|| {
                Rejection::new(Code::BadFile, "the name of a proof of a lie cannot be read")
                    .found(self.0.join(&name).display().to_string())
                    .wanted("HEIGHT-NODE.lie")
                    .next("move the file away")
            })?);
        }
        lies.sort_by_key(|(node, height)| (*height, *node));
        Ok(lies)
    }
}

fn of_height(height: u64) -> String {
    format!("{height:020}.proof")
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use ledger_hash::Hash;
    use ledger_light::{Certificate, Signature, Signed, Statement};

    fn statement(height: u64) -> Statement {
        Statement { network: Hash::ZERO, height, time: 1, block: Hash::ZERO, results: Hash::ZERO }
    }

    fn lie(node: u64, height: u64) -> Lie {
        let signature = Signature { node, certificate: Default::default(), signature: Default::default() };
        let signed = Signed { statement: statement(height), signature };
        Lie { first: signed.clone(), second: signed }
    }

    #[test]
    fn proofs_and_lies_are_found_again_and_lies_of_a_node_are_bounded() {
        let place = tempfile::tempdir().unwrap();
        let kept = Kept::open(place.path()).unwrap();
        assert_eq!((kept.newest().unwrap(), kept.lies().unwrap()), (None, Vec::new()));
        for (height, newest, governs) in [(5, true, true), (4, false, true), (6, true, false)] {
            let certificate = Certificate { statement: statement(height), signatures: Vec::new() };
            kept.proof(&Proof { certificate, facts: Vec::new() }, newest, governs).unwrap();
        }
        for height in 1..=10 {
            kept.lie(&lie(3, height)).unwrap();
        }
        kept.lie(&lie(2, 7)).unwrap();
        let again = Kept::open(place.path()).unwrap();
        let height = |proof: Option<Proof>| proof.map(|proof| proof.certificate.statement.height);
        assert_eq!(height(again.newest().unwrap()), Some(6));
        assert_eq!(again.lies().unwrap(), [(3, 1), (3, 2), (3, 3), (3, 4), (2, 7)]);
        for (at, wanted) in [(4, Some(4)), (5, Some(5)), (6, None)] {
            assert_eq!(height(again.governing(at).unwrap()), wanted);
        }
        // A damaged one is as good as none.
        std::fs::write(place.path().join(DIRECTORY).join(NEWEST), b"ledgerd proof v1\0").unwrap();
        assert_eq!(kept.newest().unwrap(), None);
    }
}
