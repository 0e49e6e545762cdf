//! Corrections of a wrong command line where the parser's own tips mislead.
//!
//! clap reads `--for -5m` as an option `-5`, `for 10m` as another robot, and the words of an unquoted message as arguments. Its tip
//! for all of these is `'-- …'`, which helps with none of them.

use crate::cli::Cli;
use crate::words::shell_word;
use clap::error::{ContextKind, ContextValue, ErrorKind};
use clap::{Arg, Command, CommandFactory, Parser};
use std::ffi::OsString;

/// Options of the whole program that take a value, and may come before the command.
const GLOBAL: [&str; 3] = ["--context", "--output", "-o"];

/// Parses the arguments of the process.
///
/// # Errors
/// Of clap, with a tip that fits the mistake.
pub(crate) fn parse(arguments: &[OsString]) -> Result<Cli, clap::Error> {
    Cli::try_parse_from(arguments).map_err(|error| corrected(error, arguments))
}

fn corrected(error: clap::Error, arguments: &[OsString]) -> clap::Error {
    let words: Vec<String> = arguments.iter().map(|word| word.to_string_lossy().into_owned()).collect();
    if !error.use_stderr() || words.is_empty() {
        return error;
    }
    if let Some(rejected) = value_with_a_dash(&words) {
        return rejected;
    }
    let mut root = Cli::command();
    root.build();
    let (command, first) = command_of(&root, &words);
    let rest = words.get(first..).unwrap_or_default();
    if let Some((word, tip)) = option_without_dashes(command, &words, first) {
        let mut fresh = clap::Error::new(ErrorKind::UnknownArgument).with_cmd(command);
        fresh.insert(ContextKind::InvalidArg, ContextValue::String(word));
        fresh.insert(ContextKind::Usage, ContextValue::StyledStr(command.clone().render_usage()));
        return tipped(fresh, tip);
    }
    let unknown = match (error.kind(), error.get(ContextKind::InvalidArg)) {
        (ErrorKind::UnknownArgument, Some(ContextValue::String(unknown))) => unknown.clone(),
        _ => return error,
    };
    let tip = type_of_a_service(command, &unknown)
        .or_else(|| unquoted_message(command, rest).filter(|_| !unknown.starts_with("--")))
        .or_else(|| value_without_option(command, rest, &unknown));
    match tip {
        Some(tip) => tipped(error, tip),
        None => without_dashes_tip(error),
    }
}

/// `--for -5m`: the rejection of the value, as after `--for=-5m`.
fn value_with_a_dash(words: &[String]) -> Option<clap::Error> {
    let number = |word: &str| {
        word.strip_prefix('-').is_some_and(|rest| rest.starts_with(|c: char| c.is_ascii_digit() || c == '.'))
    };
    let at = words.windows(2).position(|pair| match pair {
        [option, value] => option.starts_with("--") && option.len() > 2 && !option.contains('=') && number(value),
        _ => false,
    })?;
    let joined = format!("{}={}", words.get(at)?, words.get(at + 1)?);
    let mut again = words.to_vec();
    again.splice(at..at + 2, [joined]);
    Cli::try_parse_from(again).err().filter(|error| error.kind() == ErrorKind::ValueValidation)
}

/// The command that the words name, and the place of the first word behind its name.
fn command_of<'a>(root: &'a Command, words: &[String]) -> (&'a Command, usize) {
    let (mut command, mut at) = (root, 1);
    while let Some(word) = words.get(at) {
        if GLOBAL.contains(&word.as_str()) {
            at += 2;
        } else if word.starts_with('-') {
            at += 1;
        } else if let Some(below) = command.find_subcommand(word) {
            (command, at) = (below, at + 1);
        } else {
            break;
        }
    }
    (command, at)
}

/// `acquire R for 10m`: the name of an option in front of its value. With its dashes the line is right.
fn option_without_dashes(command: &Command, words: &[String], first: usize) -> Option<(String, String)> {
    let named = |word: &str| command.get_arguments().any(|arg| arg.get_long() == Some(word) && takes_value(arg));
    (first..words.len().saturating_sub(1)).find_map(|at| {
        let (word, value) = (words.get(at)?, words.get(at + 1)?);
        let mut again = words.to_vec();
        *again.get_mut(at)? = format!("--{word}");
        let is_right = || match Cli::try_parse_from(&again) {
            Ok(_) => true,
            Err(error) => error.kind() == ErrorKind::ValueValidation,
        };
        (named(word) && is_right()).then(|| (word.clone(), format!("did you mean '--{word} {}'?", shell_word(value))))
    })
}

fn takes_value(arg: &Arg) -> bool {
    arg.get_num_args().is_none_or(|range| range.takes_values())
}

/// A message that the shell has taken apart.
fn unquoted_message(command: &Command, rest: &[String]) -> Option<String> {
    command.get_arguments().find(|arg| arg.get_id() == "message")?;
    let from = rest.iter().position(|word| word.starts_with('{') || word.ends_with(':'))?;
    let message = rest.get(from..)?.iter().take_while(|word| !word.starts_with("--")).map(String::as_str);
    let message = message.collect::<Vec<_>>().join(" ");
    Some(format!("quote the message for the shell: {}", shell_word(&message)))
}

/// `--type`, which `ros2 topic pub` and `ros2 topic echo` have.
fn type_of_a_service(command: &Command, unknown: &str) -> Option<String> {
    (unknown == "--type" || unknown.starts_with("--type=")).then(|| match command.get_name() {
        "add" => "the type belongs to --service: --service /cmd_vel=geometry_msgs/msg/Twist".to_owned(),
        "set" => "the type is a setting: type=geometry_msgs/msg/Twist".to_owned(),
        _ => "leave --type out: the type of a service is on the ledger (ledgerctl robot show ROBOT)".to_owned(),
    })
}

/// A file or a name that stands where only an option takes it.
fn value_without_option(command: &Command, rest: &[String], unknown: &str) -> Option<String> {
    let is_given = |long: &str| {
        rest.iter().any(|word| word.strip_prefix("--").is_some_and(|name| name.split('=').next() == Some(long)))
    };
    let required = command.get_arguments().filter(|arg| arg.is_required_set() && takes_value(arg));
    let mut missing = required.filter_map(Arg::get_long).filter(|long| !is_given(long));
    match (missing.next(), missing.next()) {
        (Some(only), None) if !unknown.starts_with('-') => {
            Some(format!("did you mean '--{only} {}'?", shell_word(unknown)))
        }
        _ => None,
    }
}

fn tipped(mut error: clap::Error, tip: String) -> clap::Error {
    let _misleading = error.remove(ContextKind::SuggestedArg);
    error.insert(ContextKind::Suggested, ContextValue::StyledStrs(vec![tip.into()]));
    error
}

/// Without `to pass '--type' as a value, use '-- --type'`: no argument of these commands is meant to begin with a dash.
fn without_dashes_tip(mut error: clap::Error) -> clap::Error {
    if let Some(ContextValue::StyledStrs(tips)) = error.remove(ContextKind::Suggested) {
        let kept: Vec<_> = tips.into_iter().filter(|tip| !tip.to_string().contains("' as a value, use '")).collect();
        if !kept.is_empty() {
            error.insert(ContextKind::Suggested, ContextValue::StyledStrs(kept));
        }
    }
    error
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    fn told(line: &[&str]) -> String {
        let arguments: Vec<OsString> =
            std::iter::once("ledgerctl").chain(line.iter().copied()).map(OsString::from).collect();
        parse(&arguments).unwrap_err().to_string()
    }

    #[test]
    fn an_option_without_its_dashes_is_named_with_them() {
        let text = told(&["acquire", "Turtlebot4", "for", "10m"]);
        assert!(
            text.starts_with("error: unexpected argument 'for' found\n\n  tip: did you mean '--for 10m'?\n"),
            "{text}"
        );
        assert!(!text.contains("--all-or-none"), "{text}");
        let text = told(&["--context", "Salma", "delegate", "Turtlebot4", "to", "Org1/Farhad"]);
        assert!(text.contains("tip: did you mean '--to Org1/Farhad'?"), "{text}");
    }

    #[test]
    fn a_negative_value_is_rejected_as_a_value() {
        let text = told(&["acquire", "Turtlebot4", "--for", "-5m"]);
        assert!(text.starts_with("error: invalid value '-5m' for '--for <SPAN>': a span has no sign"), "{text}");
        let text = told(&["publish", "T", "{}", "--rate", "-1"]);
        assert!(text.starts_with("error: invalid value '-1' for '--rate <HZ>'"), "{text}");
    }

    #[test]
    fn no_tip_asks_for_two_dashes() {
        for line in [
            &["publish", "T", "{}", "--type", "geometry_msgs/msg/Twist"][..],
            &["robot", "add", "T", "--type", "geometry_msgs/msg/Twist"],
            &["acquire", "T", "-5"],
            &["status", "--since", "5m"],
        ] {
            let text = told(line);
            assert!(!text.contains("'-- "), "{text}");
        }
        assert!(told(&["publish", "T", "{}", "--type", "x"]).contains("leave --type out"));
        assert!(told(&["robot", "add", "T", "--type", "x"]).contains("--service /cmd_vel=geometry_msgs/msg/Twist"));
    }

    #[test]
    fn an_unquoted_message_is_shown_in_quotes() {
        for line in [
            &["publish", "T", "{linear:", "{x:", "0.5}}"][..],
            &["publish", "T", "linear:", "{x:", "0.5}", "--count", "2"],
        ] {
            let text = told(line);
            assert!(text.contains("tip: quote the message for the shell: '"), "{text}");
            assert!(text.contains("linear: {x: 0.5}"), "{text}");
        }
    }

    #[test]
    fn a_value_that_only_an_option_takes_is_shown_behind_it() {
        let text = told(&["diff"]);
        assert!(!text.contains("tip:"), "{text}");
        let text = told(&["bridge", "export-sros2", "robot.toml"]);
        assert!(text.contains("tip: did you mean '--config robot.toml'?"), "{text}");
    }
}
