//! Names of files in the data directory, and the marks that keep a node from starting.

use crate::process::config::Config;
use ledger::branch::{BRANCH_BYTES_MAX, CertifiedBranch};
use ledger_base::durable::read;
use ledger_base::rejection::{Code, Rejection};
use ledger_base::shell;
use serde::Deserialize;
use std::fs;
use std::path::Path;

/// The node's certificate, with those above it.
pub(crate) const CERTIFICATE_FILE: &str = "node.pem";
/// Its private key.
pub(crate) const KEY_FILE: &str = "node.key";
/// Facts of a node that has joined, before its ledger has it.
pub(crate) const JOINED_FILE: &str = "node.json";
/// The mark of a world state that contradicts the others'.
pub(crate) const DIVERGED_FILE: &str = "diverged";
/// Heights that voters have confirmed, across restarts: JSON, the number of each voter with a height and its receipt.
pub(crate) const CONFIRMED_FILE: &str = "confirmed.json";
/// The mark of a chain that a strict certificate contradicts: the certificate, as [`ledger::branch::CertifiedBranch`] encodes it.
pub(crate) const CONTRADICTED_FILE: &str = "contradicted";
/// The mark of a data directory that is a copy: the manifest of the backup.
pub(crate) const RESTORED_FILE: &str = "restored.json";
/// The mark of a rejoin that has begun and not ended.
pub(crate) const REJOINING_FILE: &str = "rejoining";
/// The directory of certificates and proofs of misbehaviour, in the data directory.
pub(crate) const CERTIFICATES_DIRECTORY: &str = "certificates";
/// The proof of the newest certified block, in that directory.
pub(crate) const NEWEST_PROOF_FILE: &str = "newest.proof";
/// Largest manifest of a backup, in bytes.
const MANIFEST_BYTES_MAX: usize = 1024 * 1024;

/// The part of a backup's manifest that names what was copied.
#[derive(Deserialize)]
struct Copied {
    /// `ORGANISATION/NAME`.
    node: String,
    /// Height of the newest block.
    height: u64,
}

/// Refuses a data directory that is a copy, or that waits for the end of a rejoin.
///
/// # Errors
/// [`Code::BadFile`] with the ways on.
pub(crate) fn refuse_restored(config: &Config) -> Result<(), Rejection> {
    refuse_rejoining(config)?;
    let mark = config.data.join(RESTORED_FILE);
    if fs::symlink_metadata(&mark).is_err() {
        return Ok(());
    }
    let found = read(&mark, MANIFEST_BYTES_MAX).ok().and_then(|bytes| serde_json::from_slice::<Copied>(&bytes).ok());
    let found = found.map_or_else(
        || "a restored copy".to_owned(),
        |copy| format!("a copy of node {} with the blocks up to {}", copy.node, copy.height),
    );
    let file = shell::path(&config.file);
    Err(Rejection::new(Code::BadFile, format!("{} is restored from a backup", config.data.display()))
        .found(found)
        .wanted("a node that remembers its votes and all blocks that it has confirmed")
        .next(format!(
            "ledgerd rejoin --config {file}, if another node of the network runs; if all are lost: \
             ledgerd recover --force-single --config {file}"
        )))
}

/// The way back of a contradicted node.
pub(crate) const CONTRADICTED_NEXT: &str = "ledgerd rejoin --config FILE; it verifies the certified branch, keeps \
                                            this one for auditors, and brings the node back";

/// Refuses a data directory whose chain a strict certificate contradicts.
///
/// # Errors
/// [`Code::Contradicted`] with the command that brings the node back.
pub(crate) fn refuse_contradicted(config: &Config) -> Result<(), Rejection> {
    match contradicted_by(&config.data)? {
        None => Ok(()),
        Some(branch) => Err(Rejection::new(
            Code::Contradicted,
            "this node has stopped because enough voters certified another block than it has executed",
        )
        .found(format!("the certificate of block {}", branch.certificate().statement.height))
        .wanted(format!("block {} at height {}", branch.block(), branch.height()))
        .next(CONTRADICTED_NEXT)),
    }
}

/// The certified part of another branch that contradicts the chain in this data directory; none if nothing does.
///
/// # Errors
/// A file that cannot be read.
pub(crate) fn contradicted_by(data: &Path) -> Result<Option<CertifiedBranch>, Rejection> {
    let mark = data.join(CONTRADICTED_FILE);
    if fs::symlink_metadata(&mark).is_err() {
        return Ok(None);
    }
    CertifiedBranch::from_bytes(&read(&mark, BRANCH_BYTES_MAX)?)
        .map(Some)
        .map_err(|refused| refused.prefix(format_args!("{}: ", mark.display())))
}

/// Refuses a data directory in which a rejoin was interrupted.
///
/// # Errors
/// [`Code::BadFile`] with the way on.
pub(crate) fn refuse_rejoining(config: &Config) -> Result<(), Rejection> {
    if fs::symlink_metadata(config.data.join(REJOINING_FILE)).is_err() {
        return Ok(());
    }
    Err(Rejection::new(Code::BadFile, format!("ledgerd rejoin was interrupted in {}", config.data.display()))
        .found("a node without its old number and blocks, and perhaps without new ones")
        .wanted("a rejoin that is complete")
        .next(format!("run it again, with the same options: ledgerd rejoin --config {}", shell::path(&config.file))))
}
