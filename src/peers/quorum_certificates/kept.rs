//! The files: the proof of the newest certified block, those of blocks that changed who governs, and the proofs of misbehaviour.

use crate::storage::files::{CERTIFICATES_DIRECTORY, NEWEST_PROOF_FILE};
use ledger::branch::{BRANCH_BYTES_MAX, CertifiedBranch};
use ledger_base::durable::{PUBLIC_MODE, create_directory, failed, read, rename, replace};
use ledger_base::rejection::{Code, Rejection};
use ledger_light::lie::MISBEHAVIOUR_BYTES_MAX;
use ledger_light::proof::PROOF_BYTES_MAX;
use ledger_light::statement::STATEMENT_BYTES;
use ledger_light::{Misbehaviour, Proof, Statement};
use std::ffi::OsString;
use std::fs::OpenOptions;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

/// The certified part of another branch that contradicts a block which this node's own certificate covers.
const OTHER: &str = "other.branch";
/// The statements that this node has signed last, one after the other; see [`Kept::record`].
const SIGNED: &str = "signed";
/// Statements in it.
const SIGNED_MAX: u64 = 256;

/// The kind of a proof of misbehaviour.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Kind {
    /// Two blocks of one height.
    Lie,
    /// Two candidates in one term.
    DoubleVote,
    /// Two logs in one term.
    DoubleHead,
    /// Two results of one block.
    Fault,
}

impl Kind {
    const ALL: [Self; 4] = [Self::Lie, Self::DoubleVote, Self::DoubleHead, Self::Fault];

    fn suffix(self) -> &'static str {
        match self {
            Self::Lie => ".lie",
            Self::DoubleVote => ".votes",
            Self::DoubleHead => ".heads",
            Self::Fault => ".fault",
        }
    }
}

/// The proof that a node has misbehaved. Its file is named after this.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct ProofName {
    /// Height of the block, or the term of a double vote or head.
    pub(super) place: u64,
    /// Number of the node.
    pub(super) node: u64,
    /// Its kind.
    pub(super) kind: Kind,
}

impl ProofName {
    /// Of one node and kind, one proof is enough.
    pub(super) fn says_as_much_as(self, other: Self) -> bool {
        (self.node, self.kind) == (other.node, other.kind)
    }

    fn file(self) -> String {
        format!("{:020}-{}{}", self.place, self.node, self.kind.suffix())
    }

    /// None if the file is no proof of misbehaviour; an error if its name only looks so.
    fn read(name: &str) -> Option<Result<Self, ()>> {
        let (kind, stem) = Kind::ALL.iter().find_map(|kind| Some((*kind, name.strip_suffix(kind.suffix())?)))?;
        let numbers = stem.split_once('-').and_then(|(place, node)| place.parse().ok().zip(node.parse().ok()));
        Some(numbers.ok_or(()).map(|(place, node)| Self { place, node, kind }))
    }
}

impl From<&Misbehaviour> for ProofName {
    fn from(proof: &Misbehaviour) -> Self {
        let (place, kind) = match proof {
            Misbehaviour::Lie(lie) => (lie.first.statement.height, Kind::Lie),
            Misbehaviour::DoubleVote(votes) => (votes.term, Kind::DoubleVote),
            Misbehaviour::DoubleHead(heads) => (heads.term, Kind::DoubleHead),
            Misbehaviour::Fault(fault) => (fault.first.statement.height, Kind::Fault),
        };
        Self { place, node: proof.node(), kind }
    }
}

/// The newest proof in a data directory, if one was kept.
///
/// # Errors
/// A directory that cannot be read.
pub(crate) fn newest_proof(data: &Path) -> Result<Option<Proof>, Rejection> {
    Kept::open(data)?.newest()
}

/// The newest height up to this one for which a data directory has a proof: the newest one, or that of a governing block; 0 if it
/// has none.
///
/// # Errors
/// A directory that cannot be read.
pub(crate) fn certified_up_to(data: &Path, height: u64) -> Result<u64, Rejection> {
    let kept = Kept::open(data)?;
    let newest = kept.newest()?.map(|newest| newest.certificate.statement.height);
    let governing = kept.names()?.into_iter().filter_map(|name| name.to_str()?.strip_suffix(".proof")?.parse().ok());
    Ok(governing.chain(newest).filter(|certified| *certified <= height).max().unwrap_or_default())
}

/// Moves the proofs of blocks into another directory: they are of a history that this node leaves. Proofs of
/// misbehaviour stay.
///
/// # Errors
/// A fault of the disk.
pub(crate) fn set_proofs_aside(data: &Path, aside: &Path) -> Result<(), Rejection> {
    let (from, to) = (Kept::open(data)?, Kept::open(aside)?);
    for name in from.names()?.iter().filter(|name| name.to_str().and_then(ProofName::read).is_none()) {
        rename(&from.0.join(name), &to.0.join(name))?;
    }
    Ok(())
}

/// The directory of certificates.
pub(super) struct Kept(PathBuf);

impl Kept {
    /// Makes the directory if it is not there.
    pub(super) fn open(data: &Path) -> Result<Self, Rejection> {
        let place = data.join(CERTIFICATES_DIRECTORY);
        create_directory(&place)?;
        Ok(Self(place))
    }

    /// The directory.
    pub(super) fn directory(&self) -> &Path {
        &self.0
    }

    /// The newest proof that was kept. One that cannot be read is as good as none: there will be a newer one.
    pub(super) fn newest(&self) -> Result<Option<Proof>, Rejection> {
        self.read(NEWEST_PROOF_FILE)
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
            .inspect_err(|reason| {
                tracing::warn!(path = %path.display(), code = reason.code.name(), %reason, "a \
                                                                                                              stored \
                                                                                                              proof \
                                                                                                              is not \
                                                                                                              usable")
            })
            .ok())
    }

    /// Keeps the newest proof.
    ///
    /// # Errors
    /// A fault of the disk.
    pub(super) fn write_newest(&self, proof: &Proof) -> Result<(), Rejection> {
        replace(&self.0.join(NEWEST_PROOF_FILE), &proof.to_bytes(), PUBLIC_MODE)
    }

    /// Keeps the proof of a block that changed who governs, for good.
    ///
    /// # Errors
    /// A fault of the disk.
    pub(super) fn write_governing(&self, proof: &Proof) -> Result<(), Rejection> {
        replace(&self.0.join(of_height(proof.certificate.statement.height)), &proof.to_bytes(), PUBLIC_MODE)
    }

    /// Keeps the certified part of another branch that contradicts an own certificate.
    ///
    /// # Errors
    /// A fault of the disk.
    pub(super) fn other_branch(&self, branch: &CertifiedBranch) -> Result<(), Rejection> {
        replace(&self.0.join(OTHER), &branch.to_bytes(), PUBLIC_MODE)
    }

    /// The certified part of another branch that was kept. One that cannot be read proves nothing.
    ///
    /// # Errors
    /// A fault of the disk.
    pub(super) fn kept_branch(&self) -> Result<Option<CertifiedBranch>, Rejection> {
        let path = self.0.join(OTHER);
        if !path.exists() {
            return Ok(None);
        }
        Ok(CertifiedBranch::from_bytes(&read(&path, BRANCH_BYTES_MAX)?)
            .inspect_err(|reason| {
                tracing::warn!(path = %path.display(), code = reason.code.name(), %reason, "cannot \
                                                                                                              read a \
                                                                                                              stored \
                                                                                                              branch")
            })
            .ok())
    }

    /// Records that this node signs a statement, in the place of one of 256 heights before. It is not synchronised with the
    /// disk: what a crash loses is not signed again, which is as safe.
    ///
    /// # Errors
    /// A fault of the disk.
    pub(super) fn record(&self, statement: &Statement) -> Result<(), Rejection> {
        let path = self.0.join(SIGNED);
        let at = statement.height % SIGNED_MAX * STATEMENT_BYTES as u64;
        let file = OpenOptions::new().create(true).write(true).truncate(false).open(&path);
        let written = file.and_then(|file| file.write_all_at(&statement.to_bytes(), at));
        written.map_err(|error| failed("write", &path, &error))
    }

    /// The statements that this node has recorded. Bytes that are none, such as those of a torn write, are left out.
    ///
    /// # Errors
    /// A fault of the disk.
    pub(super) fn recorded(&self) -> Result<Vec<Statement>, Rejection> {
        let path = self.0.join(SIGNED);
        if !path.exists() {
            return Ok(Vec::new());
        }
        let bytes = read(&path, SIGNED_MAX as usize * STATEMENT_BYTES)?;
        Ok(bytes.chunks(STATEMENT_BYTES).filter_map(|bytes| Statement::from_bytes(bytes).ok()).collect())
    }

    /// Keeps a proof of misbehaviour: one of each kind of a node.
    ///
    /// # Errors
    /// A fault of the disk.
    pub(super) fn misbehaviour(&self, proof: &Misbehaviour) -> Result<(), Rejection> {
        let name = ProofName::from(proof);
        if self.proof_names()?.iter().any(|known| known.says_as_much_as(name)) {
            return Ok(());
        }
        replace(&self.0.join(name.file()), &proof.to_bytes(), PUBLIC_MODE)
    }

    /// The proofs of misbehaviour that are kept, in order. One that cannot be read proves nothing.
    ///
    /// # Errors
    /// A fault of the disk; [`Code::BadFile`] for a name that cannot be read.
    pub(super) fn misbehaviours(&self) -> Result<Vec<Misbehaviour>, Rejection> {
        let mut proofs = Vec::new();
        for name in self.proof_names()? {
            let path = self.0.join(name.file());
            match Misbehaviour::from_bytes(&read(&path, MISBEHAVIOUR_BYTES_MAX)?) {
                Ok(proof) => proofs.push(proof),
                Err(reason) => {
                    tracing::warn!(path = %path.display(), code = reason.code.name(), %reason, "cannot read a stored \
                                                                                                proof of misbehaviour");
                }
            }
        }
        Ok(proofs)
    }

    fn proof_names(&self) -> Result<Vec<ProofName>, Rejection> {
        let mut proofs = Vec::new();
        for name in self.names()? {
            let Some(proof) = name.to_str().and_then(ProofName::read) else { continue };
            proofs.push(proof.map_err(|()| {
                Rejection::new(Code::BadFile, "the file name of a proof of misbehaviour cannot be read")
                    .found(self.0.join(&name).display().to_string())
                    .wanted("HEIGHT-NODE.lie, HEIGHT-NODE.fault, TERM-NODE.votes or TERM-NODE.heads")
                    .next("move the file away")
            })?);
        }
        proofs.sort();
        Ok(proofs)
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
#[expect(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]
mod tests {
    use super::*;
    use ledger_base::hash::Hash;
    use ledger_light::{Branch, Certificate, DoubleHead, DoubleVote, Signature, Signed};

    fn statement(height: u64) -> Statement {
        Statement { network: Hash::ZERO, recoveries: 0, height, time: 1, block: Hash::ZERO, results: Hash::ZERO }
    }

    fn signature(node: u64) -> Signature {
        Signature { node, certificate: Default::default(), signature: Default::default() }
    }

    fn pair(node: u64, first: Statement, second: Statement) -> Misbehaviour {
        let signed = |statement| Signed { statement, signature: signature(node) };
        Misbehaviour::of(signed(first), signed(second)).unwrap()
    }

    fn lie(node: u64, height: u64) -> Misbehaviour {
        pair(node, statement(height), Statement { block: Hash([1; 32]), ..statement(height) })
    }

    fn fault(node: u64, height: u64) -> Misbehaviour {
        pair(node, statement(height), Statement { results: Hash([1; 32]), ..statement(height) })
    }

    fn votes(node: u64, term: u64) -> Misbehaviour {
        let votes = [(1, signature(node)), (2, signature(node))];
        Misbehaviour::DoubleVote(DoubleVote { network: Hash::ZERO, recoveries: 0, term, time: 1, votes })
    }

    fn heads(node: u64, term: u64) -> Misbehaviour {
        let branch = |base| Branch { base: Hash([base; 32]), links: Vec::new(), signature: signature(node) };
        let branches = [branch(1), branch(2)];
        Misbehaviour::DoubleHead(DoubleHead {
            network: Hash::ZERO,
            recoveries: 0,
            leader: node,
            term,
            height: 1,
            time: 1,
            branches,
        })
    }

    #[test]
    fn proofs_are_found_again_and_of_a_node_one_of_each_kind_is_kept() {
        let place = tempfile::tempdir().unwrap();
        let kept = Kept::open(place.path()).unwrap();
        assert_eq!((kept.newest().unwrap(), kept.misbehaviours().unwrap()), (None, Vec::new()));
        for (height, newest, governs) in [(5, true, true), (4, false, true), (6, true, false)] {
            let certificate = Certificate { statement: statement(height), signatures: Vec::new() };
            let proof = Proof { certificate, facts: Vec::new() };
            [newest, governs]
                .iter()
                .zip([Kept::write_newest, Kept::write_governing])
                .filter(|(wanted, _)| **wanted)
                .for_each(|(_, write)| write(&kept, &proof).unwrap());
        }
        let keep = |proof: &Misbehaviour| kept.misbehaviour(proof).unwrap();
        (1..=10).for_each(|height| keep(&lie(3, height)));
        [lie(2, 7), fault(3, 9), fault(3, 10), votes(2, 9), votes(2, 11), heads(2, 8), heads(2, 9)]
            .iter()
            .for_each(keep);
        let again = Kept::open(place.path()).unwrap();
        let height = |proof: Option<Proof>| proof.map(|proof| proof.certificate.statement.height);
        assert_eq!(height(again.newest().unwrap()), Some(6));
        assert_eq!(again.misbehaviours().unwrap(), [lie(3, 1), lie(2, 7), heads(2, 8), votes(2, 9), fault(3, 9)]);
        for (at, wanted) in [(4, Some(4)), (5, Some(5)), (6, None)] {
            assert_eq!(height(again.governing(at).unwrap()), wanted);
        }
        // A damaged one is as good as none.
        std::fs::write(place.path().join(CERTIFICATES_DIRECTORY).join(NEWEST_PROOF_FILE), b"ledgerd proof v1\0")
            .unwrap();
        assert_eq!(kept.newest().unwrap(), None);
        std::fs::write(
            place.path().join(CERTIFICATES_DIRECTORY).join("00000000000000000007-2.lie"),
            b"ledgerd lie v1\0",
        )
        .unwrap();
        assert_eq!(kept.misbehaviours().unwrap(), [lie(3, 1), heads(2, 8), votes(2, 9), fault(3, 9)]);
    }

    #[test]
    fn the_newest_statements_are_found_again_and_a_torn_one_is_left_out() {
        let place = tempfile::tempdir().unwrap();
        let kept = Kept::open(place.path()).unwrap();
        assert_eq!(kept.recorded().unwrap(), []);
        for height in 1..=SIGNED_MAX + 10 {
            kept.record(&statement(height)).unwrap();
        }
        let mut recorded = Kept::open(place.path()).unwrap().recorded().unwrap();
        recorded.sort_by_key(|statement| statement.height);
        let heights: Vec<u64> = recorded.iter().map(|statement| statement.height).collect();
        assert_eq!(heights, (11..=SIGNED_MAX + 10).collect::<Vec<_>>());
        assert_eq!(recorded[3], statement(14));
        let file = kept.0.join(SIGNED);
        let mut bytes = std::fs::read(&file).unwrap();
        bytes[STATEMENT_BYTES] ^= 1;
        bytes.truncate(bytes.len() - 1);
        std::fs::write(&file, bytes).unwrap();
        assert_eq!(kept.recorded().unwrap().len() as u64, SIGNED_MAX - 2);
    }

    #[test]
    fn all_but_the_proofs_of_misbehaviour_is_set_aside() {
        let (place, aside) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let kept = Kept::open(place.path()).unwrap();
        let certificate = Certificate { statement: statement(5), signatures: Vec::new() };
        let proof = Proof { certificate, facts: Vec::new() };
        kept.write_newest(&proof).and_then(|()| kept.write_governing(&proof)).unwrap();
        std::fs::write(kept.0.join("00000000000000000005.passed"), b"").unwrap();
        let proofs = [lie(2, 3), votes(2, 4), fault(2, 5)];
        proofs.iter().for_each(|proof| kept.misbehaviour(proof).unwrap());
        set_proofs_aside(place.path(), aside.path()).unwrap();
        assert_eq!((kept.names().unwrap().len(), kept.misbehaviours().unwrap()), (3, proofs.to_vec()));
        let moved = Kept::open(aside.path()).unwrap();
        assert_eq!((moved.names().unwrap().len(), moved.misbehaviours().unwrap()), (3, Vec::new()));
        assert!(moved.newest().unwrap().is_some() && kept.newest().unwrap().is_none());
    }
}
