//! Why a command ended early, how that is told, and with which exit code.

use crate::format::Format;
use crate::printable::printable_lines;
use clap::error::{ContextKind, ContextValue};
use ledger_base::rejection::{Code, Rejection};
use serde::Serialize;
use std::io::{self, Write};
use std::process::ExitCode;

/// Exit code of a command line that cannot be understood (`EX_USAGE` of sysexits).
const EXIT_USAGE: u8 = 64;

/// Why a command ended early.
#[derive(Debug)]
pub(crate) enum Failure {
    /// Something was refused or went wrong; the rejection says what, and its class gives the exit code.
    Refused(Rejection),
    /// The results were told, and are not as they should be: the exit code says so.
    Told(u8),
    /// Nobody reads what we write any more (`ledgerctl robot list | head -1`). That is not an error.
    ReaderGone,
}

impl From<Rejection> for Failure {
    fn from(rejection: Rejection) -> Self {
        Self::Refused(rejection)
    }
}

impl From<io::Error> for Failure {
    /// Only writing to standard output gives bare IO errors; files are read through [`unreadable`].
    fn from(error: io::Error) -> Self {
        match error.kind() {
            io::ErrorKind::BrokenPipe => Self::ReaderGone,
            // Of this machine: the codes of disks are about the node's.
            _ => Self::Refused(
                Rejection::new(Code::BadFile, "cannot write the results to standard output")
                    .found(error.to_string())
                    .wanted("a terminal, a pipe, or a file with free space")
                    .next("write to another place; check first whether the command has taken effect"),
            ),
        }
    }
}

/// The refusal of a file that cannot be read or written.
pub(crate) fn unreadable(path: &std::path::Path, error: &io::Error) -> Rejection {
    Rejection::new(Code::BadFile, format!("cannot read {}", path.display()))
        .found(error.to_string())
        .next("check the path and its permissions")
}

/// The same facts as the four lines, for `-o json`.
#[derive(Serialize)]
struct Report<'a> {
    code: String,
    name: &'a str,
    message: &'a str,
    found: &'a str,
    wanted: &'a str,
    r#try: &'a str,
}

impl Failure {
    /// Tells the failure on standard error and gives the exit code.
    pub(crate) fn report(&self, format: Format) -> ExitCode {
        match self {
            Self::ReaderGone => ExitCode::SUCCESS,
            Self::Told(exit) => ExitCode::from(*exit),
            Self::Refused(rejection) => {
                // Where standard error is closed too, the exit code is all that is left to tell.
                let _ = writeln!(io::stderr(), "{}", render(rejection, format).trim_end());
                ExitCode::from(rejection.code.class().exit_code())
            }
        }
    }
}

fn render(rejection: &Rejection, format: Format) -> String {
    let report = Report {
        code: rejection.code.to_string(),
        name: rejection.code.name(),
        message: &rejection.message,
        found: &rejection.found,
        wanted: &rejection.wanted,
        r#try: rejection.advice(),
    };
    match format {
        Format::Table | Format::Csv => printable_lines(&ledger_api::report(rejection)),
        Format::Json => serde_json::to_string(&report).unwrap_or_else(|_| rejection.to_string()),
    }
}

/// Prints what clap has to say: help and version on standard output with 0, a wrong command line on standard error
/// with 64. To whoever asked for JSON it is told as one object.
pub(crate) fn usage(error: &clap::Error, format: Format) -> ExitCode {
    if !error.use_stderr() {
        let printed = error.print().and_then(|()| io::stdout().flush());
        return printed.map_or_else(|error| Failure::from(error).report(format), |()| ExitCode::SUCCESS);
    }
    if format == Format::Json {
        let told = serde_json::to_string(&misused(error)).unwrap_or_else(|_| error.to_string());
        let _told = writeln!(io::stderr(), "{told}");
    } else {
        let _printed = error.print();
    }
    ExitCode::from(EXIT_USAGE)
}

/// A wrong command line, with the fields of every other error.
#[derive(Serialize)]
struct Misuse {
    code: &'static str,
    name: &'static str,
    message: String,
    found: String,
    wanted: String,
    r#try: String,
}

fn misused(error: &clap::Error) -> Misuse {
    let told = |kinds: &[ContextKind]| {
        kinds
            .iter()
            .filter_map(|kind| error.get(*kind))
            .map(context_text)
            .find(|text| !text.is_empty())
            .unwrap_or_default()
    };
    let text = error.to_string();
    let message =
        text.lines().next().unwrap_or_default().trim_start_matches("error: ").trim_end_matches(':').to_owned();
    let usage = told(&[ContextKind::Usage]);
    let usage = usage.trim_start_matches("Usage: ").trim();
    let near = told(&[ContextKind::SuggestedSubcommand, ContextKind::SuggestedArg, ContextKind::SuggestedValue]);
    let tip = told(&[ContextKind::Suggested]);
    Misuse {
        code: "LGR-USAGE",
        name: "USAGE",
        message,
        found: told(&[ContextKind::InvalidValue, ContextKind::InvalidSubcommand, ContextKind::InvalidArg]),
        wanted: match told(&[ContextKind::ValidValue, ContextKind::ValidSubcommand]) {
            none if none.is_empty() => usage.to_owned(),
            values => format!("one of {values}"),
        },
        r#try: match (near.as_str(), tip.as_str()) {
            ("", "") => "the same command with --help".to_owned(),
            ("", tip) => tip.to_owned(),
            (near, _) => format!("did you mean {near}?"),
        },
    }
}

fn context_text(value: &ContextValue) -> String {
    match value {
        ContextValue::String(text) => text.clone(),
        ContextValue::Strings(texts) => texts.join(", "),
        ContextValue::StyledStr(text) => text.to_string(),
        ContextValue::StyledStrs(texts) => texts.iter().map(ToString::to_string).collect::<Vec<_>>().join(", "),
        _ => String::new(),
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn a_reader_that_went_away_is_no_error() {
        assert!(matches!(Failure::from(io::Error::from(io::ErrorKind::BrokenPipe)), Failure::ReaderGone));
    }

    #[test]
    fn json_errors_carry_the_same_six_facts_on_one_line() {
        let rejection = Rejection::new(Code::Held, "Turtlebot4/cmd_vel is held").found("a").wanted("b").next("c");
        let text = render(&rejection, Format::Json);
        assert!(!text.contains('\n'));
        let read: serde_json::Value = serde_json::from_str(&text).unwrap();
        assert_eq!(read["code"], "LGR-3005");
        assert_eq!(read["name"], "HELD");
        assert_eq!(read["message"], "Turtlebot4/cmd_vel is held");
        assert_eq!((&read["found"], &read["wanted"], &read["try"]), (&"a".into(), &"b".into(), &"c".into()));
    }

    #[test]
    fn text_errors_name_code_found_wanted_and_try() {
        let rejection = Rejection::new(Code::Held, "m").found("f").wanted("w").next("n");
        let text = render(&rejection, Format::Table);
        for part in ["error: m", "[LGR-3005]", "found   f", "wanted  w", "try     n"] {
            assert!(text.contains(part), "{part:?} in {text}");
        }
    }

    #[test]
    fn text_errors_cannot_move_the_cursor() {
        let rejection = Rejection::new(Code::Refused, "no \u{1b}[2J");
        assert!(!render(&rejection, Format::Table).contains('\u{1b}'));
    }
}
