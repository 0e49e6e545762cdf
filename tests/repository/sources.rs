//! Rules for every source file.

use std::fs;
use std::path::{Path, PathBuf};

/// Longest source file, in lines. Beyond it a file does more than one thing.
const LINES_MAX: usize = 500;

/// Names that say nothing, and so collect everything.
const NAMES: [&str; 6] = ["utils", "util", "types", "helpers", "common", "constants"];

/// The top of the repository.
pub(crate) fn root() -> &'static Path {
    // The folder of this package is `tests/repository`.
    let package = Path::new(env!("CARGO_MANIFEST_DIR"));
    package.ancestors().nth(2).unwrap_or(package)
}

/// The text of a file of the repository.
pub(crate) fn read(path: &Path) -> String {
    fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// Every file below a directory whose name ends so, except what is built and what others wrote.
pub(crate) fn files(directory: &Path, ending: &str) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let entries = fs::read_dir(directory).unwrap_or_else(|error| panic!("{}: {error}", directory.display()));
    for path in entries.flatten().map(|entry| entry.path()) {
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let is_ours = !name.starts_with("target") && ![".git", "node_modules"].contains(&name.as_str());
        if path.is_dir() && is_ours {
            found.extend(files(&path, ending));
        } else if name.ends_with(ending) {
            found.push(path);
        }
    }
    found.sort();
    found
}

/// The manifest of every crate of this workspace.
pub(crate) fn manifests() -> Vec<PathBuf> {
    files(root(), "Cargo.toml")
}

/// Is this the manifest of a package of tests alone? The simulation is more: a program, too.
pub(crate) fn is_of_tests(manifest: &Path) -> bool {
    let inside = manifest.strip_prefix(root()).unwrap_or(manifest);
    inside.iter().any(|part| part == "tests") && !inside.starts_with("tests/sim")
}

/// The text of a Rust file without the tests at its end.
pub(crate) fn product(path: &Path) -> String {
    let text = read(path);
    text.split("\nmod tests {").next().unwrap_or_default().to_owned()
}

/// The lines of a Rust file that are code.
pub(crate) fn code(text: &str) -> impl Iterator<Item = &str> {
    text.lines().filter(|line| !line.trim_start().starts_with("//"))
}

#[test]
fn the_rules_of_tests_are_spoken_by_tests_only() {
    let sources = ["crates", "src", "examples"].map(|folder| files(&root().join(folder), ".rs"));
    for path in sources.into_iter().flatten() {
        let relative = path.strip_prefix(root()).unwrap_or(&path).to_string_lossy().into_owned();
        // The file that declares them.
        if relative == "crates/ledger/src/rules.rs" || relative.contains("tests") {
            continue;
        }
        let text = product(&path);
        let named = code(&text).find(|line| line.contains("OF_TESTS"));
        assert!(named.is_none(), "{relative} speaks rules that no release has: {named:?}");
    }
}

#[test]
fn no_source_file_is_longer_than_one_thing() {
    let long: Vec<_> = files(root(), ".rs")
        .into_iter()
        .filter_map(|path| Some((read(&path).lines().count(), path)).filter(|(lines, _)| *lines > LINES_MAX))
        .collect();
    assert!(long.is_empty(), "longer than {LINES_MAX} lines, split by role: {long:?}");
}

#[test]
fn no_module_has_a_name_that_says_nothing() {
    let vague: Vec<_> = files(root(), ".rs")
        .into_iter()
        .filter(|path| {
            path.with_extension("").components().any(|part| NAMES.iter().any(|name| part.as_os_str() == *name))
        })
        .collect();
    assert!(vague.is_empty(), "name them after what is in them: {vague:?}");
}

#[test]
fn nothing_is_left_to_be_done_in_a_comment() {
    let marks = [["TO", "DO"].concat(), ["FIX", "ME"].concat(), ["XX", "X"].concat()];
    for ending in [".rs", ".toml", ".proto", ".py", ".md"] {
        for path in files(root(), ending) {
            let text = read(&path);
            let mark = marks.iter().find(|mark| text.contains(mark.as_str()));
            assert!(mark.is_none(), "{} has a {mark:?}: do it, or write an issue", path.display());
        }
    }
}
