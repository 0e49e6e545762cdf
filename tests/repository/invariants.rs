//! Invariants end the process; an `assert!` would only end a thread that nobody misses.

use crate::sources::{code, files, product, read, root};

/// The program without its tests and its bugs for the mutation check.
const SOURCES: [&str; 10] = [
    "crates/abac/src",
    "crates/api/src",
    "crates/gate/src",
    "crates/identity/src",
    "crates/ledger/src",
    "crates/raft/src",
    "crates/replica/src",
    "crates/ros-bridge/src",
    "crates/storage/src",
    "src",
];

/// Does the line state something as a panic of its thread, as in `debug_assert_eq!(a, b)`? The compiler checks a `const`.
fn asserts(line: &str) -> bool {
    let word =
        |at: usize| line.get(..at).is_none_or(|before| !before.ends_with(|c: char| c.is_alphanumeric() || c == '_'));
    let asserts =
        ["assert!(", "assert_eq!(", "assert_ne!(", "debug_assert!(", "debug_assert_eq!(", "debug_assert_ne!("];
    !line.contains("const _") && asserts.iter().any(|assert| line.match_indices(assert).any(|(at, _)| word(at)))
}

#[test]
fn what_must_hold_is_stated_as_an_invariant() {
    for path in SOURCES.iter().flat_map(|sources| files(&root().join(sources), ".rs")) {
        let relative = path.strip_prefix(root()).unwrap_or(&path).to_string_lossy().into_owned();
        if relative.contains("tests") || relative.ends_with("fixture.rs") {
            continue;
        }
        let text = product(&path);
        let found = code(&text).find(|line| asserts(line));
        assert!(found.is_none(), "{relative}: use ledger_base::invariant!, which ends the process: {found:?}");
    }
}

#[test]
fn a_node_ends_with_a_broken_invariant_and_with_a_thread_that_it_cannot_do_without() {
    assert!(read(&root().join("src/command.rs")).contains("ledger_base::invariant::end_process();"), "in `run`, first");
    for (file, threads) in
        [("src/ordering/orderer.rs", ["order", "execute"]), ("src/storage/housekeeping.rs", ["store", "housekeeping"])]
    {
        let text = read(&root().join(file));
        for thread in threads {
            let spawned = text.split_once(&format!(".name(\"{thread}\".into())")).map(|(_, spawned)| spawned);
            let body = spawned
                .and_then(|spawned| spawned.split_once("})?").or(spawned.split_once(")?")))
                .map(|(body, _)| body);
            assert!(body.is_some_and(|body| body.contains("vital(")), "{file}: the thread {thread} is vital");
        }
    }
}

#[test]
fn an_assertion_is_told_from_other_words() {
    assert!(asserts("    assert!(a);") && asserts("x => debug_assert_eq!(a, b),"));
    assert!(!asserts("const _: () = assert!(A < B);") && !asserts("my_assert!(a);"));
}
