//! `ledger archive`: write blocks out.

use crate::failure::Failure;
use crate::output::{Facts, Format, Output, Table};
use ledger::network::Genesis;
use ledger_base::progress::{Progress, Step};
use ledger_storage::archive::{Extent, Reached, Report, archive};
use serde::Serialize;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// Copy the committed blocks of a node to an archive, which `ledgerd verify` checks without the node.
///
/// The node may be running. A block is copied within seconds of its commit. Run the command again to add newer blocks:
/// use a timer, and set `retention` of the node longer than its period. The newest file of the archive may be
/// incomplete; the next run replaces it.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl ledger archive /var/lib/ledgerd --to /backup/fleet")]
pub(crate) struct Archive {
    /// The node's data directory
    #[arg(value_name = "DATA_DIR")]
    directory: PathBuf,
    /// Directory of the archive; created if it does not exist
    #[arg(long, value_name = "DIR")]
    to: PathBuf,
}

#[derive(Serialize)]
struct Archived<'a> {
    archive: &'a Path,
    #[serde(flatten)]
    report: Report,
}

impl Facts for Archived<'_> {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let Report { network, first_height, last_height, blocks, segments_copied, bytes_copied, snapshot } =
            &self.report;
        if last_height < first_height {
            writeln!(out, "{} is empty: the node has no committed block on its disk yet", self.archive.display())?;
        } else {
            writeln!(out, "{} holds blocks {first_height} to {last_height}", self.archive.display())?;
        }
        let mut table = Table::pairs();
        table.pair("network", network);
        table.pair("blocks", blocks);
        table.pair("copied now", format!("{segments_copied} segments, {bytes_copied} bytes"));
        if let Some(height) = snapshot {
            table.pair("begins after", format!("the snapshot at height {height}"));
        }
        table.write(out, 2)
    }
}

impl Archive {
    pub(crate) fn run(self, output: &mut Output) -> Result<(), Failure> {
        let mut progress = Progress::new(output.format() == Format::Table);
        let mut tell = |Reached { segments, of_segments, bytes }| {
            progress.tell(Step { count: bytes, at: segments, of: Some(of_segments) }, |rate| {
                format!("segment {segments} of {of_segments}, {:.0} MB a second", rate / 1e6)
            });
        };
        let report = archive((&self.directory, &self.to), Extent::Committed, &Genesis::network_of, &mut tell);
        progress.clear();
        let report = report?;
        output.show(&Archived { archive: &self.to, report })
    }
}
