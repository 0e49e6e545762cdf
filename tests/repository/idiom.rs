//! The idiom of pages, comments, messages and commits: each phrase in [`rules`] is rejected, and the fault names better words.
//!
//! Pages have none of these phrases, apart from [`WAIVERS`]. Sources have a number of them in each file, which only falls: see
//! [`ratchet`]. The subjects of commits are checked in [`commits`].

mod commits;
mod matching;
mod prose;
mod ratchet;
mod rules;

use crate::sources::{files, read, root};
use crate::words::{comments, named};
use matching::Hit;
use std::collections::BTreeSet;
use std::path::Path;

/// A phrase that a page has for a reason.
struct Waiver {
    page: &'static str,
    /// The words as the fault shows them.
    phrase: &'static str,
    reason: &'static str,
}

const WAIVERS: &[Waiver] = &[Waiver {
    page: "docs/errors.md",
    phrase: "refused",
    reason: "the name of the code LGR-1015, which never changes",
}];

/// The faults of a page.
fn faults(page: &str) -> Vec<Hit> {
    let mut found = matching::hits(&prose::of_page(page));
    found.extend(matching::headings(&prose::headings(page)));
    found
}

/// The prose of ledgerd.toml is a page, too: docs/configuration.md is made from it.
fn pages() -> Vec<(String, Vec<Hit>)> {
    let of_page = |path: &std::path::PathBuf| (named(path), faults(&read(path)));
    let mut pages: Vec<_> = files(root(), ".md").iter().map(of_page).collect();
    let settings = "ledgerd.toml";
    pages.push((settings.to_owned(), matching::hits(&comments(&read(&root().join(settings))))));
    pages
}

#[test]
fn pages_are_free_of_the_phrases_that_a_reader_stops_at() {
    let (mut found, mut used) = (Vec::new(), BTreeSet::new());
    for (page, hits) in pages() {
        for hit in hits {
            match WAIVERS.iter().find(|waiver| waiver.page == page && waiver.phrase == hit.phrase) {
                Some(waiver) => _ = used.insert((waiver.page, waiver.phrase)),
                None => found.push(hit.shown(&page)),
            }
        }
    }
    assert!(found.is_empty(), "{} phrases:\n{}", found.len(), found.join("\n"));
    for Waiver { page, phrase, reason } in WAIVERS {
        assert!(used.contains(&(*page, *phrase)), "{page} has {phrase:?} no longer ({reason}): remove the waiver");
        assert!(Path::new(page).extension().is_some() && reason.len() > 20, "a waiver has a page and a reason: {page}");
    }
}

#[test]
fn each_rule_rejects_its_example_and_names_better_words() {
    for rule in rules::RULES {
        let [rejected, better] = rule.examples;
        let found = faults(&format!("{rejected}\n"));
        let hit = found.iter().find(|hit| hit.instead == rule.instead);
        let hit = hit.unwrap_or_else(|| panic!("{:?} does not reject {rejected:?}", rule.pattern));
        let shown = hit.shown("docs/page.md");
        assert!(shown.contains(rule.instead) && shown.starts_with("docs/page.md:1: "), "{shown}");
        let found: Vec<_> = faults(&format!("{better}\n")).iter().map(|hit| hit.shown("better")).collect();
        assert!(found.is_empty(), "{found:?}");
    }
}

#[test]
fn phrases_are_found_in_headings_tables_comments_and_texts_but_not_in_code() {
    let phrases = |hits: Vec<Hit>| hits.into_iter().map(|hit| (hit.line, hit.phrase)).collect::<Vec<_>>();
    let page = "# What it says\n\n| a | nobody's |\n|---|---|\n\n```text\nanew\n```\n\nIt is `anew`, so: many are, for\never.\n";
    assert_eq!(phrases(faults(page)), [(10, "for ever".to_owned()), (3, "nobody".to_owned()), (1, "what".to_owned())]);
    let rust = "//! Anew.\n\n/// A node\n/// knows it.\nlet a = 1; // for ever\nlet b = \"it goes on\";\nlet c = \"a // anew\";\nlet d = \"refused\";\n";
    let found = phrases(matching::hits(&prose::of_source("src/a.rs", rust)));
    let wanted = [(1, "anew"), (3, "node knows"), (5, "for ever"), (6, "goes on"), (7, "anew")];
    assert_eq!(found, wanted.map(|(line, phrase)| (line, phrase.to_owned())));
    let of_tests = phrases(matching::hits(&prose::of_source("crates/a/tests/b.rs", "let b = \"it goes on\";\n")));
    assert!(of_tests.is_empty(), "texts in tests quote programs: {of_tests:?}");
    let python = "\"\"\"Goes on\n\nanew.\"\"\"\nx = 1  # for good\n";
    let found = phrases(matching::hits(&prose::of_source("a.py", python)));
    let wanted = [(4, "for good"), (1, "goes on"), (3, "anew")];
    assert_eq!(found, wanted.map(|(line, phrase)| (line, phrase.to_owned())));
}
