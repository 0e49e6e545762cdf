//! docs/output.md against the JSON that `ledgerctl` prints. Every command of that page is run. Each printed field is documented,
//! and each documented field was printed, unless it stands there with a `?`.
//!
//! After a change: `LEDGERD_TRANSCRIPTS=write cargo test --test node output` writes the lists of fields anew, then read the
//! difference; names in the table of meanings are written by hand.

use crate::support::{Ctl, Dev, Process, eventually};
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::PathBuf;

/// The fields that were printed, by command.
type Printed = BTreeMap<String, BTreeSet<String>>;

/// The fields below which stands what others wrote.
const FOREIGN: [&str; 4] = ["message", "payload", "response", "feedback"];
/// Objects whose keys are names, not fields: attributes, counts by code.
const KEYED: [&str; 4] = ["attributes", "refused", "executed", "required"];

fn path() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("docs/output.md")
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

/// The people of the story.
struct Story {
    dev: Dev,
    printed: Printed,
}

impl Story {
    /// Runs a command, whose first words are its name; it may end with any exit code, and prints JSON.
    fn run(&mut self, ctl: &Ctl, name: &str, rest: &[&str]) -> Value {
        let words: Vec<&str> = name.split(' ').chain(rest.iter().copied()).chain(["-o", "json"]).collect();
        let ran = ctl.run(&words);
        let told: Vec<Value> = ran
            .stdout
            .lines()
            .map(|line| serde_json::from_str(line).unwrap_or_else(|error| panic!("{error}: {ran:?}")))
            .collect();
        assert!(!told.is_empty(), "{words:?} prints nothing: {ran:?}");
        let found = self.printed.entry(name.to_owned()).or_default();
        told.iter().for_each(|value| fields(value, "", found));
        told.into_iter().next_back().unwrap_or_default()
    }
}

impl Story {
    /// A grant goes from one person to another one and back.
    fn passes_on(&mut self, (owner, salma, farhad): (&Ctl, &Ctl, &Ctl), service: &str) {
        owner.run(&["robot", "set", service, "delegable=true"]).ok();
        self.run(salma, "acquire", &[service]);
        self.run(salma, "delegate", &[service, "--to", "Org1/Farhad", "--for", "30s"]);
        self.run(salma, "recall", &[service]);
        self.run(salma, "handover", &[service, "--to", "Org1/Farhad"]);
        self.run(farhad, "release", &[service]);
    }

    /// Tasks of one person, which end in all ways.
    fn traverses(&mut self, salma: &Ctl, robot: &str) {
        let points = [robot, "--points", "1,0;1,-2.5"];
        let submitted = |told: &Value| told["task"]["id"].to_string();
        let first = submitted(&self.run(salma, "task submit", &points));
        self.run(salma, "task show", &[&first]);
        self.run(salma, "task progress", &[&first, "1"]);
        self.run(salma, "task list", &[]);
        self.run(salma, "task fail", &[&first, "--reason", "demo"]);
        let second = submitted(&self.run(salma, "task submit", &points));
        self.run(salma, "task cancel", &[&second]);
    }

    /// Sets of policies of an organisation with one admin.
    fn decides_about_sets(&mut self, owner: &Ctl, [night, day]: [&str; 2]) {
        self.run(owner, "policy apply", &[night, "-m", "demo"]);
        let version = self.run(owner, "policy apply", &[day, "-m", "demo"])["version"].as_u64().unwrap();
        self.run(owner, "policy rollback", &[&(version - 1).to_string(), "-m", "demo"]);
        self.run(owner, "policy approvals", &[]);
        let proposed = self.run(owner, "policy propose", &[day, "-m", "demo"]);
        self.run(owner, "policy withdraw", &[proposed["id"].as_str().unwrap()]);
    }

    /// A newcomer, contexts, a browser, invitations, a proposal and a copy of the CA.
    fn enrols_and_governs(&mut self, admin: &Ctl, [copy, passphrase]: [&str; 2]) {
        let invited = self.run(admin, "identity register", &["Nadia", "--attr", "Husky"]);
        let field = |name: &str| invited[name].as_str().unwrap().to_owned();
        let (node, ca, secret) = (field("node"), field("ca_fingerprint"), field("secret"));
        let alone = self.dev.ctl();
        self.run(&alone, "enroll", &["Nadia", "--node", &node, "--ca-fingerprint", &ca, "--secret", &secret]);
        self.run(&alone, "context use", &["Nadia"]);
        self.run(&alone, "context delete", &["Nadia"]);
        self.run(admin, "console", &["Tablet", "--role", "member", "--attr", "Husky"]);
        self.run(admin, "identity registrar", &["Farhad", "--affiliation", "sales", "--attr", "Husky"]);
        self.run(admin, "network invite", &["--node", "node2"]);
        let proposed = self.run(admin, "network propose", &["msp", "remove_organisation", r#"{"name":"Org2"}"#]);
        self.run(admin, "network withdraw", &[proposed["proposal"]["id"].as_str().unwrap()]);
        self.run(admin, "ca backup", &[copy, "--passphrase-file", passphrase]);
    }
}

/// Plays a story in which every command prints its JSON.
fn played() -> Story {
    let dev = Dev::start();
    let salma = dev.user("Salma", &["Turtlebot4", "Husky"], "ed25519");
    let farhad = dev.user("Farhad", &["Turtlebot4"], "ed25519");
    let (admin, owner) = (dev.admin(), dev.owner());
    let files = tempfile::tempdir().unwrap();
    let file = |name: &str, text: &str| {
        let path = files.path().join(name);
        fs::write(&path, text).unwrap();
        path.to_string_lossy().into_owned()
    };
    let mut story = Story { dev, printed: Printed::new() };
    let it = &mut story;
    for name in ["whoami", "context list", "context show", "context refresh", "status", "doctor"] {
        it.run(&salma, name, &[]);
    }
    it.run(&salma, "explain", &["HELD"]);
    it.run(&salma, "context set", &["Salma", "renew=auto"]);
    let invited = it.run(&admin, "identity register", &["Guest", "--attr", "Husky"]);
    for (name, rest) in [
        ("identity list", &[][..]),
        ("identity show", &["Salma"]),
        ("identity cancel", &["Guest"]),
        ("ca status", &[]),
        ("network status", &[]),
        ("network nodes", &[]),
        ("network organisations", &[]),
        ("network proposals", &[]),
        ("network quorums", &[]),
        ("network rules", &[]),
    ] {
        it.run(&admin, name, rest);
    }
    assert!(invited["secret"].is_string(), "{invited}");
    let spec = ["Spot", "--attr-required", "Husky", "--service", "/cmd_vel=geometry_msgs/msg/Twist,on-conflict=queue"];
    it.run(&owner, "robot add", &spec);
    it.run(&owner, "robot set", &["Spot/cmd_vel", "lease=30s"]);
    it.run(&owner, "robot list", &[]);
    let service = "Turtlebot4/cmd_vel";
    it.run(&salma, "acquire", &[service, "--for", "30s"]);
    it.run(&salma, "renew", &[service]);
    it.run(&salma, "publish", &[service, "{linear: {x: 0.1}}"]);
    it.run(&salma, "echo", &[service, "--from", "1", "--count", "1"]);
    it.run(&owner, "history", &[service, "--since", "10m"]);
    it.run(&salma, "robot show", &["Turtlebot4"]);
    it.run(&salma, "queue", &[service]);
    it.run(&salma, "readers", &[service]);
    it.run(&salma, "release", &[service]);
    it.run(&owner, "take", &[service, "--reason", "demo"]);
    let stopped = it.run(&owner, "stop", &["Turtlebot4", "--reason", "demo"]);
    it.run(&owner, "resume", &["Turtlebot4"]);
    it.run(&owner, "robot remove", &["OptiTrack"]);
    let transaction = stopped["transaction"].as_str().unwrap().to_owned();
    it.run(&owner, "tx", &[&transaction]);
    it.run(&owner, "block", &[&stopped["height"].to_string()]);
    it.run(&owner, "audit", &[]);
    farhad.run(&["acquire", "Husky/cmd_vel"]).refused(2, &[]);
    it.run(&owner, "denials", &[]);
    it.run(&owner, "can", &["Org1/Farhad", "acquire", "Husky/cmd_vel"]);
    let night = file("night.cedar", "permit(principal, action, resource);");
    it.run(&owner, "policy check", &[&night]);
    it.run(&owner, "policy put", &["night", &format!("@{night}")]);
    it.run(&owner, "policy list", &[]);
    it.run(&owner, "policy show", &["night"]);
    it.run(&owner, "policy diff", &[&night]);
    it.run(&owner, "policy shadow", &[&night]);
    it.run(&owner, "policy history", &[]);
    it.run(&owner, "policy remove", &["night"]);
    it.run(&owner, "policy proposals", &[]);
    it.run(&salma, "invoke", &["abac", "acquire", service]);
    it.run(&salma, "query", &["abac", "robot", "Husky"]);
    it.run(&salma, "release", &[service]);
    it.passes_on((&owner, &salma, &farhad), service);
    it.traverses(&salma, "Turtlebot4");
    it.decides_about_sets(
        &owner,
        [&night, &file("day.cedar", "@description(\"by day\") permit(principal, action, resource);")],
    );
    let cases =
        "[[case]]\nwho = \"Org2/Admin\"\naction = \"acquire\"\nservice = \"Husky/cmd_vel\"\nexpect = \"allow\"\n";
    it.run(&owner, "policy test", &[&file("cases.toml", cases)]);
    let copy = files.path().join("ca.pem").to_string_lossy().into_owned();
    it.enrols_and_governs(&admin, [&copy, &file("passphrase", "correct horse battery\n")]);
    let [evidence, genesis] = ["stop.evidence", "genesis.json"].map(|name| files.path().join(name));
    let [evidence, genesis] = [&evidence, &genesis].map(|path| path.to_string_lossy());
    it.run(&owner, "prove", &[&transaction, "--file", &evidence, "--genesis", &genesis]);
    it.run(&owner, "light", &["Turtlebot4"]);
    let data = it.dev.data().to_string_lossy().into_owned();
    it.run(&owner, "ledger archive", &[&data, "--to", &files.path().join("archive").to_string_lossy()]);
    it.run(&admin, "identity revoke", &["Farhad"]);
    let mut watch = Process::start("watch", story.dev.home.path(), story.dev.owner().command(&["watch", "-o", "json"]));
    let line = eventually("watch prints a row", || {
        story.dev.owner().run(&["stop", "Husky"]).ok();
        story.dev.owner().run(&["resume", "Husky"]).ok();
        watch.stdout().split_once('\n').map(|(line, _)| line.to_owned())
    });
    watch.interrupt();
    fields(&serde_json::from_str(&line).unwrap(), "", story.printed.entry("watch".to_owned()).or_default());
    story
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
fn written(text: &str, printed: &Printed) -> String {
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
    let story = played();
    let mut text = fs::read_to_string(path()).unwrap();
    if std::env::var_os("LEDGERD_TRANSCRIPTS").is_some_and(|what| what == "write") {
        text = written(&text, &story.printed);
        fs::write(path(), &text).unwrap();
    }
    let documented = documented(&text);
    let mut faults = Vec::new();
    for (name, printed) in &story.printed {
        let known = documented.get(name).cloned().unwrap_or_default();
        let names: BTreeSet<&str> = known.iter().map(|field| field.trim_end_matches('?')).collect();
        faults.extend(
            printed.iter().filter(|f| !names.contains(f.as_str())).map(|f| format!("{name} prints {f}: undocumented")),
        );
        let missing = known.iter().filter(|field| !field.ends_with('?') && !printed.contains(*field));
        faults.extend(missing.map(|field| format!("{name} does not print {field}, which is documented")));
    }
    faults.extend(
        documented.keys().filter(|name| !story.printed.contains_key(*name)).map(|name| format!("{name} was not run")),
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
        let is_known = documented.keys().any(|known| known.replace(' ', "-") == name);
        let is_told = text.replace(' ', "-").contains(&format!("`{name}`"));
        if !is_group && !is_known && !is_told && !name.starts_with("help") && !name.contains("-help") {
            missing.push(name);
        }
    }
    missing.sort();
    assert!(missing.is_empty(), "{missing:?}");
}
