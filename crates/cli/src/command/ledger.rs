//! `status`, `block`, `tx`: the node and its chain. `ledger`: its files.

mod archive;
mod block;
mod status;
mod tx;

pub(crate) use archive::Archive;
pub(crate) use block::Block;
pub(crate) use status::Status;
pub(crate) use tx::Tx;

use crate::failure::Failure;
use crate::output::Output;

/// Archive the files of a node's ledger.
#[derive(Debug, clap::Subcommand)]
pub(crate) enum Ledger {
    Archive(Archive),
}

impl Ledger {
    pub(crate) fn run(self, output: &mut Output) -> Result<(), Failure> {
        match self {
            Self::Archive(command) => command.run(output),
        }
    }
}
