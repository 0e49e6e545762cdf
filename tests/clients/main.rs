//! Programs of others, in their languages, against real nodes.
//!
//! | module | what happens |
//! |---|---|
//! | `python` | the package `clients/python`: its own tests, its types, its wheel, its README |
//! | `languages` | the programs of docs/clients.md, typed as they stand |
//!
//! The interpreter is `$LEDGERD_TEST_PYTHON`, as `./test` prepares it.

#![expect(clippy::unwrap_used, clippy::expect_used, clippy::panic, unreachable_pub, reason = "tests")]
#![expect(clippy::indexing_slicing, reason = "tests")]

#[expect(
    dead_code,
    unused_imports,
    clippy::print_stderr,
    clippy::print_stdout,
    reason = "shared with the tests of nodes"
)]
#[path = "../support/mod.rs"]
mod support;
#[path = "../support/two_networks.rs"]
mod two_networks;

mod languages;
mod python;

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// The top of the repository.
fn repository() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// The interpreter, with grpcio, cryptography, and what the tests of the package need.
fn python() -> PathBuf {
    std::env::var_os("LEDGERD_TEST_PYTHON").map_or_else(|| "python3".into(), PathBuf::from)
}

/// Runs a command that must succeed.
#[track_caller]
fn ran(command: &mut Command) -> Output {
    let output = command.output().unwrap_or_else(|error| panic!("{command:?} does not start: {error}; run ./test"));
    let [said, told] = [&output.stdout, &output.stderr].map(|bytes| String::from_utf8_lossy(bytes).into_owned());
    assert!(output.status.success(), "{command:?} (./test installs what it needs): {}\n{said}\n{told}", output.status);
    output
}

/// The blocks of a language in a document, in order.
fn blocks(document: &Path, language: &str) -> Vec<String> {
    let text = std::fs::read_to_string(document).unwrap();
    let begin = format!("\n```{language}\n");
    let found: Vec<_> =
        text.split(&begin).skip(1).map(|rest| rest.split_once("\n```").unwrap().0.to_owned() + "\n").collect();
    assert!(!found.is_empty(), "{} has no block of {language}", document.display());
    found
}
