//! Tests that docs/security.md and docs/operations.md name: each of them exists, so that nothing is claimed that nothing shows.

use crate::sources::{files, read, root};
use std::collections::BTreeSet;

/// The names in backticks that look like those of tests: several words in lower case.
fn named(page: &str) -> BTreeSet<&str> {
    let quoted = page.split('`').skip(1).step_by(2);
    let is_test = |name: &&str| {
        name.matches('_').count() >= 3 && name.chars().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_')
    };
    quoted.filter(is_test).collect()
}

#[test]
fn every_test_that_the_page_on_security_names_exists() {
    let page = read(&root().join("docs/security.md"));
    let named = named(&page);
    assert!(named.len() > 30, "{}", named.len());
    assert_exist(&named);
}

#[test]
fn every_disaster_of_the_page_on_operations_names_a_test_that_exists() {
    let page = read(&root().join("docs/operations.md"));
    let table =
        page.split_once("\n| disaster |").and_then(|(_, rest)| rest.split_once("\n\n")).map_or("", |(table, _)| table);
    let rows: Vec<_> = table.lines().skip(2).collect();
    assert!(rows.len() > 8, "{rows:?}");
    let without: Vec<_> = rows.iter().filter(|row| named(row).is_empty()).collect();
    assert!(without.is_empty(), "no test stands beside: {without:?}");
    assert_exist(&named(table));
}

fn assert_exist(named: &BTreeSet<&str>) {
    let sources: String = files(root(), ".rs").iter().map(|path| read(path)).collect();
    let missing: Vec<_> = named.iter().filter(|name| !sources.contains(&format!("fn {name}("))).collect();
    assert!(missing.is_empty(), "no such tests: {missing:?}");
}
