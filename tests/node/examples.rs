//! The examples in the help of `ledgerctl`, each run in a shell on a network for playing. Not each can succeed there: some name people,
//! files and proposals that are not there. But each is understood, and what is refused is refused in four parts.

use crate::support::{Dev, programs};
use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};

/// Commands that go on until somebody ends them have so many seconds.
const SECONDS_MAX: &str = "3";
/// The exit code of `timeout`.
const ENDED: i32 = 124;
/// The exit codes of `ledgerctl`, without that of a command line that is not understood.
const EXIT_CODES: [i32; 7] = [0, 1, 2, 3, 4, 5, ENDED];

/// The lines of help behind a heading.
fn section<'a>(help: &'a str, heading: &str) -> Vec<&'a str> {
    let behind = help.split_once(&format!("{heading}\n")).map_or("", |(_, behind)| behind);
    behind.lines().take_while(|line| line.starts_with("  ")).map(str::trim).collect()
}

fn help(words: &[String]) -> String {
    let told = Command::new(programs::ledgerctl()).args(words).arg("--help").output().unwrap();
    assert!(told.status.success(), "{words:?}");
    String::from_utf8(told.stdout).unwrap()
}

/// The examples of a command and of those below it.
fn examples(words: &[String], found: &mut Vec<String>) {
    let help = help(words);
    found.extend(
        section(&help, "Example:").into_iter().filter(|line| line.starts_with("ledgerctl ")).map(str::to_owned),
    );
    // The second column is what a command is about.
    for line in section(&help, "Commands:") {
        let name = line.split("  ").next().unwrap_or_default().to_owned();
        if name != "help" && !name.is_empty() && !name.contains(' ') {
            examples(&[words, &[name]].concat(), found);
        }
    }
}

/// Runs a line of shell; the exit code, and what was said on standard error.
fn run(dev: &Dev, line: &str, directory: &Path) -> (i32, String) {
    let tools = programs::ledgerctl().parent().unwrap().to_owned();
    let path = format!("{}:{}", tools.display(), std::env::var("PATH").unwrap());
    let done = Command::new("timeout")
        .args([SECONDS_MAX, "bash", "-c", &format!("set -o pipefail; {line}")])
        .current_dir(directory)
        .env("PATH", path)
        .env("HOME", directory)
        .env("LEDGERD_HOME", dev.home.path())
        .env("LEDGERCTL_CONTEXT", "dev-org2-admin")
        .stdin(Stdio::null())
        .output()
        .unwrap();
    (done.status.code().unwrap_or(-1), String::from_utf8_lossy(&done.stderr).into_owned())
}

#[test]
fn every_example_of_every_help_is_understood_where_it_is_typed() {
    let dev = Dev::start();
    dev.user("Salma", &["Turtlebot4", "Husky"], "ed25519");
    let directory = tempfile::tempdir().unwrap();
    for name in ["night.cedar", "guests.cedar"] {
        fs::write(directory.path().join(name), "permit(principal, action, resource);").unwrap();
    }
    for name in [".local/share/bash-completion/completions", ".zfunc", ".config/fish/completions", "man1"] {
        fs::create_dir_all(directory.path().join(name)).unwrap();
    }
    let mut found = Vec::new();
    examples(&[], &mut found);
    assert!(found.len() > 80, "{found:?}");
    let mut succeeded = 0;
    for line in &found {
        let (code, said) = run(&dev, line, directory.path());
        assert!(EXIT_CODES.contains(&code) && !said.contains("panicked"), "{line}: {code}\n{said}");
        let is_refused = said.lines().any(|line| line.starts_with("error: "));
        assert!(!is_refused || said.contains("[LGR-"), "{line}: {said}");
        succeeded += usize::from(code == 0);
    }
    assert!(succeeded > found.len() / 3, "only {succeeded} of {} succeed", found.len());
}
