//! The packages of a real ROS 2 as judges: their definitions, their hashes of types, rclpy, and PyYAML.
#![expect(clippy::indexing_slicing, clippy::panic, clippy::print_stdout, clippy::unwrap_used, reason = "tests")]

use proptest::prelude::{Strategy, any};
use proptest::strategy::ValueTree;
use proptest::test_runner::TestRunner;
use ros_message::{ByteOrder, Library, Message, Time, Written};
use serde_json::Value;
use std::collections::BTreeMap;
use std::env;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use testkit::rclpy;

/// The Python of a ROS 2; says why the test is skipped, if there is none.
fn python() -> Option<PathBuf> {
    let named = env::var_os("LEDGERD_TEST_RCLPY");
    rclpy::is_there().then(|| rclpy::interpreter(rclpy::is_sourced(), named)).flatten().map(PathBuf::from)
}

/// The directories that have `share/PACKAGE`.
fn prefixes(python: &Path) -> Vec<PathBuf> {
    match env::var_os("AMENT_PREFIX_PATH").filter(|_| rclpy::is_sourced()) {
        Some(paths) => env::split_paths(&paths).collect(),
        None => python.ancestors().nth(2).map(Path::to_owned).into_iter().collect(),
    }
}

/// The files of `share/PACKAGE/{msg,srv,action}` with this ending, or with that of their folder.
fn files(prefixes: &[PathBuf], ending: Option<&str>) -> Vec<PathBuf> {
    let entries = |path: &Path| -> Vec<PathBuf> {
        std::fs::read_dir(path).into_iter().flatten().map(|entry| entry.unwrap().path()).collect()
    };
    let mut files = Vec::new();
    for package in prefixes.iter().flat_map(|prefix| entries(&prefix.join("share"))) {
        for kind in ["msg", "srv", "action"] {
            let wanted = ending.unwrap_or(kind);
            files.extend(
                entries(&package.join(kind)).into_iter().filter(|file| file.extension().is_some_and(|e| e == wanted)),
            );
        }
    }
    files.sort();
    files
}

/// A library with all of them, and the names of the types that have files.
fn library(prefixes: &[PathBuf]) -> (Library, Vec<String>) {
    let mut library = Library::builtin();
    let mut names = Vec::new();
    for file in files(prefixes, None) {
        let name = Library::name_of_path(file.to_str().unwrap()).unwrap();
        let text = std::fs::read_to_string(&file).unwrap();
        library.add(&name, &text).unwrap_or_else(|fault| panic!("{}: {fault:?}", file.display()));
        names.push(name);
    }
    (library, names)
}

#[test]
fn every_definition_that_is_installed_is_read_and_has_the_hash_of_its_package() {
    let Some(python) = python() else { return };
    let prefixes = prefixes(&python);
    let (mut library, names) = library(&prefixes);
    let mut hashes = BTreeMap::new();
    for file in files(&prefixes, Some("json")) {
        let json: Value = serde_json::from_str(&std::fs::read_to_string(&file).unwrap()).unwrap();
        for hash in json["type_hashes"].as_array().into_iter().flatten() {
            let text = |key: &str| hash[key].as_str().unwrap().to_owned();
            hashes.insert(text("type_name"), text("hash_string"));
        }
    }
    for name in &names {
        assert!(hashes.contains_key(name), "{name} has no hash");
    }
    for (name, hash) in &hashes {
        let message = library.message(name).unwrap_or_else(|fault| panic!("{name}: {fault:?}"));
        assert_eq!(message.type_hash(), *hash, "{name}");
    }
    assert!(names.len() >= 190 && names.iter().any(|name| name == "test_msgs/msg/Strings"), "{} files", names.len());
    assert!(hashes.len() >= 300, "{} hashes", hashes.len());
}

#[test]
fn rclpy_has_the_same_defaults_and_neither_is_disturbed_by_bytes_behind_a_message() {
    let Some(python) = python() else { return };
    let (mut library, names) = library(&prefixes(&python));
    let encode = |message: &Message| message.encode(&Written::Nothing, ByteOrder::Little, Time::default()).unwrap();
    let messages: Vec<_> =
        names.iter().filter(|name| name.contains("/msg/")).map(|name| library.message(name).unwrap()).collect();
    let arguments: Vec<_> =
        messages.iter().map(|message| format!("{}={}", message.name(), hex::encode(encode(message)))).collect();
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/installed.py");
    let output = Command::new(python).arg(script).args(&arguments).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let lines = String::from_utf8(output.stdout).unwrap();
    let lines: Vec<_> = lines.lines().collect();
    assert_eq!(lines.len(), messages.len());
    for (message, line) in messages.iter().zip(lines) {
        let ours = message.decode(&encode(message)).unwrap();
        for theirs in line.split(' ').map(|digits| hex::decode(digits).unwrap()) {
            message.check(&theirs).unwrap();
            assert_eq!(message.decode(&theirs).unwrap(), ours, "{}", message.name());
        }
    }
}

/// A text of a message as `echo` prints it.
fn echoed(message: &Message, text: &str) -> String {
    let written = Written::Map(vec![("data".to_owned(), Written::Text(text.to_owned()))]);
    let bytes = message.encode(&written, ByteOrder::Little, Time::default()).unwrap();
    message.decode(&bytes).unwrap().to_yaml(None)
}

#[test]
fn pyyaml_reads_every_text_that_echo_prints_as_the_same_text() {
    /// Characters that readers of YAML take for something else, or do not take.
    const ODD: &str = "\u{1}\t\n\r\u{1b}\u{7f}\u{80}\u{85}\u{9f}\u{a0}\u{ad}\u{200b}\u{2028}\u{2029}\u{202e}\u{3000}\u{e000}\u{fdd0}\u{feff}\u{fffd}\u{fffe}\u{ffff}\u{1f600}\u{1ffff}\u{10ffff} '\"\\#:-?[]{}&*!|>%@`,.~=<0x1e_/yn\u{e9}\u{30ed}";
    let Some(python) = python() else { return };
    if !Command::new(&python).args(["-c", "import yaml"]).stderr(Stdio::null()).status().unwrap().success() {
        println!("skipped: {} has no PyYAML", python.display());
        return;
    }
    let odd: Vec<char> = ODD.chars().collect();
    let words = [
        "yes",
        "Off",
        "null",
        "~",
        "1_000",
        "0x1f",
        "1:30",
        "2001-01-01",
        ".inf",
        "NaN",
        "- a",
        "a: b",
        "a #b",
        "=",
        "<<",
        "---",
        "...",
        "",
    ];
    let mut texts: Vec<String> = words.map(str::to_owned).to_vec();
    texts.extend(odd.iter().map(char::to_string));
    texts.extend(odd.iter().map(|c| format!("a{c}b{c}")));
    let mut runner = TestRunner::deterministic();
    let of_odd = proptest::collection::vec(proptest::sample::select(odd), 0..8);
    for _ in 0..4000 {
        texts.push(of_odd.new_tree(&mut runner).unwrap().current().into_iter().collect());
        texts.push(any::<String>().prop_map(|text| text.replace('\0', "")).new_tree(&mut runner).unwrap().current());
    }
    let message = Library::builtin().message("std_msgs/msg/String").unwrap();
    let stream: String = texts.iter().map(|text| format!("{}---\n", echoed(&message, text))).collect();
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/read_yaml.py");
    let mut child = Command::new(python).arg(script).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
    // Python reads all of it before it writes.
    child.stdin.take().unwrap().write_all(stream.as_bytes()).unwrap();
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success());
    let lines = String::from_utf8(output.stdout).unwrap();
    let read: Vec<Value> = lines.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(read.len(), texts.len());
    for (text, read) in texts.iter().zip(read) {
        assert_eq!(read, *text.as_str(), "{text:?}: {}", echoed(&message, text));
        let ours = Written::parse(&echoed(&message, text)).unwrap();
        assert_eq!(ours, Written::Map(vec![("data".to_owned(), Written::Text(text.clone()))]));
    }
}
