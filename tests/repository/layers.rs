//! Which crate may use which: ARCHITECTURE.md, "Crates".

use crate::sources::{self, code, files, is_of_tests, read, root};
use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use toml::{Table, Value};

/// Each crate and the crates of this workspace that it may use, for building and for testing. A package of tests alone, which stands
/// in a folder `tests`, may use all of them, and none may use it.
const LAYERS: [(&str, &[&str]); 27] = [
    // The foundation: no cryptography beyond a hash, no network, no chain.
    ("ledger-base", &[]),
    // The paper's experiment with a robot that moves.
    ("arena", &["ledger-api", "ledger-base", "ledger-gate", "ledgerd", "ros-bridge", "ros-message"]),
    // What each process tells a collector of its part in a message: nothing of a ledger but ids.
    ("ledger-traces", &["ledger-base"]),
    // Keys and certificates: no file, no chain.
    ("ledger-identity", &["ledger-base"]),
    // Files of Fabric: certificates and units.
    ("fabric", &["ledger-base", "ledger-identity"]),
    // For tests only.
    ("testkit", &["ledger-identity"]),
    // Whatever a robot or an auditor checks alone: no file, no engine, no network.
    ("ledger-light", &["ledger-base", "ledger-identity", "testkit"]),
    // Files: no signature, no chaincode.
    ("ledger-storage", &["ledger-base", "ledger-storage"]),
    ("ledger", &["ledger", "ledger-base", "ledger-identity", "ledger-light", "ledger-storage", "testkit"]),
    ("ledger-raft", &["ledger", "ledger-base", "ledger-light", "ledger-storage", "testkit"]),
    // Decides, and does nothing: what drives the engine in a node and in the simulation.
    (
        "ledger-replica",
        &["ledger", "ledger-base", "ledger-identity", "ledger-light", "ledger-raft", "ledger-storage", "testkit"],
    ),
    // What the chaincode and its clients say to each other: data, and nothing that decides.
    ("ledger-contract", &[]),
    // Content keys and envelopes: no chain, no network.
    ("ledger-confidential", &["ledger-contract", "ledger-base"]),
    (
        "ledger-abac",
        &[
            "ledger",
            "ledger-confidential",
            "ledger-contract",
            "ledger-base",
            "ledger-identity",
            "ledger-storage",
            "testkit",
        ],
    ),
    ("ledger-api", &["ledger", "ledger-base", "ledger-identity", "ledger-light"]),
    // What a robot decides alone: no DDS, no socket, no clock.
    (
        "ledger-gate",
        &["ledger", "ledger-confidential", "ledger-contract", "ledger-base", "ledger-identity", "ledger-light"],
    ),
    // Messages by their definitions: nothing of a ledger.
    ("ros-message", &["ledger-base"]),
    // DDS: nothing of a ledger, nor of ROS 2.
    ("rtps", &[]),
    // Graphs of rmw_zenoh: nothing of a ledger, and messages are bytes.
    ("ros-zenoh", &[]),
    (
        "ros-bridge",
        &[
            "ledger",
            "ledger-api",
            "ledger-confidential",
            "ledger-contract",
            "ledger-gate",
            "ledger-base",
            "ledger-identity",
            "ledger-light",
            "ledger-traces",
            "ros-message",
            "ros-zenoh",
            "rtps",
            "testkit",
        ],
    ),
    // The node with zenoh for its bridge.
    ("ledgerd-bridge-zenoh", &["ledgerd", "ros-bridge"]),
    // Never abac: whoever only talks to nodes needs neither Cedar nor a world state.
    (
        "ledgerctl",
        &[
            "fabric",
            "ledger",
            "ledger-api",
            "ledger-confidential",
            "ledger-contract",
            "ledger-base",
            // `replay` publishes as a bridge does.
            "ledger-gate",
            "ledger-identity",
            "ledger-light",
            "ledger-storage",
            "ros-bridge",
            "ros-message",
        ],
    ),
    // Hostile bytes for whatever reads them.
    (
        "ledger-fuzz",
        &[
            "fabric",
            "ledger",
            "ledger-abac",
            "ledger-api",
            "ledger-confidential",
            "ledger-contract",
            "ledger-base",
            "ledger-identity",
            "ledger-light",
            "ledger-raft",
            "ledger-storage",
            "rtps",
        ],
    ),
    (
        "ledgerd",
        &[
            "ledger",
            "ledger-abac",
            "ledger-api",
            "ledger-confidential",
            "ledger-contract",
            "ledger-base",
            "ledger-gate",
            "ledger-identity",
            "ledger-light",
            "ledger-raft",
            "ledger-replica",
            "ledger-traces",
            "ledger-storage",
            "ros-bridge",
            "ros-message",
            "testkit",
        ],
    ),
    ("fair-share", &["ledger-abac", "ledgerd"]),
    ("inventory", &["ledger", "ledger-api", "ledger-base", "ledger-identity", "ledger-storage", "ledgerd"]),
    // The simulation drives what a node drives, without a node.
    (
        "ledgerd-sim",
        &[
            "ledger",
            "ledger-abac",
            "ledger-confidential",
            "ledger-contract",
            "ledger-gate",
            "ledger-base",
            "ledger-identity",
            "ledger-light",
            "ledger-raft",
            "ledger-replica",
            "ledger-storage",
            "testkit",
        ],
    ),
];

/// Crates that are kept behind few files, so that they can be replaced: who uses them, and where they are named.
const BEHIND: [(&str, &str, &[&str]); 2] = [
    ("sled", "ledger-storage", &["crates/storage/src/state/sled_store.rs"]),
    (
        "raft",
        "ledger-raft",
        &["crates/raft/src/engine.rs", "crates/raft/src/engine/", "crates/raft/src/log.rs", "crates/raft/src/message/"],
    ),
];

/// The manifests of all crates, with their paths.
fn manifests() -> Vec<(PathBuf, Table)> {
    sources::manifests()
        .into_iter()
        .map(|path| {
            let manifest = read(&path).parse().unwrap_or_else(|error| panic!("{}: {error}", path.display()));
            (path, manifest)
        })
        .collect()
}

fn name(manifest: &Table) -> &str {
    manifest.get("package").and_then(|package| package.get("name")).and_then(Value::as_str).unwrap_or_default()
}

/// The dependencies of every kind.
fn dependencies(manifest: &Table) -> BTreeMap<&str, &Value> {
    ["dependencies", "dev-dependencies", "build-dependencies"]
        .iter()
        .filter_map(|kind| manifest.get(*kind)?.as_table())
        .flatten()
        .map(|(name, value)| (name.as_str(), value))
        .collect()
}

#[test]
fn dependencies_point_one_way() {
    let ours: BTreeSet<&str> = LAYERS.iter().map(|(name, _)| *name).collect();
    let manifests = manifests();
    let (tests, crates): (Vec<_>, Vec<_>) = manifests.iter().partition(|(path, _)| is_of_tests(path));
    let names = |these: &[&'_ (PathBuf, Table)]| these.iter().map(|(_, manifest)| name(manifest).to_owned()).collect();
    let (tests, found): (BTreeSet<String>, BTreeSet<String>) = (names(&tests), names(&crates));
    let ours: BTreeSet<String> = ours.into_iter().map(str::to_owned).collect();
    assert_eq!(found, ours, "every crate has its place in LAYERS");
    for (name, allowed) in LAYERS {
        let (_, manifest) = manifests
            .iter()
            .find(|(_, manifest)| self::name(manifest) == name)
            .unwrap_or_else(|| panic!("{name} has no manifest"));
        for used in dependencies(manifest).into_keys().filter(|used| ours.contains(*used) || tests.contains(*used)) {
            assert!(allowed.contains(&used), "{name} may not use {used}");
        }
    }
}

#[test]
fn no_product_is_built_from_the_testkit() {
    for (path, manifest) in manifests() {
        // The simulator is itself a test, and the nodes of tests are for tests.
        if ["ledgerd-sim", "ledgerd-support"].contains(&name(&manifest)) {
            continue;
        }
        for kind in ["dependencies", "build-dependencies"] {
            let used = manifest.get(kind).and_then(Value::as_table).is_some_and(|used| used.contains_key("testkit"));
            assert!(!used, "{}: the testkit belongs into [dev-dependencies]", path.display());
        }
    }
}

#[test]
fn every_crate_has_the_lints_and_versions_of_the_workspace() {
    for (path, manifest) in manifests() {
        let path = path.display();
        let lints = manifest.get("lints").and_then(|lints| lints.get("workspace")).and_then(Value::as_bool);
        assert_eq!(lints, Some(true), "{path}: [lints] workspace = true");
        for (dependency, value) in dependencies(&manifest) {
            let own = dependency == name(&manifest);
            let inherited = value.get("workspace").and_then(Value::as_bool) == Some(true);
            assert!(own || inherited, "{path}: {dependency} takes its version from the workspace");
        }
    }
}

#[test]
fn what_shall_be_replaceable_is_named_in_few_files() {
    let manifests = manifests();
    for (crate_name, user, places) in BEHIND {
        for (path, manifest) in &manifests {
            let uses = dependencies(manifest).contains_key(crate_name);
            assert!(!uses || name(manifest) == user, "{} may not use {crate_name}", path.display());
        }
        let directory = manifests
            .iter()
            .find(|(_, manifest)| name(manifest) == user)
            .and_then(|(path, _)| path.parent())
            .unwrap_or_else(|| panic!("{user} has no directory"));
        for path in files(&directory.join("src"), ".rs") {
            let relative = path.strip_prefix(root()).unwrap_or(&path).to_string_lossy().into_owned();
            let named = code(&read(&path)).any(|line| names(line, crate_name));
            let allowed = places.iter().any(|place| match place.ends_with('/') {
                true => relative.starts_with(place),
                false => relative == *place,
            });
            assert!(!named || allowed, "{relative} may not name {crate_name}");
        }
    }
}

/// Does the line name the crate in a path, as in `sled::Db`? `ledger_raft::` and `self::raft` are others.
fn names(line: &str, crate_name: &str) -> bool {
    let path = format!("{crate_name}::");
    line.match_indices(&path).any(|(at, _)| {
        let before = line.get(..at).unwrap_or_default();
        !before.ends_with(|c: char| c.is_alphanumeric() || c == '_' || c == ':')
    })
}

#[test]
fn naming_a_crate_is_told_from_names_that_only_contain_it() {
    assert!(names("use sled::Db;", "sled"));
    assert!(names("fn f(e: &sled::Error)", "sled"));
    assert!(!names("use ledger_raft::Engine;", "raft"));
    assert!(!names("use crate::raft::Engine;", "raft"));
}
