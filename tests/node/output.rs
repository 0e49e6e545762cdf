//! docs/output.md against the JSON that `ledgerctl` prints. Every command of that page is run. Each printed field is documented,
//! and each documented field was printed, unless it stands there with a `?`.
//!
//! After a change: `LEDGERD_TRANSCRIPTS=write ./test node::output` writes the lists of fields anew, then read the
//! difference; names in the table of meanings are written by hand.

mod alone;
mod together;

use crate::own_network;
use crate::support::Ctl;
use crate::support::programs::repository;
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::PathBuf;

/// The fields that were printed, by command.
#[derive(Default)]
struct Printed(BTreeMap<String, BTreeSet<String>>);

/// The fields below which stands what others wrote.
const FOREIGN: [&str; 4] = ["message", "payload", "response", "feedback"];
/// Objects whose keys are names, not fields: attributes, counts by code.
const KEYED: [&str; 4] = ["attributes", "refused", "executed", "required"];

fn path() -> PathBuf {
    repository().join("docs/output.md")
}

/// The paths of all fields of a value.
fn fields(value: &Value, at: &str, found: &mut BTreeSet<String>) {
    match value {
        Value::Array(values) => values.iter().for_each(|value| fields(value, &format!("{at}[]"), found)),
        Value::Object(object) => {
            for (name, value) in object {
                let path = if at.is_empty() { name.clone() } else { format!("{at}.{name}") };
                found.insert(path.clone());
                if !FOREIGN.contains(&name.as_str()) && !KEYED.contains(&name.as_str()) {
                    fields(value, &path, found);
                }
            }
        }
        _ => {}
    }
}

impl Printed {
    /// Runs a command, whose first words are its name; it may end with any exit code, and prints JSON. A name in capitals stands
    /// for one of `rest`.
    fn run(&mut self, ctl: &Ctl, name: &str, rest: &[&str]) -> Value {
        let typed = name.split(' ').filter(|word| !word.chars().all(|letter| letter.is_ascii_uppercase()));
        let words: Vec<&str> = typed.chain(rest.iter().copied()).chain(["-o", "json"]).collect();
        let ran = ctl.run(&words);
        let told: Vec<Value> = ran
            .stdout
            .lines()
            .map(|line| serde_json::from_str(line).unwrap_or_else(|error| panic!("{error}: {ran:?}")))
            .collect();
        assert!(!told.is_empty(), "{words:?} prints nothing: {ran:?}");
        told.iter().for_each(|value| self.note(name, value));
        told.into_iter().next_back().unwrap_or_default()
    }

    /// A command has printed this.
    fn note(&mut self, name: &str, value: &Value) {
        fields(value, "", self.0.entry(name.to_owned()).or_default());
    }
}

/// The commands of the page with their fields: `name: field, field?`.
fn documented(text: &str) -> BTreeMap<String, Vec<String>> {
    let block =
        text.split_once("```text\n").and_then(|(_, rest)| rest.split_once("\n```")).map_or("", |(block, _)| block);
    let line = |line: &str| {
        let (name, fields) = line.split_once(": ")?;
        Some((name.to_owned(), fields.split_whitespace().map(str::to_owned).collect()))
    };
    block.lines().filter_map(line).collect()
}

/// The names that the table of the page explains.
fn explained(text: &str) -> BTreeSet<String> {
    let rows = text.lines().filter_map(|line| line.strip_prefix("| ")?.split_once(" | "));
    rows.flat_map(|(names, _)| names.split('`').skip(1).step_by(2).map(str::to_owned).collect::<Vec<_>>()).collect()
}

/// The page with the fields that were printed; those that were there and were not printed now have a `?`.
fn written(text: &str, printed: &BTreeMap<String, BTreeSet<String>>) -> String {
    let before = documented(text);
    let mut lines = Vec::new();
    for name in before.keys().chain(printed.keys()).collect::<BTreeSet<_>>() {
        let now = printed.get(name).cloned().unwrap_or_default();
        let mut all: BTreeSet<String> = now.clone();
        all.extend(before.get(name).into_iter().flatten().map(|field| field.trim_end_matches('?').to_owned()));
        let optional = |field: &String| {
            let was = before.get(name).is_some_and(|fields| fields.contains(&format!("{field}?")));
            if was || !now.contains(field) { format!("{field}?") } else { field.clone() }
        };
        lines.push(format!("{name}: {}", all.iter().map(optional).collect::<Vec<_>>().join(" ")));
    }
    let (head, rest) = text.split_once("```text\n").unwrap();
    let (_, foot) = rest.split_once("\n```").unwrap();
    format!("{head}```text\n{}\n```{foot}", lines.join("\n"))
}

#[test]
fn the_json_of_every_command_is_the_documented_one() {
    // A replay would reach the robots of other tests.
    if !own_network::isolated(&|| ()) {
        return;
    }
    let mut printed = Printed::default();
    alone::play(&mut printed);
    together::play(&mut printed);
    let Printed(printed) = printed;
    let mut text = fs::read_to_string(path()).unwrap();
    if std::env::var_os("LEDGERD_TRANSCRIPTS").is_some_and(|what| what == "write") {
        text = written(&text, &printed);
        fs::write(path(), &text).unwrap();
    }
    let documented = documented(&text);
    let mut faults = Vec::new();
    for (name, printed) in &printed {
        let known = documented.get(name).cloned().unwrap_or_default();
        let names: BTreeSet<&str> = known.iter().map(|field| field.trim_end_matches('?')).collect();
        faults.extend(
            printed.iter().filter(|f| !names.contains(f.as_str())).map(|f| format!("{name} prints {f}: undocumented")),
        );
        let missing = known.iter().filter(|field| !field.ends_with('?') && !printed.contains(*field));
        faults.extend(missing.map(|field| format!("{name} does not print {field}, which is documented")));
    }
    faults.extend(
        documented.keys().filter(|name| !printed.contains_key(*name)).map(|name| format!("{name} was not run")),
    );
    let explained = explained(&text);
    let names: BTreeSet<String> = documented
        .values()
        .flatten()
        .filter_map(|path| path.trim_end_matches('?').trim_end_matches("[]").rsplit('.').next().map(str::to_owned))
        .collect();
    let meant =
        |name: &str| explained.contains(name) || name.strip_suffix("_utc").is_some_and(|name| explained.contains(name));
    faults.extend(names.iter().filter(|name| !meant(name)).map(|name| format!("{name} is not explained")));
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

/// The command in a name, with hyphens between its words: without options and arguments.
fn command(name: &str) -> String {
    let words = name.split(' ').filter(|word| word.starts_with(|letter: char| letter.is_ascii_lowercase()));
    words.collect::<Vec<_>>().join("-")
}

#[test]
fn every_command_prints_documented_json_or_is_said_to_print_none() {
    let text = fs::read_to_string(path()).unwrap();
    let documented = documented(&text);
    let pages = tempfile::tempdir().unwrap();
    Ctl::at(pages.path()).run(&["man", &pages.path().to_string_lossy()]).ok();
    let mut missing = Vec::new();
    for page in fs::read_dir(pages.path()).unwrap() {
        let page = page.unwrap().path();
        let Some(name) = page.file_stem().and_then(|name| name.to_str()?.strip_prefix("ledgerctl-").map(str::to_owned))
        else {
            continue;
        };
        let is_group = fs::read_to_string(&page).unwrap().contains(".SH SUBCOMMANDS");
        // Words of a name have hyphens between them, as commands and subcommands have.
        let is_known = documented.keys().any(|known| command(known) == name);
        let is_told = text.replace(' ', "-").contains(&format!("`{name}`"));
        if !is_group && !is_known && !is_told && !name.starts_with("help") && !name.contains("-help") {
            missing.push(name);
        }
    }
    missing.sort();
    assert!(missing.is_empty(), "{missing:?}");
}
