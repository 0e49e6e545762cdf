//! Tests that docs/security.md names: each of them exists, so that no protection is claimed that nothing shows.

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
    let sources: String = files(root(), ".rs").iter().map(|path| read(path)).collect();
    let missing: Vec<_> = named.iter().filter(|name| !sources.contains(&format!("fn {name}("))).collect();
    assert!(missing.is_empty(), "no such tests: {missing:?}");
}
