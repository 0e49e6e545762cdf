//! Logs, on standard error so that standard output stays what was asked for.

use crate::config::{Log, LogFormat};
use std::io::IsTerminal;
use tracing_subscriber::EnvFilter;
use tracing_subscriber::filter::LevelFilter;

/// Starts logging. `RUST_LOG` overrides the configured level.
pub(crate) fn start(log: &Log) {
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new(filter(log.level)));
    let builder = tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr);
    let started = match log.format {
        LogFormat::Text => builder.with_ansi(std::io::stderr().is_terminal()).with_target(false).try_init(),
        LogFormat::Json => builder.json().try_init(),
    };
    // A second start, in a test of this process, keeps the first one's settings.
    drop(started);
}

/// The level for our own crates; libraries speak from `warn` on, and RustDDS, which is talkative, from `error`.
fn filter(level: LevelFilter) -> String {
    format!(
        "warn,rustdds=error,ledgerd={level},ledger={level},ledger_raft={level},ledger_abac={level},ledger_api={level},ros_bridge={level}"
    )
}
