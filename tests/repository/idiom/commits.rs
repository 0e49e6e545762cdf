//! The subjects of commits follow the same rules, since the commit at which these began.

use super::matching;
use crate::sources::root;
use crate::words::Paragraph;
use std::process::Command;

/// Commits after this one are checked.
const SINCE: &str = "ea1033fa656f791ff5346b0740e31709f06edba6";

/// Subjects that stay as they are, with the reason: history is not rewritten.
const WAIVERS: &[(&str, &str)] = &[];

/// The output of git, or none if git or the commit is not there.
fn git(arguments: &[&str]) -> Option<String> {
    let ran = Command::new("git").args(arguments).current_dir(root()).output().ok()?;
    ran.status.success().then(|| String::from_utf8_lossy(&ran.stdout).into_owned())
}

/// The faults of the subjects in the output of `git log --format=%h %s`.
fn faults(log: &str) -> Vec<String> {
    let mut faults = Vec::new();
    for (commit, subject) in log.lines().filter_map(|line| line.split_once(' ')) {
        let paragraph = Paragraph { line: 1, text: subject.to_owned() };
        if !WAIVERS.iter().any(|(waived, _)| *waived == subject) {
            faults.extend(matching::hits(&[paragraph]).iter().map(|hit| hit.shown(commit)));
        }
    }
    faults
}

#[test]
#[expect(clippy::print_stdout, reason = "the pool counts skipped tests by this line")]
fn the_subjects_of_commits_are_free_of_these_phrases() {
    if git(&["merge-base", "--is-ancestor", SINCE, "HEAD"]).is_none() {
        println!("skipped: the history of this clone does not reach {SINCE}");
        return;
    }
    let range = format!("{SINCE}..HEAD");
    let log = git(&["log", "--no-merges", "--format=%h %s", &range]).unwrap_or_else(|| panic!("git log fails"));
    let faults = faults(&log);
    assert!(faults.is_empty(), "amend these subjects, or add a waiver:\n{}", faults.join("\n"));
}

#[test]
fn a_subject_with_a_phrase_is_found() {
    let log = "abc1234 A node is told its height\ndef5678 Reject a revocation list that removes a revocation\n";
    let found = faults(log);
    assert!(matches!(found.as_slice(), [fault] if fault.starts_with("abc1234:1: \"told\"")), "{found:?}");
}
