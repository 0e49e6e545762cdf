//! The files: the newest certificate, those of blocks that changed whom others trust, and the proofs of lies.

use ledger_durable::{PUBLIC_MODE, create_directory, failed, read, replace};
use ledger_light::certificate::CERTIFICATE_BYTES_MAX;
use ledger_light::{Certificate, Lie};
use ledger_rejection::{Code, Rejection};
use std::path::{Path, PathBuf};

/// The directory in the data directory.
const DIRECTORY: &str = "certificates";
/// The newest certificate.
const NEWEST: &str = "newest.cert";
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

    /// The newest certificate that was kept. One that cannot be read is as good as none: there will be a newer one.
    pub(super) fn newest(&self) -> Result<Option<Certificate>, Rejection> {
        let path = self.0.join(NEWEST);
        if !path.exists() {
            return Ok(None);
        }
        let found = read(&path, CERTIFICATE_BYTES_MAX)?;
        Ok(Certificate::from_bytes(&found)
            .inspect_err(|reason| tracing::warn!(path = %path.display(), %reason, "a kept certificate is of no use"))
            .ok())
    }

    /// Keeps a certificate: as the newest, and for good if its block changed whom others trust.
    pub(super) fn certificate(&self, certificate: &Certificate, newest: bool, governs: bool) -> Result<(), Rejection> {
        let bytes = certificate.to_bytes();
        if governs {
            let name = format!("{:020}.cert", certificate.statement.height);
            replace(&self.0.join(name), &bytes, PUBLIC_MODE)?;
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

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use ledger_hash::Hash;
    use ledger_light::{Signature, Signed, Statement};

    fn statement(height: u64) -> Statement {
        Statement { network: Hash::ZERO, height, time: 1, block: Hash::ZERO, results: Hash::ZERO }
    }

    fn lie(node: u64, height: u64) -> Lie {
        let signature = Signature { node, certificate: Default::default(), signature: Default::default() };
        let signed = Signed { statement: statement(height), signature };
        Lie { first: signed.clone(), second: signed }
    }

    #[test]
    fn certificates_and_lies_are_found_again_and_lies_of_a_node_are_bounded() {
        let place = tempfile::tempdir().unwrap();
        let kept = Kept::open(place.path()).unwrap();
        assert_eq!((kept.newest().unwrap(), kept.lies().unwrap()), (None, Vec::new()));
        for (height, newest, governs) in [(5, true, true), (4, false, true), (6, true, false)] {
            let certificate = Certificate { statement: statement(height), signatures: Vec::new() };
            kept.certificate(&certificate, newest, governs).unwrap();
        }
        for height in 1..=10 {
            kept.lie(&lie(3, height)).unwrap();
        }
        kept.lie(&lie(2, 7)).unwrap();
        let again = Kept::open(place.path()).unwrap();
        assert_eq!(again.newest().unwrap().unwrap().statement.height, 6);
        assert_eq!(again.lies().unwrap(), [(3, 1), (3, 2), (3, 3), (3, 4), (2, 7)]);
        let directory = place.path().join(DIRECTORY);
        for height in [4, 5] {
            let found = std::fs::read(directory.join(format!("{height:020}.cert"))).unwrap();
            assert_eq!(Certificate::from_bytes(&found).unwrap().statement.height, height);
        }
        assert!(!directory.join("00000000000000000006.cert").exists());
        // A damaged one is as good as none.
        std::fs::write(directory.join(NEWEST), b"ledgerd certificate v1\0").unwrap();
        assert_eq!(kept.newest().unwrap(), None);
    }
}
