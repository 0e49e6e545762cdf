//! `verify`: check a node's chain offline.

use crate::failure::Failure;
use crate::output::{Facts, Output, Table};
use ledger::verify::{Dissent, Report, verify_directory};
use ledger::{Code, Registry, Rejection};
use ledger_abac::AccessControl;
use serde::Serialize;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Check the chain in the data directory of a stopped node, or in an archive: every hash, every signature, every verdict
/// executed again.
///
/// Nothing that the node has computed is trusted. What nodes have attested is compared. Exits with 1 and names the first
/// byte that is wrong. If the oldest blocks are gone, execution begins with the snapshot before the others. A node that was
/// built with chaincode of your own is verified by a program built with the same chaincode (ledger::verify).
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl verify /var/lib/ledgerd")]
pub(crate) struct Verify {
    /// The node's data directory, a copy of it, or an archive
    #[arg(value_name = "DIR")]
    directory: PathBuf,
}

#[derive(Serialize)]
struct Verified<'a> {
    ok: bool,
    directory: &'a Path,
    #[serde(flatten)]
    report: Report,
}

impl Facts for Verified<'_> {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let Report { network, height, block_hash, state_digest, transactions, verdicts, .. } = &self.report;
        writeln!(out, "{} is right, up to block {height}", self.directory.display())?;
        let verdicts: Vec<_> = verdicts.iter().map(|(name, count)| format!("{name} {count}")).collect();
        let mut table = Table::pairs();
        table.pair("network", network);
        if let Some(begun) = &self.report.begun {
            let by: Vec<_> = begun.attested_by.iter().map(String::as_str).collect();
            let by = if by.is_empty() { "nobody, in these blocks".into() } else { by.join(", ") };
            table.pair("begins after", format!("the snapshot at height {}, {}", begun.height, begun.content));
            table.pair("attested by", by);
        }
        table.pair("block hash", block_hash);
        table.pair("state digest", state_digest);
        table.pair("transactions", transactions);
        table.pair("verdicts", verdicts.join(", "));
        table.pair("results compared", self.report.results_compared);
        table.pair("state compared", if self.report.state_compared { "yes" } else { "no" });
        table.pair("attestations", format!("{} agree", self.report.attestations_agreeing));
        for dissent in &self.report.dissents {
            let Dissent { height, node, digest, .. } = dissent;
            table.pair("differs", format!("{node} attested state digest {digest} at height {height}"));
        }
        if self.report.uncommitted > 0 {
            table
                .pair("uncommitted", format!("{} entries that are not known to be committed", self.report.uncommitted));
        }
        if self.report.torn_bytes > 0 {
            table.pair("torn", format!("{} bytes of a write that was never acknowledged", self.report.torn_bytes));
        }
        table.write(out, 2)
    }
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
        let mut registry = Registry::new();
        registry.install(Arc::new(AccessControl::new()?))?;
        let report = verify_directory(&self.directory, &registry)?;
        output.show(&Verified { ok: true, directory: &self.directory, report })
    }
}
