//! docs/format.md names every key of the world state.

use crate::sources::{code, files, read, root};
use std::collections::BTreeSet;

/// The beginnings of keys: up to the first `/`, or the whole key if there is none.
fn beginning(key: &str) -> String {
    key.split_inclusive('/').next().unwrap_or_default().to_owned()
}

/// The beginnings of the keys in the table of docs/format.md about a chaincode.
fn documented(chaincode: &str) -> BTreeSet<String> {
    let text = read(&root().join("docs/format.md"));
    let head = format!("| key of `{chaincode}` |");
    let rows =
        text.lines().skip_while(|line| !line.starts_with(&head)).skip(2).take_while(|line| line.starts_with('|'));
    let keys = rows.filter_map(|row| Some(row.trim_matches('|').split('|').next()?.to_owned()));
    keys.flat_map(|cell| {
        let names: Vec<_> = cell.split('`').skip(1).step_by(2).map(str::to_owned).collect();
        // Behind ‖ stands the rest of a key.
        names.into_iter().take(if cell.contains('‖') { 1 } else { usize::MAX })
    })
    .map(|key| beginning(&key))
    .collect()
}

/// The beginnings of keys in the sources of a chaincode. They are texts that start with small letters and a `/`, and
/// full keys that start with the name of the chaincode and a zero byte.
fn written(chaincode: &str, folders: &[&str]) -> BTreeSet<String> {
    let full = format!("{chaincode}\\0");
    let sources = files(&root().join("crates"), ".rs").into_iter().filter(|path| {
        let path = path.to_string_lossy();
        folders.iter().any(|folder| path.contains(folder)) && !path.contains("tests")
    });
    let mut found = BTreeSet::new();
    for path in sources {
        let text = read(&path);
        for literal in code(&text).flat_map(|line| line.split('"').skip(1).step_by(2)) {
            let letters = literal.trim_start_matches(|c: char| c.is_ascii_lowercase());
            if let Some(key) = literal.strip_prefix(&full) {
                found.insert(beginning(key));
            } else if letters.starts_with('/') && letters.len() < literal.len() {
                found.insert(beginning(literal));
            }
        }
    }
    found
}

#[test]
fn the_formats_name_every_key_of_the_world_state() {
    for (chaincode, folders) in [("abac", &["crates/abac/src/"][..]), ("msp", &["/src/msp/", "/src/msp.rs"])] {
        let written = written(chaincode, folders);
        assert!(!written.is_empty(), "no key of {chaincode} is found in {folders:?}");
        assert_eq!(
            documented(chaincode),
            written,
            "left: keys of {chaincode} in docs/format.md; right: in the sources"
        );
    }
}
