//! Logs, on standard error so that standard output stays what was asked for.

use crate::config::{Log, LogFormat};
use std::ffi::OsStr;
use std::io::IsTerminal;
use std::sync::OnceLock;
use tracing_subscriber::EnvFilter;
use tracing_subscriber::filter::LevelFilter;

/// Set to anything, it switches colours off: <https://no-color.org>.
const NO_COLOR: &str = "NO_COLOR";

/// Changes what is logged from now on.
type Change = Box<dyn Fn(EnvFilter) + Send + Sync>;

static CHANGE: OnceLock<Change> = OnceLock::new();

/// Starts logging. `RUST_LOG` overrides the configured level.
pub(crate) fn start(log: &Log) {
    let builder = tracing_subscriber::fmt().with_env_filter(wanted(log)).with_writer(std::io::stderr);
    // A second start, in a test of this process, keeps the first one's settings.
    let started = match log.format {
        LogFormat::Text => {
            let coloured = coloured(std::io::stderr().is_terminal(), std::env::var_os(NO_COLOR).as_deref());
            let builder = builder.with_ansi(coloured).with_target(false).with_filter_reloading();
            let handle = builder.reload_handle();
            builder.try_init().is_ok().then(|| Box::new(move |filter| drop(handle.reload(filter))) as Change)
        }
        LogFormat::Json => {
            let builder = builder.json().with_filter_reloading();
            let handle = builder.reload_handle();
            builder.try_init().is_ok().then(|| Box::new(move |filter| drop(handle.reload(filter))) as Change)
        }
    };
    if let Some(change) = started {
        CHANGE.get_or_init(|| change);
    }
}

/// Takes over the level of a configuration that was read again.
pub(crate) fn set_level(log: &Log) {
    if let Some(change) = CHANGE.get() {
        change(wanted(log));
    }
}

fn wanted(log: &Log) -> EnvFilter {
    EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new(filter(log.level)))
}

/// Colours are for terminals, and not for people who want none.
fn coloured(terminal: bool, no_color: Option<&OsStr>) -> bool {
    terminal && no_color.is_none_or(OsStr::is_empty)
}

/// The level for our own crates; libraries speak from `warn` on, and RustDDS, which is talkative, from `error`.
fn filter(level: LevelFilter) -> String {
    format!(
        "warn,rustdds=error,ledgerd={level},ledger={level},ledger_raft={level},ledger_abac={level},ledger_api={level},ros_bridge={level}"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whoever_sets_no_color_gets_none() {
        assert!(coloured(true, None) && coloured(true, Some(OsStr::new(""))));
        assert!(!coloured(true, Some(OsStr::new("1"))) && !coloured(true, Some(OsStr::new("0"))));
        assert!(!coloured(false, None));
    }
}
