//! The libraries that a program links follow from its work.

use crate::sources::root;
use std::collections::BTreeSet;
use std::process::Command;

/// The crates that a crate of this workspace is built from, with the features that it alone asks for.
fn linked(package: &str) -> BTreeSet<String> {
    let listed = Command::new(env!("CARGO"))
        .args(["tree", "--locked", "--offline", "--edges", "normal", "--prefix", "none", "--package", package])
        .current_dir(root())
        .output()
        .unwrap_or_else(|error| panic!("cargo does not start: {error}"));
    assert!(listed.status.success(), "{}", String::from_utf8_lossy(&listed.stderr));
    let lines = String::from_utf8_lossy(&listed.stdout).into_owned();
    lines.lines().filter_map(|line| line.split(' ').next()).map(str::to_owned).collect()
}

#[test]
fn a_client_and_a_bridge_link_neither_the_world_state_nor_the_policies_nor_the_engine() {
    for package in ["ledgerctl", "ros-bridge"] {
        let linked = linked(package);
        assert!(linked.contains("ledger-identity"), "{package}: {linked:?}");
        for heavy in ["sled", "cedar-policy", "raft"] {
            assert!(!linked.contains(heavy), "{package} links {heavy}");
        }
    }
}

#[test]
fn a_node_links_all_of_them() {
    let linked = linked("ledgerd");
    for heavy in ["sled", "cedar-policy", "raft"] {
        assert!(linked.contains(heavy), "the names that the other test looks for are right: {heavy}");
    }
}
