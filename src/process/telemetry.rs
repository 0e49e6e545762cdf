//! Logs, on standard error so that standard output stays what was asked for.

use crate::process::config::{Log, LogFormat};
use std::ffi::OsStr;
use std::io::IsTerminal;
use std::sync::OnceLock;
use tracing_subscriber::EnvFilter;
use tracing_subscriber::filter::LevelFilter;

/// Set to anything, it switches colours off: <https://no-color.org>.
const NO_COLOR: &str = "NO_COLOR";
/// `text` or `json`: the form where the configuration leaves it to the circumstances.
pub(crate) const LOG_FORMAT: &str = "LEDGERD_LOG_FORMAT";

/// Changes what is logged from now on.
type Change = Box<dyn Fn(EnvFilter) + Send + Sync>;

static CHANGE: OnceLock<Change> = OnceLock::new();

/// Starts logging. `RUST_LOG` overrides the configured level.
pub(crate) fn start(log: &Log) {
    let builder = tracing_subscriber::fmt().with_env_filter(wanted(log)).with_writer(std::io::stderr);
    // A second start, in a test of this process, keeps the first one's settings.
    let (terminal, form) = (std::io::stderr().is_terminal(), std::env::var(LOG_FORMAT).ok());
    let started = match log.format.settled(form.as_deref(), terminal) {
        LogFormat::Text | LogFormat::Auto => {
            let coloured = coloured(terminal, std::env::var_os(NO_COLOR).as_deref());
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

impl LogFormat {
    /// Text or JSON: as the configuration says, else as the environment says, else text for a terminal.
    fn settled(self, wanted: Option<&str>, terminal: bool) -> Self {
        let by_place = if terminal { Self::Text } else { Self::Json };
        match (self, wanted.and_then(Self::named)) {
            (Self::Auto, None | Some(Self::Auto)) => by_place,
            (Self::Auto, Some(wanted)) => wanted,
            (configured, _) => configured,
        }
    }
}

/// Colours are for terminals, and not for people who want none.
fn coloured(terminal: bool, no_color: Option<&OsStr>) -> bool {
    terminal && no_color.is_none_or(OsStr::is_empty)
}

/// The level for our own crates; libraries log from `warn` on.
fn filter(level: LevelFilter) -> String {
    format!(
        "warn,rtps={level},ledgerd={level},ledger={level},ledger_raft={level},ledger_abac={level},ledger_api={level},ros_bridge={level}"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_log_is_text_on_a_terminal_and_json_elsewhere_unless_somebody_says_otherwise() {
        let auto = |wanted, terminal| LogFormat::Auto.settled(wanted, terminal);
        assert_eq!((auto(None, true), auto(None, false)), (LogFormat::Text, LogFormat::Json));
        assert_eq!((auto(Some("text"), false), auto(Some("json"), true)), (LogFormat::Text, LogFormat::Json));
        assert_eq!((auto(Some("auto"), true), auto(Some("what"), false)), (LogFormat::Text, LogFormat::Json));
        for configured in [LogFormat::Text, LogFormat::Json] {
            assert_eq!(configured.settled(Some("json"), true), configured);
            assert_eq!(configured.settled(Some("text"), false), configured);
        }
    }

    #[test]
    fn whoever_sets_no_color_gets_none() {
        assert!(coloured(true, None) && coloured(true, Some(OsStr::new(""))));
        assert!(!coloured(true, Some(OsStr::new("1"))) && !coloured(true, Some(OsStr::new("0"))));
        assert!(!coloured(false, None));
    }
}
