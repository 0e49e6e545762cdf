//! `ledgerd checkpoint`: where gates and light clients begin anew after a recovery by force.
//!
//! They believe no change of voters that the voters before have not signed, and a forced one is such a change. So whoever
//! answers for them takes a checkpoint from a node that they trust, and carries it there by hand. It is as
//! `ledgerctl light --checkpoint` makes it, without following anything: this node is believed.

use crate::node::NodeBuilder;
use crate::peers::quorum_certificates::newest_proof;
use crate::process::config::Config;
use crate::storage::stores::Stores;
use crate::trust::membership::nothing_here;
use ledger_base::durable::PUBLIC_MODE;
use ledger_base::rejection::{Code, Rejection};
use ledger_base::shell;
use ledger_light::Checkpoint;
use ledger_storage::layout::GENESIS_FILE;
use std::fs;
use std::path::PathBuf;

/// The arguments of `ledgerd checkpoint`.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerd checkpoint fleet.checkpoint --config ledgerd.toml")]
pub(crate) struct CheckpointOptions {
    /// The file of the checkpoint.
    file: PathBuf,
    /// The node's configuration.
    #[arg(long, value_name = "FILE", default_value = "ledgerd.toml")]
    pub(crate) config: PathBuf,
}

/// Makes a checkpoint of a stopped node; answers with what to tell the operator.
///
/// # Errors
/// [`Code::BadFile`] if the node runs or its directory cannot be used, or the file exists; [`Code::NotFound`] if no certified
/// block is newer than the last change of who governs.
pub(crate) fn checkpoint(
    builder: &NodeBuilder,
    options: &CheckpointOptions,
    config: &Config,
) -> Result<String, Rejection> {
    let genesis = fs::read(config.data.join(GENESIS_FILE)).map_err(|error| nothing_here(config, &error))?;
    let stores = Stores::open(config, &genesis, builder.registry()?)?;
    let ledger = &stores.ledger;
    let (tip, proof) = (ledger.tip().height, newest_proof(&config.data)?);
    let height = proof.as_ref().map_or(0, |proof| proof.certificate.statement.height);
    let Some(proof) = proof.filter(|_| height <= tip && ledger.changes(height, 1).is_ok_and(|since| since.is_empty()))
    else {
        return Err(Rejection::new(Code::NotFound, "there is no certified block for a checkpoint")
            .found(format!(
                "block {height} as the newest certified one, and a later change of voters, organisations \
                            or revocations"
            ))
            .wanted("a certified block after the last change of voters, organisations or revocations")
            .next(format!("ledgerd run --config {} for some seconds, then try again", shell::path(&config.file))));
    };
    let checkpoint = Checkpoint::of(&ledger.network(), ledger.governing(height)?, proof)?;
    ledger_base::durable::create(&options.file, &checkpoint.to_bytes(), PUBLIC_MODE)?;
    Ok(format!(
        "checkpoint   {}, block {height} of network {}\nReaders that start with it trust this node for the voters and \
         organisations. Transfer it over a trusted channel:\n  a bridge      checkpoint = \"{}\" in its \
         configuration\n  ledgerctl     ledgerctl light ROBOT --checkpoint {0}",
        options.file.display(),
        ledger.network(),
        options.file.display(),
    ))
}
