//! The package in Python says what this workspace says.

use crate::sources::{files, read, root};
use ledger_base::rejection::{Class, Code};
use std::collections::BTreeSet;

#[test]
fn the_codes_of_the_python_package_are_those_of_this_workspace() {
    let text = read(&root().join("clients/python/src/ledgerd/codes.py"));
    let found: BTreeSet<&str> = text.lines().map(str::trim).filter(|line| line.contains(": (\"")).collect();
    let kind = |class: Class| format!("{class:?}").to_uppercase();
    let wanted: BTreeSet<String> = Code::ALL
        .iter()
        .map(|code| format!("{}: (\"{}\", Kind.{}),", code.number(), code.name(), kind(code.class())))
        .collect();
    assert_eq!(found, wanted.iter().map(String::as_str).collect(), "left: codes.py; right: crates/base/src/rejection");
    for class in [Class::Ok, Class::Failure, Class::Denied, Class::Invalid, Class::Unreachable, Class::Conflict] {
        let line = format!("    {} = {}\n", kind(class), class.exit_code());
        assert!(text.contains(&line), "codes.py has no line {line:?}");
    }
}

#[test]
fn the_python_package_has_the_version_of_this_workspace() {
    let text = read(&root().join("clients/python/pyproject.toml"));
    assert!(text.contains(&format!("\nversion = \"{}\"\n", env!("CARGO_PKG_VERSION"))));
}

#[test]
fn no_python_file_of_the_package_is_longer_than_one_thing_or_has_a_name_that_says_nothing() {
    for path in files(&root().join("clients/python"), ".py") {
        let lines = read(&path).lines().count();
        assert!(lines <= 500, "{} has {lines} lines: split it by role", path.display());
        let name = path.file_stem().unwrap_or_default().to_string_lossy();
        let says_nothing = ["utils", "util", "types", "helpers", "common", "constants"].contains(&&*name);
        assert!(!says_nothing, "{}: name it after what is in it", path.display());
    }
}
