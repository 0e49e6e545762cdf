//! One driver: what a node decides around the engine is in crates/replica, and nowhere a second time.

use crate::sources::{code, files, read, root};
use std::path::PathBuf;

/// The folders that drive the replica.
const DRIVERS: [&str; 3] = ["src", "tests/sim/src", "crates/replica/tests"];
/// Only a machine has these.
const MACHINERY: [&str; 7] = ["std::thread", "std::time", "std::fs", "std::net", "tokio", "Instant", "SystemTime"];
/// A source that names these drives the engine itself.
const DRIVING: [&str; 14] = [
    "Engine::",
    "EngineConfig",
    "Output::",
    "Input::Tick",
    "Input::Persisted",
    "Input::ProposeEmpty",
    "next_step(",
    "is_early(",
    "ORGANISATIONS_MIN",
    "snapshot.fill(",
    ".begin_after(",
    ".set_committed(",
    "Header::following(",
    "RaftKind::PreVote",
];
/// A folder that names these decides about calls itself: their lanes, their order, and refusals.
const ADMITTING: [&str; 4] = ["admit_decoded(", ".urgent(", "Refusal::step", "fn take_late"];
/// Times and sizes that the replica decides about.
const BOUNDS: [&str; 14] = [
    "WAIT_MAX",
    "WAIT_FOR_HEIGHT",
    "CONFIRM_TIME_MAX",
    "FULL_DISK_PAUSE",
    "LEARNER_WRITE_DELAY",
    "LEAVE_AGAIN_PAUSE",
    "LAG_MIN",
    "ASK_TIME_MAX",
    "SILENCE_MAX",
    "ELECTION_",
    "WAIT_DATA",
    "MESSAGES_FREE",
    "ENDS_FREE",
    "RESERVE_BYTES",
];

/// The files below a folder in which a line of code has one of these, and what it has.
fn having(folder: &str, words: &[String]) -> Vec<(PathBuf, String)> {
    let has = |path: &PathBuf| {
        let text = read(path);
        code(&text).find_map(|line| words.iter().find(|word| line.contains(word.as_str())).cloned())
    };
    let files = files(&root().join(folder), ".rs").into_iter();
    files.filter_map(|path| has(&path).map(|word| (path, word))).collect()
}

fn words(words: &[&str]) -> Vec<String> {
    words.iter().map(|word| (*word).to_owned()).collect()
}

#[test]
fn the_engine_is_driven_by_its_unit_tests_and_by_the_replica_only() {
    assert!(!root().join("crates/raft/tests").exists(), "tests of a whole node belong into crates/replica/tests");
}

#[test]
fn the_replica_has_no_thread_no_clock_and_no_file() {
    assert_eq!(having("crates/replica/src", &words(&MACHINERY)), []);
}

#[test]
fn the_node_the_simulation_and_the_storms_of_ordering_drive_the_replica_and_no_copy_of_it() {
    for folder in DRIVERS {
        assert_eq!(having(folder, &words(&DRIVING)), [], "the replica does that");
        assert_eq!(having(folder, &words(&ADMITTING)), [], "the replica's gateway does that");
        let bounds: Vec<String> = BOUNDS.iter().map(|bound| format!("const {bound}")).collect();
        assert_eq!(having(folder, &bounds), [], "the replica decides about that");
        for machine in ["Replica::start", "replica.step(", "CatchUp::new(", "machine.step(", "Opening {"] {
            assert!(!having(folder, &words(&[machine])).is_empty(), "{folder} drives no {machine}");
        }
    }
    for folder in ["src", "tests/sim/src"] {
        assert!(!having(folder, &words(&["desk.work("])).is_empty(), "{folder} serves no desk");
    }
}
