//! `ledgerd policy prove`: what policies can never permit, and whether new ones permit more than old ones. Offline, for every
//! request that there could be, by Cedar's symbolic analysis and the solver cvc5.
//!
//! A proof covers more than the ledger permits: a policy that fails to evaluate denies there. So a proof holds on the ledger.

mod facts;
mod question;
mod solver;
mod words;

use crate::process::terminal::print_line;
use ledger_abac::{Analysis, DEFAULT_POLICY, POLICY_BYTES_MAX};
use ledger_base::durable::read;
use ledger_base::rejection::{Code, Rejection};
use question::{Answer, Question, Who, prove};
use solver::Cvc5;
use std::fs;
use std::path::{Path, PathBuf};

/// Stack of the thread that proves: policies may be nested deeply.
const STACK_BYTES: usize = 256 * 1024 * 1024;
/// Most files of one directory.
const FILES_MAX: usize = 1_000;

/// `ledgerd policy`
#[derive(clap::Subcommand)]
pub(crate) enum Policy {
    Prove(Options),
}

/// Proves what policies can never permit, or shows a request that they permit. Needs the solver cvc5, but no network.
///
/// Without files, it uses the built-in policy, which is in force for organisations without policies. A directory means
/// its files *.cedar. Exits with 0 if proved, with 1 if there is a counterexample, and with another code if undecided.
/// The variable CVC5 names the solver: cvc5 1.3.1 or newer (https://github.com/cvc5/cvc5/releases).
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  ledgerd policy prove policies/ --robot Turtlebot4 --can drive --nobody-without Turtlebot4
  ledgerd policy prove policies/ --robot Turtlebot4 --can override --nobody-of Org7
  ledgerd policy prove new/ --at-most policies/")]
pub(crate) struct Options {
    /// Files with policies, or directories of them; the built-in policy if there are none.
    #[arg(value_name = "FILE")]
    files: Vec<PathBuf>,
    /// No one without this attribute can do it; NAME=VALUE also counts other values as missing.
    #[arg(long, value_name = "NAME[=VALUE]", group = "question", requires = "can")]
    nobody_without: Option<String>,
    /// No one of this organisation can do it.
    #[arg(long, value_name = "ORGANISATION", group = "question", requires = "can")]
    nobody_of: Option<String>,
    /// These policies permit at most what those permit.
    #[arg(long, value_name = "FILE", group = "question", conflicts_with_all = ["can", "robot", "owner", "requires_attribute", "trusted"])]
    at_most: Vec<PathBuf>,
    /// The action: drive (acquire and publish), acquire, publish, subscribe, override, confirm, stop or resume.
    #[arg(long, value_name = "ACTION", value_parser = question::actions)]
    can: Option<question::Actions>,
    /// The robot, or one of its topics: ROBOT/TOPIC; any by default.
    #[arg(long, value_name = "ROBOT[/TOPIC]")]
    robot: Option<String>,
    /// The owner of the robot; any by default.
    #[arg(long, value_name = "ORGANISATION")]
    owner: Option<String>,
    /// The attribute that the robot requires (`ledgerctl robot show`); any by default.
    #[arg(long = "requires", value_name = "NAME[=VALUE]")]
    requires_attribute: Option<String>,
    /// An organisation whose attributes the owner trusts; may be given several times. Any by default.
    #[arg(long, value_name = "ORGANISATION")]
    trusted: Vec<String>,
}

/// Proves, and prints the answer. Answers whether it is proved.
///
/// # Errors
/// Files that cannot be used, a solver that is missing or too old, and a question that it could not decide.
pub(crate) fn run(Policy::Prove(options): Policy) -> Result<bool, Rejection> {
    let policies = texts(&options.files)?;
    let question = options.question()?;
    let solver = Cvc5::find()?;
    // Compiling policies recurses as deeply as they are nested.
    let thread = std::thread::Builder::new().name("prove".to_owned()).stack_size(STACK_BYTES);
    let failed = |found: String| Rejection::new(Code::Internal, "the proof failed").found(found);
    let proving =
        thread.spawn(move || prove(&solver, &policies, &question)).map_err(|error| failed(error.to_string()))?;
    let Answer { text, is_proved } = proving.join().map_err(|_| failed("a panic".to_owned()))??;
    print_line(&text)?;
    Ok(is_proved)
}

impl Options {
    fn question(&self) -> Result<Question, Rejection> {
        if !self.at_most.is_empty() {
            return Ok(Question::AtMost(texts(&self.at_most)?));
        }
        let who = match (&self.nobody_without, &self.nobody_of) {
            (Some(attribute), _) => Who::Without(attribute.clone()),
            (None, Some(organisation)) => Who::Of(organisation.clone()),
            (None, None) => {
                return Err(Rejection::new(Code::BadArgument, "there is nothing to prove")
                    .wanted("--nobody-without NAME, --nobody-of ORGANISATION or --at-most FILE")
                    .next("ledgerd policy prove --help"));
            }
        };
        Ok(Question::Nobody {
            who,
            actions: self.can.clone().unwrap_or_default(),
            facts: facts::Robot {
                robot: self.robot.clone(),
                owner: self.owner.clone(),
                requires: self.requires_attribute.clone(),
                trusted: self.trusted.clone(),
            },
        })
    }
}

/// The policies in these files and directories, or the built-in one.
fn texts(paths: &[PathBuf]) -> Result<Analysis, Rejection> {
    if paths.is_empty() {
        return Analysis::read([("default", DEFAULT_POLICY)]);
    }
    let mut found = Vec::new();
    for path in paths {
        for file in files(path)? {
            let bytes = read(&file, POLICY_BYTES_MAX)?;
            let text = String::from_utf8(bytes).map_err(|_| bad(&file, "bytes that are not text"))?;
            // Some editors write a mark in front of the text.
            let text = text.strip_prefix('\u{feff}').unwrap_or(&text).to_owned();
            found.push((file.file_stem().map_or_else(String::new, |name| name.to_string_lossy().into_owned()), text));
        }
    }
    Analysis::read(found.iter().map(|(name, text)| (name.as_str(), text.as_str())))
}

/// The file itself, or those of a directory in the order of their names.
fn files(path: &Path) -> Result<Vec<PathBuf>, Rejection> {
    if !path.is_dir() {
        return Ok(vec![path.to_owned()]);
    }
    let entries = fs::read_dir(path).map_err(|error| bad(path, &error.to_string()))?;
    let mut found: Vec<PathBuf> = entries.filter_map(|entry| Some(entry.ok()?.path())).collect();
    found.retain(|file| file.extension().is_some_and(|end| end == "cedar"));
    found.sort();
    match found.len() {
        0 => Err(bad(path, "no file *.cedar").wanted("a directory with policies")),
        1..=FILES_MAX => Ok(found),
        many => Err(bad(path, &format!("{many} files")).wanted(format!("at most {FILES_MAX}"))),
    }
}

fn bad(path: &Path, found: &str) -> Rejection {
    Rejection::new(Code::BadFile, format!("cannot use {}", path.display())).found(found)
}
