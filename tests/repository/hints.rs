//! The commands that the programs tell people to type: each is one of `ledgerctl`.

use crate::sources::{code, files, product, read, root};
use std::collections::BTreeSet;

/// Words behind the name of the program that begin no command of the page: prose, and one that is hidden.
const OTHERS: [&str; 6] = ["and", "beside", "man", "show", "that", "warn"];

/// The commands in docs/commands.md, such as `acquire` and `identity crl`.
fn commands() -> BTreeSet<String> {
    let page = read(&root().join("docs/commands.md"));
    page.lines().filter_map(|line| Some(line.strip_prefix("### `ledgerctl ")?.strip_suffix('`')?.to_owned())).collect()
}

/// The code of a file, where a text that goes on in the next line is one line.
fn joined(source: &str) -> String {
    let lines = code(source).map(str::trim);
    lines.map(|line| line.strip_suffix('\\').map_or_else(|| format!("{line}\n"), str::to_owned)).collect()
}

/// The word at the beginning of a text.
fn word(text: &str) -> &str {
    text.split(|c: char| !(c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-')).next().unwrap_or_default()
}

/// The commands of a source that do not exist.
fn unknown(source: &str, commands: &BTreeSet<String>) -> Vec<String> {
    let source = joined(source);
    let typed = source.split("ledgerctl ").skip(1).filter_map(|typed| {
        let first = word(typed);
        let second = typed.strip_prefix(first)?.strip_prefix(' ').map_or("", word);
        let is_group = commands.iter().any(|known| known.starts_with(&format!("{first} ")));
        let below = is_group && second.starts_with(char::is_alphabetic);
        Some(if below { format!("{first} {second}") } else { first.to_owned() })
    });
    let is_command = |typed: &String| typed.starts_with(char::is_alphabetic) && !OTHERS.contains(&typed.as_str());
    typed.filter(is_command).filter(|typed| !commands.contains(typed)).collect()
}

#[test]
fn every_command_that_a_text_tells_people_to_type_exists() {
    let commands = commands();
    assert!(commands.contains("identity crl"), "the page has no commands");
    let mut found = Vec::new();
    for path in ["crates", "src"].iter().flat_map(|from| files(&root().join(from), ".rs")) {
        let unknown = unknown(&product(&path), &commands);
        found.extend(unknown.iter().map(|typed| format!("{}: ledgerctl {typed}", path.display())));
    }
    assert!(found.is_empty(), "{}", found.join("\n"));
}

#[test]
fn a_command_that_does_not_exist_is_found_also_where_its_text_goes_on_in_the_next_line() {
    let commands = BTreeSet::from(["acquire", "identity", "identity crl"].map(str::to_owned));
    let source = "\"ledgerctl acquire all; ledgerctl identity\"\n// ledgerctl no\n\"ledgerctl and ledgerctl identity {}\n\
                  ledgerctl \\\n  identity \\\n  list; ledgerctl crl; ledgerctl --version\"";
    assert_eq!(unknown(source, &commands), ["identity list", "crl"]);
}
