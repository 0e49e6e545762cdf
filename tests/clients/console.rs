//! The console: its start page is small, nothing comes from elsewhere, its types are right, and it encodes transactions as Rust does.

use crate::{ran, repository};
use ledger_api::v1;
use proptest::prelude::*;
use proptest::strategy::ValueTree;
use proptest::test_runner::TestRunner;
use prost::Message;
use serde_json::json;
use std::collections::BTreeSet;
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// Most bytes of the start page with all that it loads, uncompressed.
const START_BYTES_MAX: usize = 100_000;
/// Cases of transactions.
const CASES: usize = 200;

fn console() -> PathBuf {
    repository().join("console")
}

fn text(path: &Path) -> String {
    fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// The scripts that this one imports when it is loaded.
fn imports(script: &Path) -> Vec<PathBuf> {
    let text = text(script);
    let imported = text.lines().filter(|line| line.starts_with("import ")).map(|line| line.split('"').nth(1).unwrap());
    imported.map(|path| fs::canonicalize(script.parent().unwrap().join(path)).unwrap()).collect()
}

/// The scripts of the start page.
fn start() -> BTreeSet<PathBuf> {
    let mut waiting = vec![fs::canonicalize(console().join("main.js")).unwrap()];
    let mut found = BTreeSet::new();
    while let Some(script) = waiting.pop() {
        if found.insert(script.clone()) {
            waiting.extend(imports(&script));
        }
    }
    found
}

#[test]
fn the_start_page_is_small_and_announces_what_it_loads() {
    let page = text(&console().join("index.html"));
    let announced: BTreeSet<_> =
        page.split('"').filter(|part| part.starts_with('/') && part.ends_with(".js")).collect();
    let top = fs::canonicalize(console()).unwrap();
    let scripts = start();
    let loaded: BTreeSet<_> =
        scripts.iter().map(|path| format!("/{}", path.strip_prefix(&top).unwrap().display())).collect();
    assert_eq!(
        announced,
        loaded.iter().map(String::as_str).collect(),
        "left: index.html; right: the imports of main.js"
    );
    let others = ["index.html", "console.css", "icon.svg"].map(|name| console().join(name));
    let bytes: usize = scripts.iter().chain(&others).map(|path| fs::read(path).unwrap().len()).sum();
    assert!(bytes > 10_000 && bytes < START_BYTES_MAX, "{bytes} bytes, wanted less than {START_BYTES_MAX}");
}

#[test]
fn no_file_names_a_place_from_which_a_page_would_load_something() {
    let served = ["", "data", "pages", "view"].map(|below| console().join(below));
    let files = served.iter().flat_map(|place| fs::read_dir(place).unwrap()).map(|entry| entry.unwrap().path());
    let files: Vec<_> = files
        .filter(|path| {
            path.extension().is_some_and(|end| ["js", "css", "html", "svg"].map(Into::into).contains(&end.to_owned()))
        })
        .collect();
    assert!(files.len() > 20, "{files:?}");
    for path in files {
        let text = text(&path);
        for loads in [
            "@import",
            "importScripts",
            "url(",
            "src=\"http",
            "import(\"http",
            "from \"http",
            "eval(",
            "innerHTML",
            "document.write",
            "localStorage",
            "document.cookie",
        ] {
            assert!(!text.contains(loads), "{} has {loads:?}", path.display());
        }
    }
}

#[test]
fn a_message_is_shown_as_a_twist_only_where_it_is_one_and_an_envelope_as_encrypted() {
    ran(Command::new("node").current_dir(console()).arg("tests/payload.mjs"));
}

#[test]
fn a_call_is_shown_by_person_action_and_robot() {
    ran(Command::new("node").current_dir(console()).arg("tests/calls.mjs"));
}

#[test]
fn a_time_is_shown_in_the_zone_of_its_reader() {
    ran(Command::new("node").current_dir(console()).arg("tests/times.mjs").env("TZ", "Asia/Tokyo"));
}

#[test]
fn the_terms_of_a_share_are_sent_as_the_ledger_takes_them() {
    ran(Command::new("node").current_dir(console()).arg("tests/access.mjs").env("TZ", "Asia/Tokyo"));
}

#[test]
fn an_address_that_is_none_leads_to_the_start_page() {
    ran(Command::new("node").current_dir(console()).arg("tests/route.mjs"));
}

#[test]
fn the_types_of_the_console_are_right() {
    ran(Command::new("node").current_dir(console()).arg("node_modules/typescript/bin/tsc"));
}

/// Transactions of all shapes: empty fields, long ones, texts of any script.
fn transactions() -> impl Strategy<Value = (v1::TransactionBody, v1::Transaction)> {
    let bytes = |most: usize| proptest::collection::vec(any::<u8>(), 0..most);
    let not_after = prop_oneof![Just(0), 1..u64::MAX, Just(1_800_000_000_000_000)];
    let args = proptest::collection::vec(prop_oneof![bytes(3), bytes(200), bytes(20_000)], 0..4);
    let body = (bytes(33), bytes(33), bytes(17), not_after, "\\PC{0,200}", "\\PC{0,20}", args);
    (body, bytes(80), bytes(600)).prop_map(
        |((network, creator, nonce, not_after, chaincode, function, args), signature, certificate)| {
            let args = args.into_iter().map(Into::into).collect();
            let (network, creator, nonce) = (network.into(), creator.into(), nonce.into());
            let body = v1::TransactionBody {
                network,
                creator,
                nonce,
                not_after,
                chaincode,
                function,
                args,
                known_block: None,
            };
            let encoded = body.encode_to_vec().into();
            (body, v1::Transaction { body: encoded, signature: signature.into(), certificate: certificate.into() })
        },
    )
}

#[test]
fn a_browser_encodes_a_transaction_byte_for_byte_as_rust_does() {
    let mut runner = TestRunner::deterministic();
    let cases: Vec<_> = (0..CASES).map(|_| transactions().new_tree(&mut runner).unwrap().current()).collect();
    let mut node = Command::new("node");
    node.current_dir(console()).arg("tests/transaction.mjs").stdin(Stdio::piped()).stdout(Stdio::piped());
    let mut node = node.spawn().unwrap();
    let mut input = node.stdin.take().unwrap();
    let lines: String = cases
        .iter()
        .map(|(body, transaction)| {
            let args: Vec<_> = body.args.iter().map(hex::encode).collect();
            let case = json!({
                "network": hex::encode(&body.network), "creator": hex::encode(&body.creator), "nonce": hex::encode(&body.nonce),
                "not_after": body.not_after.to_string(), "chaincode": body.chaincode, "function": body.function, "args": args,
                "signature": hex::encode(&transaction.signature), "certificate": hex::encode(&transaction.certificate),
            });
            format!("{case}\n")
        })
        .collect();
    let writing = std::thread::spawn(move || input.write_all(lines.as_bytes()));
    let output = node.wait_with_output().unwrap();
    writing.join().unwrap().unwrap();
    assert!(output.status.success());
    let output = String::from_utf8(output.stdout).unwrap();
    let found: Vec<_> = output.lines().collect();
    assert_eq!(found.len(), 2 * CASES);
    for ((body, transaction), lines) in cases.iter().zip(found.chunks(2)) {
        assert_eq!(lines, [hex::encode(body.encode_to_vec()), hex::encode(transaction.encode_to_vec())], "{body:?}");
    }
}

#[test]
fn the_lock_file_names_versions_and_hashes_and_no_registry() {
    let lock = text(&console().join("package-lock.json"));
    assert!(lock.contains("\"integrity\"") && lock.contains("node_modules/typescript"));
    assert!(!lock.contains("\"resolved\""), "it names where packages come from: console/.npmrc leaves that out");
    let package: serde_json::Value = serde_json::from_str(&text(&console().join("package.json"))).unwrap();
    assert!(package["dependencies"].is_null(), "the console itself needs no package");
}
