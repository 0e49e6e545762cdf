//! `man`: the manual pages, for packages.

use crate::failure::{Failure, unreadable};
use clap::Command;
use std::path::PathBuf;

/// Write the manual pages of all commands into a directory.
#[derive(Debug, clap::Args)]
#[command(hide = true, after_help = "Example:\n  ledgerctl man man1")]
pub(crate) struct Man {
    /// An existing directory
    directory: PathBuf,
}

impl Man {
    pub(crate) fn run(&self, commands: Command) -> Result<(), Failure> {
        clap_mangen::generate_to(commands, &self.directory).map_err(|error| unreadable(&self.directory, &error).into())
    }
}
