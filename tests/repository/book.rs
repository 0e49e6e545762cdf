//! The book: docs/SUMMARY.md lists every page once, each concept has a picture, and what is made from the sources is up to
//! date. `LEDGERD_REFERENCE=write ./test repository::book` makes it anew.

use crate::sources::{files, read, root};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// The page below which the decisions are listed.
const REASONS: &str = "- [Reasons](decisions/README.md)\n";

fn docs() -> PathBuf {
    root().join("docs")
}

/// The entries of the summary: titles and files below docs/, in their order.
fn entries() -> Vec<(String, String)> {
    let summary = read(&docs().join("SUMMARY.md"));
    let entry = |line: &str| {
        let (title, file) =
            line.trim().trim_start_matches("- ").strip_prefix('[')?.strip_suffix(')')?.split_once("](")?;
        Some((title.to_owned(), file.to_owned()))
    };
    summary.lines().filter_map(entry).collect()
}

/// Compares a file with what it is to be, or writes it.
fn made(path: &Path, wanted: &str) {
    if std::env::var_os("LEDGERD_REFERENCE").is_some() {
        std::fs::write(path, wanted).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        return;
    }
    let why = "make it anew: LEDGERD_REFERENCE=write ./test repository::book";
    assert!(read(path) == wanted, "{} is not what the sources say; {why}", path.display());
}

#[test]
fn the_summary_lists_every_page_once() {
    let listed: Vec<String> = entries().into_iter().map(|(_, file)| file).collect();
    let once: BTreeSet<&String> = listed.iter().collect();
    assert_eq!(once.len(), listed.len(), "a page stands twice in docs/SUMMARY.md");
    let pages = files(&docs(), ".md").into_iter().map(|path| {
        let below = path.strip_prefix(docs()).unwrap_or(&path);
        below.to_string_lossy().into_owned()
    });
    let pages: BTreeSet<String> = pages.filter(|page| page != "SUMMARY.md").collect();
    let listed: BTreeSet<String> = listed.into_iter().collect();
    assert_eq!(listed, pages, "left: docs/SUMMARY.md; right: the pages below docs/");
}

#[test]
fn the_summary_lists_the_decisions_in_their_order_with_their_titles() {
    let path = docs().join("SUMMARY.md");
    let summary = read(&path);
    let (before, _) = summary.split_once(REASONS).unwrap_or_else(|| panic!("docs/SUMMARY.md lacks {REASONS:?}"));
    let decisions = files(&docs().join("decisions"), ".md").into_iter().filter(|path| !path.ends_with("README.md"));
    let decisions: BTreeMap<String, String> = decisions
        .map(|path| {
            let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            (name, read(&path).lines().next().unwrap_or_default().trim_start_matches("# ").to_owned())
        })
        .collect();
    let listed: String = decisions.iter().map(|(name, title)| format!("  - [{title}](decisions/{name})\n")).collect();
    made(&path, &format!("{before}{REASONS}{listed}"));
}

#[test]
fn each_concept_has_one_picture() {
    let page = read(&docs().join("concepts.md"));
    let sections: Vec<&str> = page.split("\n## ").skip(1).collect();
    assert!(!sections.is_empty(), "docs/concepts.md has no sections");
    for section in sections {
        let pictures = section.matches("](pictures/").count();
        assert_eq!(pictures, 1, "pictures in {section}");
    }
}

/// A setting of ledgerd.toml.
struct Setting {
    key: String,
    default: String,
    meaning: String,
}

/// The sections of ledgerd.toml with their settings. The one without a name comes first.
fn settings() -> Vec<(String, Vec<Setting>)> {
    let mut sections = vec![(String::new(), Vec::new())];
    let mut comment: Vec<String> = Vec::new();
    for line in read(&root().join("ledgerd.toml")).lines() {
        if let Some(words) = line.strip_prefix("# ") {
            comment.push(words.to_owned());
        } else if let Some((key, default)) = line.strip_prefix('#').and_then(|setting| setting.split_once(" = ")) {
            let meaning = std::mem::take(&mut comment).join(" ");
            if let Some((_, section)) = sections.last_mut() {
                section.push(Setting { key: key.to_owned(), default: default.to_owned(), meaning });
            }
        } else if let Some(name) = line.strip_prefix('[') {
            comment.clear();
            sections.push((name.trim_end_matches(']').to_owned(), Vec::new()));
        } else {
            comment.clear();
        }
    }
    sections
}

#[test]
fn the_page_about_settings_is_that_of_the_configuration_file() {
    let mut page = String::from(
        "# Node settings\n\nThis page is generated from [ledgerd.toml](../ledgerd.toml), which tests compare with the program. To change a setting, \
         remove the `#` before it in that file. `ledgerd check --config FILE` reports all errors. Values outside of the given bounds are \
         rejected.\n\nThe settings of a bridge are in [Bridges](bridge.md#settings).\n",
    );
    let mut seen = 0;
    for (section, settings) in settings() {
        let heading = if section.is_empty() { "Top-level settings".to_owned() } else { format!("`[{section}]`") };
        page.push_str(&format!("\n## {heading}\n\n| setting | default | meaning |\n|---|---|---|\n"));
        // Some settings have one comment together: it stands with the first.
        for Setting { key, default, meaning } in settings {
            let meaning = meaning.replace('|', "\\|").replace('<', "&lt;");
            page.push_str(&format!("| `{key}` | `{default}` | {meaning} |\n"));
            seen += 1;
        }
    }
    assert!(seen > 15, "{seen} settings are found in ledgerd.toml");
    made(&docs().join("configuration.md"), &page);
}
