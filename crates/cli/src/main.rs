//! `ledgerctl`: the command line for operators, owners and auditors of a ledger.
//!
//! `main` parses and runs; `cli` is the table of commands, one file per group lies under `command`. Every refusal is
//! a [`ledger_base::rejection::Rejection`] and is printed by `failure`; every result goes through `output`, as a table or as JSON.

mod answer;
mod argument;
mod cli;
mod command;
mod complete;
mod confirm;
mod context;
mod failure;
mod format;
mod global;
mod health;
mod in_force;
mod misuse;
mod nodes;
mod output;
mod printable;
mod recording;
mod session;
mod strictness;
mod time;
mod upkeep;
mod words;

use clap::CommandFactory;
use std::ffi::OsString;
use std::process::ExitCode;

fn main() -> ExitCode {
    complete::answer(cli::Cli::command);
    let arguments: Vec<OsString> = std::env::args_os().collect();
    match misuse::parse(&arguments) {
        Ok(cli) => {
            let format = cli.global.format();
            match cli.run() {
                Ok(()) => ExitCode::SUCCESS,
                Err(failure) => failure.report(format),
            }
        }
        Err(error) => failure::usage(&error, argument::destination::asked(arguments)),
    }
}
