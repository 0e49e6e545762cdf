//! The console: its bundle is small, and its code of the proto files is theirs.

use crate::{python, ran, repository};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use tempfile::TempDir;

/// Most bytes of the bundle, compressed.
const BYTES_MAX: usize = 300 * 1024;

/// Prints how many bytes the files have, each compressed.
const COMPRESSED: &str =
    "import gzip, sys; print(sum(len(gzip.compress(open(f, 'rb').read(), 9)) for f in sys.argv[1:]))";

fn console() -> PathBuf {
    repository().join("console")
}

fn files(place: &Path) -> Vec<(String, Vec<u8>)> {
    let entries = fs::read_dir(place).unwrap().map(|entry| entry.unwrap().path());
    let mut found: Vec<_> = entries
        .map(|path| (path.file_name().unwrap().to_string_lossy().into_owned(), fs::read(&path).unwrap()))
        .collect();
    found.sort();
    found
}

#[test]
fn the_bundle_is_small_and_names_no_place_from_which_a_page_would_load_something() {
    let bundle = files(&console().join("dist"));
    let names: Vec<_> = bundle.iter().map(|(name, _)| name.as_str()).collect();
    assert_eq!(names, ["console.css", "console.js", "icon.svg", "index.html"]);
    let paths = names.iter().map(|name| console().join("dist").join(name));
    let compressed = ran(Command::new(python()).args(["-c", COMPRESSED]).args(paths)).stdout;
    let bytes: usize = String::from_utf8(compressed).unwrap().trim().parse().unwrap();
    assert!(bytes > 10_000 && bytes <= BYTES_MAX, "{bytes} bytes, wanted at most {BYTES_MAX}");
    for (name, content) in &bundle {
        let text = String::from_utf8(content.clone()).unwrap();
        for loads in ["@import", "importScripts", "url(http", "url(//", "src=\"http", "import(\"http"] {
            assert!(!text.contains(loads), "{name} has {loads:?}");
        }
    }
}

#[test]
fn a_message_is_shown_as_a_twist_only_where_it_is_one_and_an_envelope_as_encrypted() {
    ran(Command::new("node").current_dir(console()).arg("tests/payload.mjs"));
}

#[test]
fn the_code_of_the_console_is_that_of_the_proto_files() {
    let made = TempDir::new().unwrap();
    ran(Command::new("bash").arg(console().join("generate")).arg(made.path()).arg(python()));
    let (wanted, found) = (files(&made.path().join("ledgerd/v1")), files(&console().join("src/gen/ledgerd/v1")));
    assert_eq!(wanted.len(), 3, "one for each file");
    assert!(wanted == found, "the code is of other proto files: run console/generate console/src/gen PYTHON");
}

#[test]
fn the_lock_file_names_no_registry_of_anybodys_own() {
    let lock = fs::read_to_string(console().join("package-lock.json")).unwrap();
    assert!(lock.contains("\"integrity\"") && lock.contains("node_modules/preact"));
    for line in lock.lines().filter(|line| line.contains("\"resolved\"")) {
        assert!(line.contains("https://registry.npmjs.org/"), "{line}");
    }
}
