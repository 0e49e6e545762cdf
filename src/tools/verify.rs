//! `ledgerd verify`: checks a chain offline, with the chaincodes of this program.

use crate::node::NodeBuilder;
use crate::process::terminal::print_line;
use ledger::verify::{Dissent, Reached, Report, verify_directory};
use ledger_base::durable::read;
use ledger_base::progress::{Progress, Step};
use ledger_base::rejection::{Code, Rejection};
use ledger_light::checkpoint::CHECKPOINT_BYTES_MAX;
use serde::Serialize;
use std::fmt::Write;
use std::path::{Path, PathBuf};

/// `ledgerd verify`
#[derive(clap::Args)]
#[command(after_help = "Example:\n  ledgerd verify /var/lib/ledgerd --against fleet.checkpoint")]
pub(crate) struct Options {
    /// The node's data directory, a copy of it, or an archive.
    #[arg(value_name = "DIR")]
    directory: PathBuf,
    /// A checkpoint written by `ledgerctl light --checkpoint`: the chain must match the block that voters have signed
    /// there.
    #[arg(long, value_name = "CHECKPOINT")]
    against: Option<PathBuf>,
    /// Print the report as one line of JSON.
    #[arg(long)]
    json: bool,
}

/// The output of `ledgerd verify --json`.
#[derive(Serialize)]
struct Verified<'a> {
    ok: bool,
    directory: &'a Path,
    #[serde(flatten)]
    report: Report,
}

/// Verifies and prints the report.
///
/// # Errors
/// [`Code::BadFile`] if the directory is none of a node or in use; [`Code::ChainInvalid`] and others with the first byte
/// that is wrong.
pub(crate) fn run(builder: &NodeBuilder, options: &Options) -> Result<(), Rejection> {
    let directory = &options.directory;
    if !directory.is_dir() {
        return Err(Rejection::new(Code::BadFile, format!("cannot verify {}", directory.display()))
            .found("no directory of this name")
            .wanted("the data directory of a node, or an archive")
            .next("look for `data` in the node's ledgerd.toml"));
    }
    let checkpoint = options.against.as_ref().map(|path| read(path, CHECKPOINT_BYTES_MAX)).transpose()?;
    let report = verified(builder, directory, checkpoint.as_deref(), !options.json)?;
    let verified = Verified { ok: true, directory, report };
    if options.json {
        let line =
            serde_json::to_string(&verified).map_err(|error| Rejection::new(Code::Internal, error.to_string()))?;
        print_line(&line)
    } else {
        print_line(&text(&verified))
    }
}

/// Verifies a directory; tells people how far it is.
///
/// # Errors
/// As [`verify_directory`].
pub(crate) fn verified(
    builder: &NodeBuilder,
    directory: &Path,
    checkpoint: Option<&[u8]>,
    for_people: bool,
) -> Result<Report, Rejection> {
    let mut progress = Progress::new(for_people);
    let mut tell = |Reached { height, transactions, bytes, of_bytes }| {
        let step = Step { count: transactions, at: bytes, of: Some(of_bytes) };
        progress.tell(step, |rate| {
            format!("verifying {}: block {height}, {rate:.0} transactions a second", directory.display())
        });
    };
    let report = verify_directory(directory, &builder.registry()?, checkpoint, &mut tell);
    progress.clear();
    report
}

/// The report for people.
fn text(verified: &Verified<'_>) -> String {
    let Report { network, height, block_hash, state_digest, transactions, verdicts, .. } = &verified.report;
    let report = &verified.report;
    let mut text = format!("{} is valid, up to block {height}", verified.directory.display());
    let mut pair = |name: &str, value: String| {
        let _infallible = write!(text, "\n  {name:<18}{value}");
    };
    pair("network", network.to_string());
    if let Some(begun) = &report.begun {
        let by: Vec<_> = begun.attested_by.iter().map(String::as_str).collect();
        pair("begins after", format!("the snapshot at height {}, {}", begun.height, begun.content));
        pair("attested by", if by.is_empty() { "no nodes, in these blocks".into() } else { by.join(", ") });
    }
    let verdicts: Vec<_> = verdicts.iter().map(|(name, count)| format!("{name} {count}")).collect();
    pair("block hash", block_hash.to_string());
    pair("state digest", state_digest.to_string());
    pair("transactions", transactions.to_string());
    pair("verdicts", if verdicts.is_empty() { "none".into() } else { verdicts.join(", ") });
    pair("results compared", report.results_compared.to_string());
    pair("state compared", if report.state_compared { "yes" } else { "no" }.into());
    if let Some(height) = report.against {
        pair("against", format!("the checkpoint at block {height}: matches what voters signed"));
    }
    pair("attestations", format!("{} agree", report.attestations_agreeing));
    for Dissent { height, node, digest, .. } in &report.dissents {
        pair("differs", format!("{node} attested state digest {digest} at height {height}"));
    }
    if report.uncommitted > 0 {
        pair("uncommitted", format!("{} entries that may be uncommitted", report.uncommitted));
    }
    if report.torn_bytes > 0 {
        pair("torn", format!("{} bytes of a write that was never acknowledged", report.torn_bytes));
    }
    text
}
