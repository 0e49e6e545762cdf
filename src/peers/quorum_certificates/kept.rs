//! The files: the proof of the newest certified block, those of blocks that changed who governs, and the proofs of lies.

use ledger_base::durable::{PUBLIC_MODE, create_directory, failed, read, rename, replace};
use ledger_base::rejection::{Code, Rejection};
use ledger_light::proof::PROOF_BYTES_MAX;
use ledger_light::{DoubleHead, DoubleVote, Lie, Proof};
use std::ffi::OsString;
use std::path::{Path, PathBuf};

/// The directory in the data directory.
const DIRECTORY: &str = "certificates";
/// The proof of the newest certified block.
const NEWEST: &str = "newest.proof";
/// Most proofs that are kept of one node: one would be enough.
const LIES_MAX: usize = 4;

/// A node has lied. The file with the proof is named after this.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Lied {
    /// It has signed two statements about the block of this height.
    About { height: u64, node: u64 },
    /// It has voted for two candidates in this term.
    Voted { term: u64, node: u64 },
    /// It has led with two logs in this term.
    Led { term: u64, node: u64 },
}

impl Lied {
    pub(super) fn node(self) -> u64 {
        match self {
            Self::About { node, .. } | Self::Voted { node, .. } | Self::Led { node, .. } => node,
        }
    }

    fn file(self) -> String {
        match self {
            Self::About { height, node } => format!("{height:020}-{node}.lie"),
            Self::Voted { term, node } => format!("{term:020}-{node}.votes"),
            Self::Led { term, node } => format!("{term:020}-{node}.heads"),
        }
    }

    /// None if the file is no proof of a lie; an error if its name only looks so.
    fn read(name: &str) -> Option<Result<Self, ()>> {
        let (stem, kind) = name.rsplit_once('.')?;
        let of: fn(u64, u64) -> Self = match kind {
            "lie" => |height, node| Self::About { height, node },
            "votes" => |term, node| Self::Voted { term, node },
            "heads" => |term, node| Self::Led { term, node },
            _ => return None,
        };
        let numbers = stem.split_once('-').and_then(|(number, node)| number.parse().ok().zip(node.parse().ok()));
        Some(numbers.ok_or(()).map(|(number, node)| of(number, node)))
    }
}

impl From<&Lie> for Lied {
    fn from(lie: &Lie) -> Self {
        Self::About { height: lie.first.statement.height, node: lie.first.signature.node }
    }
}

impl From<&DoubleVote> for Lied {
    fn from(votes: &DoubleVote) -> Self {
        Self::Voted { term: votes.term, node: votes.voter() }
    }
}

impl From<&DoubleHead> for Lied {
    fn from(heads: &DoubleHead) -> Self {
        Self::Led { term: heads.term, node: heads.leader }
    }
}

/// The newest proof in a data directory, if one was kept.
///
/// # Errors
/// A directory that cannot be read.
pub(crate) fn newest_proof(data: &Path) -> Result<Option<Proof>, Rejection> {
    Kept::open(data)?.newest()
}

/// Moves the proofs of blocks into another directory: they are of a history that this node leaves. A lie stays one.
///
/// # Errors
/// A fault of the disk.
pub(crate) fn set_proofs_aside(data: &Path, aside: &Path) -> Result<(), Rejection> {
    let (from, to) = (Kept::open(data)?, Kept::open(aside)?);
    for name in from.names()?.iter().filter(|name| name.to_str().and_then(Lied::read).is_none()) {
        rename(&from.0.join(name), &to.0.join(name))?;
    }
    Ok(())
}

/// The directory of certificates.
pub(super) struct Kept(PathBuf);

impl Kept {
    /// Makes the directory if it is not there.
    pub(super) fn open(data: &Path) -> Result<Self, Rejection> {
        let place = data.join(DIRECTORY);
        create_directory(&place)?;
        Ok(Self(place))
    }

    /// The directory.
    pub(super) fn directory(&self) -> &Path {
        &self.0
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
            .inspect_err(|reason| tracing::warn!(path = %path.display(), code = reason.code.name(), %reason, "a kept proof is of no use"))
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
    pub(super) fn lie(&self, lied: Lied, proof: &[u8]) -> Result<(), Rejection> {
        if self.lies()?.iter().filter(|known| known.node() == lied.node()).count() >= LIES_MAX {
            return Ok(());
        }
        replace(&self.0.join(lied.file()), proof, PUBLIC_MODE)
    }

    /// The lies that are kept, in order.
    pub(super) fn lies(&self) -> Result<Vec<Lied>, Rejection> {
        let mut lies = Vec::new();
        for name in self.names()? {
            let Some(lied) = name.to_str().and_then(Lied::read) else { continue };
            lies.push(lied.map_err(|()| {
                Rejection::new(Code::BadFile, "the name of a proof of a lie cannot be read")
                    .found(self.0.join(&name).display().to_string())
                    .wanted("HEIGHT-NODE.lie, TERM-NODE.votes or TERM-NODE.heads")
                    .next("move the file away")
            })?);
        }
        lies.sort();
        Ok(lies)
    }

    /// The names of all files.
    fn names(&self) -> Result<Vec<OsString>, Rejection> {
        let names =
            std::fs::read_dir(&self.0).and_then(|entries| entries.map(|entry| Ok(entry?.file_name())).collect());
        names.map_err(|error| failed("list", &self.0, &error))
    }
}

fn of_height(height: u64) -> String {
    format!("{height:020}.proof")
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use ledger_base::hash::Hash;
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
        let about = |node, height| Lied::About { height, node };
        let keep = |lie: &Lie| kept.lie(lie.into(), &lie.to_bytes()).unwrap();
        (1..=10).for_each(|height| keep(&lie(3, height)));
        keep(&lie(2, 7));
        kept.lie(Lied::Voted { term: 9, node: 2 }, b"votes").unwrap();
        kept.lie(Lied::Led { term: 8, node: 2 }, b"heads").unwrap();
        let again = Kept::open(place.path()).unwrap();
        let height = |proof: Option<Proof>| proof.map(|proof| proof.certificate.statement.height);
        assert_eq!(height(again.newest().unwrap()), Some(6));
        let kept_of = [
            about(3, 1),
            about(3, 2),
            about(3, 3),
            about(3, 4),
            about(2, 7),
            Lied::Voted { term: 9, node: 2 },
            Lied::Led { term: 8, node: 2 },
        ];
        assert_eq!(again.lies().unwrap(), kept_of);
        for (at, wanted) in [(4, Some(4)), (5, Some(5)), (6, None)] {
            assert_eq!(height(again.governing(at).unwrap()), wanted);
        }
        // A damaged one is as good as none.
        std::fs::write(place.path().join(DIRECTORY).join(NEWEST), b"ledgerd proof v1\0").unwrap();
        assert_eq!(kept.newest().unwrap(), None);
    }

    #[test]
    fn all_but_the_proofs_of_lies_is_set_aside() {
        let (place, aside) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let kept = Kept::open(place.path()).unwrap();
        let certificate = Certificate { statement: statement(5), signatures: Vec::new() };
        kept.proof(&Proof { certificate, facts: Vec::new() }, true, true).unwrap();
        std::fs::write(kept.0.join("00000000000000000005.passed"), b"").unwrap();
        let lies = [Lied::About { height: 3, node: 2 }, Lied::Voted { term: 4, node: 2 }];
        lies.iter().for_each(|lied| kept.lie(*lied, b"lie").unwrap());
        set_proofs_aside(place.path(), aside.path()).unwrap();
        assert_eq!((kept.names().unwrap().len(), kept.lies().unwrap()), (2, lies.to_vec()));
        let moved = Kept::open(aside.path()).unwrap();
        assert_eq!((moved.names().unwrap().len(), moved.lies().unwrap()), (3, Vec::new()));
        assert!(moved.newest().unwrap().is_some() && kept.newest().unwrap().is_none());
    }
}
