//! The phrases in sources: their number in each file is listed, and only falls.
//!
//! `LEDGERD_REFERENCE=write ./test repository::idiom` writes the list again. It refuses to write a larger sum. After a merge that
//! adds phrases, rewrite these, or delete the list first and explain why.

use super::{matching, prose};
use crate::sources::{files, read, root};
use crate::words::named;
use std::collections::BTreeMap;
use std::path::PathBuf;

/// The folders of sources.
const FOLDERS: [&str; 9] = ["benches", "clients", "console", "crates", "docs", "examples", "fuzz", "src", "tests"];

/// Endings of sources whose prose is checked.
const ENDINGS: [&str; 9] = [".rs", ".py", ".js", ".mjs", ".proto", ".go", ".cpp", ".toml", ".yml"];

/// The head of the list.
const HEAD: &str = "# Phrases of tests/repository/idiom/rules.rs in sources, by file. The numbers only fall.\n\
     # LEDGERD_REFERENCE=write ./test repository::idiom writes this list.\n";

fn list() -> PathBuf {
    root().join("tests/fixtures/phrases.txt")
}

/// Is it prose of this rule itself, or generated from a source that is checked?
fn is_exempt(name: &str) -> bool {
    name.starts_with("tests/repository/idiom") || name.ends_with("_pb2.py") || name.ends_with("_pb2_grpc.py")
}

/// The phrases of each source that has some.
fn found() -> BTreeMap<String, Vec<String>> {
    let mut found = BTreeMap::new();
    for path in FOLDERS.iter().flat_map(|from| files(&root().join(from), "")) {
        let name = named(&path);
        if is_exempt(&name) || !ENDINGS.iter().any(|ending| name.ends_with(ending)) {
            continue;
        }
        let hits = matching::hits(&prose::of_source(&name, &read(&path)));
        let shown: Vec<_> = hits.iter().map(|hit| hit.shown(&name)).collect();
        if !shown.is_empty() {
            found.insert(name, shown);
        }
    }
    found
}

/// The list as text.
fn written(counts: &BTreeMap<String, usize>) -> String {
    let lines = counts.iter().map(|(name, count)| format!("{count} {name}\n"));
    HEAD.to_owned() + &lines.collect::<String>()
}

/// The list as numbers.
fn listed(text: &str) -> BTreeMap<String, usize> {
    let entry = |line: &str| {
        let (count, name) = line.split_once(' ')?;
        Some((name.to_owned(), count.parse().ok()?))
    };
    text.lines().filter(|line| !line.starts_with('#')).filter_map(entry).collect()
}

/// The faults of these numbers, compared with the list: files with more, and files with fewer.
fn faults(listed: &BTreeMap<String, usize>, found: &BTreeMap<String, Vec<String>>) -> Vec<String> {
    let mut faults = Vec::new();
    for (name, hits) in found {
        let allowed = listed.get(name).copied().unwrap_or_default();
        if hits.len() > allowed {
            let shown = hits.join("\n  ");
            faults.push(format!("{name} has {} phrases, and {allowed} are listed; rewrite:\n  {shown}", hits.len()));
        }
    }
    for (name, allowed) in listed {
        let count = found.get(name).map_or(0, Vec::len);
        if count < *allowed {
            faults.push(format!(
                "{name} has {count} phrases, and {allowed} are listed: LEDGERD_REFERENCE=write ./test repository::idiom"
            ));
        }
    }
    faults
}

/// May this list replace that one?
fn may_replace(old: &BTreeMap<String, usize>, new: &BTreeMap<String, usize>) -> bool {
    new.values().sum::<usize>() <= old.values().sum()
}

#[test]
fn the_phrases_in_sources_only_become_fewer() {
    let found = found();
    let path = list();
    if std::env::var_os("LEDGERD_REFERENCE").is_some() {
        let counts = found.iter().map(|(name, hits)| (name.clone(), hits.len())).collect();
        let old = path.exists().then(|| listed(&read(&path)));
        if old.is_none_or(|old| may_replace(&old, &counts)) {
            std::fs::write(&path, written(&counts)).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        }
    }
    let faults = faults(&listed(&read(&path)), &found);
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
fn more_phrases_are_a_fault_and_the_list_follows_fewer() {
    let one = |count| BTreeMap::from([("a.rs".to_owned(), count)]);
    let hits = |count| BTreeMap::from([("a.rs".to_owned(), vec!["a.rs:1: \"anew\"; write: again".to_owned(); count])]);
    assert_eq!(listed(&written(&one(2))), one(2));
    assert_eq!(faults(&one(2), &hits(2)), Vec::<String>::new());
    let more = faults(&one(1), &hits(2));
    assert!(matches!(more.as_slice(), [fault] if fault.contains("write: again")), "{more:?}");
    assert_eq!(faults(&one(2), &hits(1)).len(), 1);
    assert_eq!(faults(&BTreeMap::new(), &hits(1)).len(), 1, "a new file has no phrases");
    assert_eq!(faults(&one(1), &BTreeMap::new()).len(), 1, "a file that is gone leaves the list");
    assert!(may_replace(&one(2), &one(1)) && may_replace(&one(1), &one(1)) && !may_replace(&one(1), &one(2)));
}
