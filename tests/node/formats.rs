//! Files of earlier releases are opened by this one: a data directory, a backup of it, a copy of its CA.
//!
//! `tests/fixtures/formats/NAME.tar.gz` is what a node of that release left, with its `expected.json`. None is changed once that
//! release is out: until then its rules of execution may change. It is made by `STORE_FORMATS=NAME` and this test, with that
//! release's program.

use crate::own_network::isolated;
use crate::support::ctl::verify;
use crate::support::programs::{self, ran, repository};
use crate::support::readme::Terminal;
use crate::support::{Ctl, eventually};
use serde_json::{Value, json};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use tempfile::TempDir;

const PASSPHRASE: &str = "five words that nobody guesses";
const RUN: &str = "ledgerd run --config ledgerd.toml";
/// Certificates that outlive this test, a port of its own network, small files.
const CONFIG: &str = "listen = \"127.0.0.1:7450\"\n[storage]\nsegment_mib = 1\n[ca]\ncertificate_days = 3650\n";

fn fixtures() -> PathBuf {
    repository().join("tests/fixtures/formats")
}

fn ledgerd(directory: &Path, arguments: &[&str]) -> std::process::Output {
    let mut command = programs::node();
    command.args(arguments).current_dir(directory).env("LEDGERD_PASSPHRASE", PASSPHRASE);
    ran(command.stdin(Stdio::null()))
}

fn status(ctl: &Ctl) -> Value {
    eventually("the node answers", || {
        let answered = ctl.run(&["status", "-o", "json"]);
        (answered.code == 0 || answered.code == 1).then(|| answered.json())
    })
}

/// Salma sends a command.
fn drive(terminal: &Terminal) {
    Ctl::at(&terminal.home()).as_("Salma").publish(&["Turtlebot4/cmd_vel", "{linear: {x: 0.5}}"]).ok();
}

/// A network of one node with a robot, a person and some commands, everything in this directory.
fn make(directory: &Path) {
    fs::write(directory.join("ledgerd.toml"), CONFIG).unwrap();
    let mut terminal = Terminal::at(directory);
    terminal.type_line("ledgerd init --organisation Org1 --label formats --address 127.0.0.1:7450");
    terminal.start(RUN);
    terminal.type_line("ledgerctl enroll admin --node 127.0.0.1:7450 --ca-fingerprint FINGERPRINT --secret SECRET");
    terminal.type_line("ledgerctl robot add Turtlebot4 --attr-required Turtlebot4 --service /cmd_vel=geometry_msgs/msg/Twist,mode=exclusive");
    terminal.type_line("ledgerctl identity register Salma --attr Turtlebot4");
    terminal.type_line("ledgerctl enroll Salma --node 127.0.0.1:7450 --ca-fingerprint FINGERPRINT --secret SECRET");
    terminal.type_line("ledgerctl --context Salma acquire Turtlebot4 --for 10m");
    for _ in 0..5 {
        drive(&terminal);
    }
    let admin = Ctl::at(&terminal.home()).as_("admin");
    let height = status(&admin)["height"].as_u64().unwrap();
    eventually("the backup has it", || {
        ledgerd(directory, &["backup", "backup"]);
        let manifest: Value = serde_json::from_slice(&fs::read(directory.join("backup/backup.json")).unwrap()).unwrap();
        (manifest["height"].as_u64().unwrap() >= height).then_some(())
    });
    ledgerd(directory, &["ca", "backup", "ca.pem"]);
    terminal.process(RUN).interrupt();
    let report = verify(&directory.join("data")).ok().json();
    let expected = json!({ "height": report["height"], "block_hash": report["block_hash"], "state_digest": report["state_digest"] });
    fs::write(directory.join("expected.json"), expected.to_string()).unwrap();
}

fn store(name: &str) {
    let directory = TempDir::new().unwrap();
    make(directory.path());
    fs::create_dir_all(fixtures()).unwrap();
    let target = fixtures().join(format!("{name}.tar.gz"));
    let parts = ["expected.json", "ledgerd.toml", "data", "backup", "ca.pem", "home"];
    ran(Command::new("tar").arg("-czf").arg(target).arg("-C").arg(directory.path()).args(parts));
}

/// Opens everything of one fixture.
fn open(fixture: &Path) {
    let directory = TempDir::new().unwrap();
    let place = directory.path();
    ran(Command::new("tar").arg("-xzf").arg(fixture).arg("-C").arg(place).arg("--no-same-owner"));
    let expected: Value = serde_json::from_slice(&fs::read(place.join("expected.json")).unwrap()).unwrap();
    let report = verify(&place.join("data")).ok().json();
    for field in ["height", "block_hash", "state_digest"] {
        assert_eq!(report[field], expected[field], "{field} of {}", fixture.display());
    }
    verify(&place.join("backup")).ok();

    let mut terminal = Terminal::at(place);
    terminal.start(RUN);
    let admin = Ctl::at(&terminal.home()).as_("admin");
    let shown = status(&admin);
    assert!(shown["height"].as_u64() >= expected["height"].as_u64(), "{shown}");
    terminal.type_line("ledgerctl --context Salma acquire Turtlebot4");
    drive(&terminal);
    ledgerd(place, &["backup", "another"]);
    ledgerd(place, &["backup", "backup"]);
    terminal.process(RUN).interrupt();
    verify(&place.join("data")).ok();

    // From the backup and the copy of the CA alone.
    fs::remove_dir_all(place.join("data")).unwrap();
    ledgerd(place, &["restore", "backup"]);
    ledgerd(place, &["ca", "restore", "ca.pem"]);
    ledgerd(place, &["recover", "--force-single", "--confirm", "formats"]);
    terminal.start(RUN);
    status(&admin);
    terminal.type_line("ledgerctl identity register Farhad");
    terminal.type_line("ledgerctl enroll Farhad --node 127.0.0.1:7450 --ca-fingerprint FINGERPRINT --secret SECRET");
    terminal.process(RUN).interrupt();
}

#[test]
fn what_earlier_releases_wrote_is_verified_run_and_restored_by_this_one() {
    if !isolated(&|| ()) {
        return;
    }
    if let Ok(name) = std::env::var("STORE_FORMATS") {
        return store(&name);
    }
    let mut found: Vec<_> = fs::read_dir(fixtures()).unwrap().map(|entry| entry.unwrap().path()).collect();
    found.sort();
    assert!(!found.is_empty(), "there is a fixture for each release, and one for the time before");
    found.iter().for_each(|fixture| open(fixture));
}
