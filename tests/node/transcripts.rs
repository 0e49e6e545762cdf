//! The answers of `ledgerctl` to somebody who got something wrong, word for word: tests/transcripts/wrong_input.txt.
//!
//! The file is for reading. Each line `who$ ledgerctl …` is run as that person on one network for playing, in this
//! order. Below it stands its output, with its exit code if that is not 0. Words that differ from run to run have a
//! name in capitals. After a change of words: `LEDGERD_TRANSCRIPTS=write ./test node::transcripts`, then read
//! the difference.

use crate::support::programs::repository;
use crate::support::{Ctl, Dev};
use std::fs;
use std::path::PathBuf;

fn path() -> PathBuf {
    repository().join("tests/transcripts/wrong_input.txt")
}

/// A step of the transcript: the prompt line, and what is expected below it.
struct Step<'a> {
    line: &'a str,
    expected: String,
}

fn steps(text: &str) -> (String, Vec<Step<'_>>) {
    let (mut head, mut steps) = (String::new(), Vec::<Step<'_>>::new());
    for line in text.lines() {
        if line.contains("$ ledgerctl") {
            steps.push(Step { line, expected: String::new() });
        } else if let Some(step) = steps.last_mut() {
            step.expected.push_str(&format!("{line}\n"));
        } else {
            head.push_str(&format!("{line}\n"));
        }
    }
    (head, steps)
}

/// The words of a shell line; knows single quotes.
fn words(line: &str) -> Vec<String> {
    let (mut words, mut word, mut quoted) = (Vec::new(), None::<String>, false);
    for c in line.chars() {
        match c {
            '\'' => {
                quoted = !quoted;
                word.get_or_insert_default();
            }
            ' ' if !quoted => words.extend(word.take()),
            c => word.get_or_insert_default().push(c),
        }
    }
    words.extend(word);
    words
}

/// The text with names for what no two runs have in common: long hexadecimal numbers, dates, times.
fn steady(text: &str, names: &[(String, &str)]) -> String {
    let named = names.iter().fold(text.to_owned(), |text, (value, name)| text.replace(value, name));
    let mut out = String::new();
    for line in named.lines() {
        let words: Vec<_> = line.split(' ').map(steady_word).collect();
        let mut line = words.join(" ").replace("DATE TIME +00:00", "DATE").replace("DATE (NUMBER µs)", "DATE");
        // The codes stand below each other, as far right as the lengths of names and paths leave them.
        if let Some((message, code)) = line.rsplit_once("  [LGR-") {
            line = format!("{}  [LGR-{code}", message.trim_end());
        }
        // A node attests in blocks of its own, when it comes to it.
        if let Some((range, newest)) = line.rsplit_once("a height from 0 to ")
            && newest.parse::<u64>().is_ok()
        {
            line = format!("{range}a height from 0 to HEIGHT");
        }
        out.push_str(line.trim_end());
        out.push('\n');
    }
    out
}

fn steady_word(word: &str) -> String {
    let core = word.trim_matches(|c: char| !c.is_ascii_alphanumeric());
    let digits = core.chars().filter(char::is_ascii_digit).count();
    let name = if core.len() >= 32 && core.bytes().all(|b| b.is_ascii_hexdigit()) {
        "HASH"
    } else if digits >= 8 && (core.starts_with("20") || core.starts_with("19")) && core.contains('-') {
        "DATE"
    } else if digits >= 6
        && core.matches(':').count() == 2
        && core.chars().all(|c| c.is_ascii_digit() || ":.".contains(c))
    {
        "TIME"
    } else if digits >= 13 && digits == core.len() {
        "NUMBER"
    } else {
        return word.to_owned();
    };
    word.replace(core, name)
}

#[test]
fn what_is_said_to_wrong_input_is_what_somebody_has_read() {
    let dev = Dev::start();
    let salma = dev.user("Salma", &["Turtlebot4", "Husky"], "ed25519");
    let farhad = dev.user("Farhad", &["Turtlebot4"], "ed25519");
    let mallory = dev.user("Mallory", &[], "ed25519");
    let stranger = tempfile::tempdir().unwrap();
    let files = tempfile::tempdir().unwrap();
    fs::write(files.path().join("text.txt"), "linear: fast").unwrap();
    fs::write(files.path().join("large"), vec![0; 5 << 20]).unwrap();
    fs::create_dir(files.path().join("empty")).unwrap();
    let fingerprint = dev.fact("ca_fingerprint").to_owned();
    let who = |name: &str| match name {
        "salma" => salma.clone(),
        "farhad" => farhad.clone(),
        "mallory" => mallory.clone(),
        "admin" => dev.admin(),
        "owner" => dev.owner(),
        "nobody" => Ctl::at(stranger.path()),
        "here" => dev.ctl(),
        other => panic!("{other} takes no part"),
    };
    let names = [
        (dev.fact("address").to_owned(), "NODE"),
        (dev.fact("address").replace(':', " "), "NODE"),
        (fingerprint, "FINGERPRINT"),
        (dev.fact("network").to_owned(), "NETWORK"),
        (stranger.path().display().to_string(), "HOME"),
        (dev.home.path().display().to_string(), "HOME"),
        (files.path().display().to_string(), "FILES"),
    ];
    let wanted = fs::read_to_string(path()).unwrap();
    let (head, steps) = steps(&wanted);
    assert!(steps.len() >= 60, "{} kinds of wrong input", steps.len());
    let mut said = head;
    for Step { line, .. } in &steps {
        let (name, command) = line.split_once("$ ledgerctl").unwrap();
        let real = names.iter().fold(command.to_owned(), |text, (value, name)| text.replace(name, value));
        let ran = who(name).run(&words(&real));
        assert!(!ran.stderr.contains("panicked"), "{ran:?}");
        said.push_str(&format!("{line}\n"));
        said.push_str(&steady(&format!("{}{}", ran.stdout, ran.stderr), &names));
        if ran.code != 0 {
            said.push_str(&format!("[exit {}]\n", ran.code));
        }
        said.push('\n');
    }
    let said = format!("{}\n", said.trim_end());
    if std::env::var_os("LEDGERD_TRANSCRIPTS").is_some_and(|value| value == "write") {
        fs::write(path(), &said).unwrap();
        return;
    }
    let first = wanted.lines().zip(said.lines()).find(|(wanted, said)| wanted != said);
    assert!(wanted == said, "the first line that differs, as it stands and as it is said now: {first:#?}\n\n{said}");
}

#[test]
fn examples_of_the_help_name_functions_that_exist() {
    let dev = Dev::start();
    for command in ["invoke", "query"] {
        let help = dev.ctl().run(&[command, "--help"]).ok().stdout;
        let examples: Vec<_> = help.lines().filter(|line| line.trim_start().starts_with("ledgerctl ")).collect();
        assert!(examples.len() >= 2, "{help}");
        for example in examples {
            let call = words(example.trim());
            let said = dev.owner().run(&[command, &call[2], &call[3]]);
            for code in ["LGR-1009", "LGR-1010"] {
                assert!(!said.stderr.contains(code), "{example}: {said:?}");
            }
        }
    }
}

#[test]
fn a_full_standard_output_is_not_taken_for_the_nodes_disk() {
    let dev = Dev::start();
    let full = fs::File::options().write(true).open("/dev/full").unwrap();
    let done = dev.owner().command(&["robot", "list"]).stdout(full).output().unwrap();
    let said = String::from_utf8(done.stderr).unwrap();
    assert_eq!(done.status.code(), Some(3), "{said}");
    assert!(said.contains("standard output") && said.contains("LGR-7002") && !said.contains("node"), "{said}");
}
