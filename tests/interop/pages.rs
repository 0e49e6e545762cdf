//! README.md and the pages of the book as they stand: their blocks of commands are typed, in order, by a newcomer with an empty home
//! directory.
//!
//! The output in them is compared line by line. Times, ids, fingerprints and secrets differ from run to run: a word
//! of that kind may be another one of the same form. Where a later command of the page names it, the real one is put
//! there. So a page shows whole values, as a reader sees them. A command without output in the page must succeed.
//!
//! [`readings`] has for each page what it takes for granted, words that stand for something else here, and the blocks that this test
//! does not run, with the reason. A block that is neither run nor listed there fails the test.

mod page;
mod readings;
mod terminal;

use crate::network;
use page::{Block, Page};
use readings::{ELSEWHERE, READINGS, Reading};
use std::collections::BTreeSet;
use terminal::Terminal;

/// Three screens.
const LINES_MAX: usize = 150;

#[test]
fn every_block_of_commands_is_run_or_listed_with_a_reason() {
    let root = crate::support::programs::repository();
    let docs = std::fs::read_dir(root.join("docs")).unwrap().map(|entry| entry.unwrap().file_name());
    let docs = docs.filter_map(|name| name.to_str().map(|name| format!("docs/{name}")));
    let names: BTreeSet<String> = docs.filter(|name| name.ends_with(".md")).chain(["README.md".to_owned()]).collect();
    for name in &names {
        let page = Page::read(name);
        let reading = READINGS.iter().find(|reading| reading.page == name);
        let elsewhere = ELSEWHERE.iter().find(|(page, _)| page == name);
        assert!(reading.is_none() || elsewhere.is_none(), "{name} is listed twice");
        assert!(
            reading.is_some() || elsewhere.is_some() || page.blocks.is_empty(),
            "{name} has commands, and no test types them: {:?}",
            page.blocks.iter().map(Block::first_command).collect::<Vec<_>>()
        );
        assert!(elsewhere.is_none() || !page.blocks.is_empty(), "{name} has no commands any more");
        let Some(reading) = reading else { continue };
        assert!(!page.blocks.is_empty(), "{name} has no commands any more");
        for (first, reason) in reading.elsewhere {
            let found = page.blocks.iter().filter(|block| block.first_command().starts_with(first)).count();
            assert_eq!(found, 1, "{name}: blocks that begin with {first:?} ({reason})");
        }
        for (first, _) in reading.before {
            let found = page.blocks.iter().filter(|block| block.first_command().starts_with(first)).count();
            assert_eq!(found, 1, "{name}: blocks that begin with {first:?}");
        }
        for command in reading.until_interrupted {
            let mut steps = page.blocks.iter().flat_map(|block| &block.steps);
            assert!(steps.any(|step| step.command.starts_with(command)), "{name}: no command {command:?}");
        }
        for (word, _) in reading.words.iter().chain(reading.captures) {
            let steps = page.blocks.iter().flat_map(|block| &block.steps).map(|step| step.command.as_str());
            let before = reading.before.iter().flat_map(|(_, lines)| *lines).copied();
            assert!(steps.chain(before).any(|line| line.contains(word)), "{name}: no command has {word:?}");
        }
    }
    for page in READINGS.iter().map(|reading| reading.page).chain(ELSEWHERE.iter().map(|(page, _)| *page)) {
        assert!(names.contains(page), "there is no page {page}");
    }
}

#[test]
fn readme_has_three_screens() {
    // What a reader sees: no fences, no rules below the headings of tables.
    let text = Page::read("README.md").text;
    let lines = text.lines().filter(|line| !line.starts_with("```") && !line.starts_with("|--")).count();
    assert!(lines <= LINES_MAX, "README.md shows {lines} lines, and three screens have {LINES_MAX}");
}

/// Types the blocks of a page; the terminal afterwards.
fn typed(name: &str) -> Terminal {
    let reading: &Reading = READINGS.iter().find(|reading| reading.page == name).expect("a reading");
    let page = Page::read(name);
    let mut terminal = Terminal::open(reading, &page.files);
    for line in reading.given {
        terminal.given(line);
    }
    for block in &page.blocks {
        let first = block.first_command();
        if let Some((_, reason)) = reading.elsewhere.iter().find(|(begin, _)| first.starts_with(begin)) {
            println!("{name}: {}: {first}: {reason}", block.heading);
            continue;
        }
        for (_, lines) in reading.before.iter().filter(|(begin, _)| first.starts_with(begin)) {
            lines.iter().for_each(|line| terminal.given(line));
        }
        for step in &block.steps {
            terminal.run(&step.command, &step.printed);
        }
    }
    terminal.check_lasting();
    terminal.check();
    terminal
}

macro_rules! pages {
    ($($test:ident $page:literal)*) => {
        /// Pages that a test types.
        const TYPED: &[&str] = &[$($page),*];
        $(
            #[test]
            fn $test() {
                if network::isolated(&|| ()) {
                    typed($page);
                }
            }
        )*
    };
}

pages! {
    the_commands_of_readme_print_what_it_says "README.md"
    the_commands_of_the_first_chapter_print_what_it_says "docs/start.md"
    the_commands_of_the_page_about_clusters_work "docs/cluster.md"
    the_commands_of_the_page_about_robots_work "docs/robot.md"
    the_commands_of_the_page_about_conflicts_work "docs/conflict.md"
    the_commands_of_the_page_about_the_audit_work "docs/audit.md"
    the_commands_of_the_page_about_metrics_work "docs/metrics.md"
    the_commands_of_the_page_about_the_console_work "docs/console.md"
    the_commands_of_the_page_about_operations_work "docs/operations.md"
    the_commands_of_the_page_about_recordings_work "docs/record.md"
}

#[test]
fn each_reading_is_typed_by_a_test() {
    for reading in READINGS {
        let is_typed = TYPED.contains(&reading.page) || reading.page == POLICIES;
        assert!(is_typed, "no test types {}", reading.page);
    }
}

const POLICIES: &str = "docs/policies.md";

/// The page with the examples of policies, too, each with its cases.
#[test]
fn the_commands_and_examples_of_the_page_about_policies_work() {
    if !network::isolated(&|| ()) {
        return;
    }
    let mut terminal = typed(POLICIES);
    let text = Page::read(POLICIES).text;
    let examples: Vec<&str> = text.split("\n### ").skip(1).collect();
    assert_eq!(examples.len(), 12);
    for example in examples {
        let block = |language: &str| {
            let (_, rest) = example.split_once(&format!("```{language}\n")).expect("a block");
            rest.split_once("\n```").expect("its end").0
        };
        let policy = block("cedar");
        terminal.file("example.cedar", policy);
        terminal.file("cases.toml", block("toml"));
        let beside = policy.starts_with("// Beside the built-in policy");
        terminal.given(&format!(
            "ledgerctl policy test cases.toml --policy example.cedar{}",
            if beside { " --policy default.cedar" } else { "" }
        ));
        terminal.given("ledgerctl policy check example.cedar");
    }
}
