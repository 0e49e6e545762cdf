//! Programs of others, in their languages, against real nodes.
//!
//! | module | what happens |
//! |---|---|
//! | `python` | the package `clients/python`: its own tests, its types, its wheel, its README |
//! | `console` | the files of the console, its types, its encoding; tests/interop shows it in a browser |
//! | `languages` | the programs of docs/clients.md, typed as they stand |
//!
//! The interpreter is `$LEDGERD_TEST_PYTHON`, as `./test` prepares it.

#![expect(clippy::unwrap_used, clippy::expect_used, clippy::indexing_slicing, reason = "tests")]

mod console;
mod languages;
mod python;

use ledgerd_support::{self as support, two_networks};

use std::path::Path;
use support::programs::{python, ran, repository};

/// The blocks of a language in a document, in order.
fn blocks(document: &Path, language: &str) -> Vec<String> {
    let text = std::fs::read_to_string(document).unwrap();
    let begin = format!("\n```{language}\n");
    let found: Vec<_> =
        text.split(&begin).skip(1).map(|rest| rest.split_once("\n```").unwrap().0.to_owned() + "\n").collect();
    assert!(!found.is_empty(), "{} has no block of {language}", document.display());
    found
}
