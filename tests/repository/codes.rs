//! The table of codes: a released code stays, and none is dead.

use crate::sources::{files, product, read, root};
use ledger_base::rejection::Code;

/// Number, name and class of every code that was ever released.
const RELEASED: &str = "tests/fixtures/codes.txt";

#[test]
fn a_released_code_keeps_number_name_and_class() {
    let line = |code: &Code| format!("{:04} {} {:?}\n", code.number(), code.name(), code.class());
    let table: String = Code::ALL.iter().map(line).collect();
    let released = read(&root().join(RELEASED));
    for known in released.lines() {
        assert!(table.lines().any(|line| line == known), "{known} was released: clients and chains rely on it");
    }
    assert_eq!(table, released, "a new code is added to {RELEASED}, in its place");
}

#[test]
fn every_code_is_named_by_the_product() {
    let sources = ["crates", "src", "examples"].iter().flat_map(|sources| files(&root().join(sources), ".rs"));
    let text: String =
        sources.filter(|path| !path.ends_with("rejection/src/code.rs")).map(|path| product(&path)).collect();
    for code in Code::ALL {
        let named = text.match_indices(&format!("Code::{code:?}")).any(|(at, name)| {
            text.get(at + name.len()..).is_none_or(|rest| !rest.starts_with(|c: char| c.is_alphanumeric() || c == '_'))
        });
        assert!(named, "nothing refuses with {code} {}: it is not documented for nothing", code.name());
    }
}
