//! The promises of the documents.

use crate::pictures;
use crate::sources::{files, read, root};
use std::collections::BTreeSet;
use std::path::Path;
use std::process::Command;

/// Commands of the first block of shell in README.md: the main job and the tests.
fn readme_commands() -> Vec<String> {
    let readme = read(&root().join("README.md"));
    let block = readme.split_once("```sh\n").and_then(|(_, rest)| rest.split_once("\n```")).map(|(block, _)| block);
    block.unwrap_or_else(|| panic!("README.md has no block of shell")).lines().map(str::to_owned).collect()
}

#[test]
fn the_readme_starts_with_its_two_commands() {
    let commands = readme_commands();
    assert_eq!(commands.len(), 2, "{commands:?}");
    let run = read(&root().join(".ci/run"));
    for (command, line) in commands.iter().zip(["sed -n 1p", "sed -n 2p"]) {
        assert!(run.contains(line) && !run.contains(command.as_str()), ".ci/run takes {command:?} from the README");
    }
}

#[test]
fn the_first_command_of_the_readme_plays_the_experiment() {
    let commands = readme_commands();
    let command = commands.first().unwrap_or_else(|| panic!("README.md has no command"));
    // As it stands .ci/run plays it; here the program is the one of the tests, so that no other is built.
    assert_eq!(command, "cargo run --release -- demo");
    let played = Command::new(testkit::program("ledgerd"))
        .args(["demo", "--seconds", "3"])
        .output()
        .unwrap_or_else(|error| panic!("ledgerd does not start: {error}"));
    let (table, progress) = (String::from_utf8_lossy(&played.stdout), String::from_utf8_lossy(&played.stderr));
    assert!(played.status.success(), "{command}: {}\n{table}\n{progress}", played.status);
    for row in ["exclusive (Salma holds)", "open (both may)", "commit", "ROS to ROS", "NOT_HOLDER"] {
        assert!(table.contains(row), "no row {row:?} in\n{table}\n{progress}");
    }
    assert!(!table.contains("NO\n"), "something did not hold:\n{table}");
    // Whatever README says that it prints, numbers apart.
    let readme = read(&root().join("README.md"));
    let shown = readme.split_once("```text\n").and_then(|(_, rest)| rest.split_once("\n```")).map(|(shown, _)| shown);
    let printed: Vec<_> = progress.lines().chain(table.lines()).map(without_numbers).collect();
    let shown = shown.unwrap_or_else(|| panic!("README.md shows nothing of the demo"));
    let drawn = without_numbers(&pictures::texts(&read(&root().join("docs/pictures/demo.svg"))));
    // The picture ends before the latencies.
    for line in printed.iter().take_while(|line| !line.starts_with("latency")) {
        let why = "the demo prints other texts than its picture: draw it again with docs/pictures/draw.py demo";
        assert!(drawn.contains(line), "{why}: {line:?}\n{drawn}");
    }
    // The picture is drawn on a terminal only; a test beside it compares it with README.
    for line in
        shown.lines().filter(|line| !line.ends_with(" Hz") || line.contains("both may") || line.contains("holds"))
    {
        assert!(
            printed.contains(&without_numbers(line)),
            "README says that the demo prints {line:?}:\n{progress}\n{table}"
        );
    }
}

/// The words of a line, each number as one sign.
fn without_numbers(line: &str) -> String {
    let mut text = String::new();
    for c in line.split_whitespace().collect::<Vec<_>>().join(" ").chars() {
        match c.is_ascii_digit() || c == '.' {
            true if text.ends_with('#') => {}
            true => text.push('#'),
            false => text.push(c),
        }
    }
    text
}

#[test]
fn links_lead_somewhere() {
    for path in files(root(), ".md") {
        let text = without_code(&read(&path));
        let directory = path.parent().unwrap_or(root());
        for link in text.split("](").skip(1).filter_map(|rest| rest.split_once(')')).map(|(link, _)| link) {
            let (file, anchor) = link.split_once('#').unwrap_or((link, ""));
            if file.contains("://") {
                continue;
            }
            let target = if file.is_empty() { path.clone() } else { directory.join(Path::new(file)) };
            let there = target.exists() && (anchor.is_empty() || anchors(&read(&target)).contains(anchor));
            assert!(there, "{} links to {link}, which is not there", path.display());
        }
    }
}

/// A document without its blocks of code, in which brackets are no links.
fn without_code(text: &str) -> String {
    let mut code = false;
    let is_shown = |line: &&str| {
        let fence = line.trim_start().starts_with("```");
        code ^= fence;
        !code && !fence
    };
    text.lines().filter(is_shown).collect::<Vec<_>>().join("\n")
}

/// The headings of a document as the links to them name them.
fn anchors(text: &str) -> BTreeSet<String> {
    let headings = text.lines().filter(|line| line.starts_with('#')).map(|line| line.trim_start_matches('#').trim());
    let kept = |c: char| c.is_alphanumeric() || c == '-' || c == '_';
    headings.map(|heading| heading.to_lowercase().replace(' ', "-").chars().filter(|c| kept(*c)).collect()).collect()
}
