//! `status`, `block`, `tx`: the node and its chain. `ledger`: its files.

mod archive;
mod block;
mod event;
mod status;
mod tx;

pub(crate) use archive::Archive;
pub(crate) use block::Block;
pub(crate) use status::Status;
pub(crate) use tx::Tx;

use crate::failure::Failure;
use crate::output::Output;

/// Handle the files of a node's ledger.
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

/// The printed form of a code that may be unknown to this version.
fn code_text(number: u32) -> String {
    if number == 0 { "OK".to_owned() } else { format!("LGR-{number:04}") }
}
