//! A node that does not speak the rules that its network activates, and one of a newer program that does.

use crate::rules;
use crate::support::network::{MARKER, NodePlace};
use crate::support::{Fleet, Process, until};
use ledger::Rules;
use ledger_identity::Role;
use ledgerd::Node;
use std::ffi::OsString;
use std::process::{Command, ExitCode, exit};

/// Set in a process that is to be a newer program: its arguments, one a line.
const ARGUMENTS: &str = "LEDGERD_TEST_NEWER_PROGRAM";

/// A program that speaks one number of rules more than any release: this test program runs itself again, as a program of
/// one's own does.
pub(crate) fn newer(arguments: &[&str]) -> Command {
    let mut command = Command::new(std::env::current_exe().unwrap());
    let name = "older::a_node_that_does_not_speak_the_activated_rules_stops_before_them_and_comes_back_when_upgraded";
    command
        .env_remove("RUST_LOG")
        .env("LEDGERD_LOG_FORMAT", "text")
        .args(["--exact", name, "--nocapture"])
        .env(ARGUMENTS, arguments.join("\n"));
    command
}

/// Starts a node that is such a program.
pub(crate) fn start_newer(place: &NodePlace) -> Process {
    place.start_as(newer(&["run", "--config", place.config.to_str().unwrap()]))
}

/// The whole life of a process that is such a program.
fn be_newer(arguments: &str) -> ! {
    let arguments = ["ledgerd"].into_iter().chain(arguments.lines()).map(OsString::from);
    let ended = ledgerd::run_with(Node::builder().rules_up_to(Rules::OF_TESTS), arguments);
    exit((0..=255).find(|code| ExitCode::from(*code) == ended).map_or(255, i32::from))
}

#[test]
fn a_node_that_does_not_speak_the_activated_rules_stops_before_them_and_comes_back_when_upgraded() {
    if let Ok(arguments) = std::env::var(ARGUMENTS) {
        be_newer(&arguments);
    }
    tokio::runtime::Runtime::new().unwrap().block_on(story());
}

async fn story() {
    let fleet = Fleet::found(2);
    fleet.issue("Org1", "Boss", Role::Admin, &[]);
    fleet.owner();
    let (boss, owner) = (fleet.ctl().as_("Boss"), fleet.ctl().as_("Admin"));
    let voter = start_newer(&fleet.nodes[0]);
    let mut learner = fleet.nodes[1].start();
    let (first, newest) = (Rules::NEWEST, Rules::OF_TESTS);
    let shown = rules::rules(&boss, "the voter has said what it speaks", |shown| {
        shown["nodes"][0]["newest"] == newest.number()
    })
    .await;
    assert_eq!(shown["nodes"][1]["newest"], first.number(), "this release says nothing: it speaks what is in force");

    let height = shown_height(&boss) + 20;
    let activate = ["network", "rules", "--activate", &newest.to_string(), "--from", &height.to_string()];
    boss.run(&activate).ok();
    owner.run(&activate).ok();
    assert!(learner.is_running(), "the rules do not hold yet");
    until("the network has passed the height", || async {
        owner.run(&["invoke", "abac", "replace", MARKER]).ok();
        (shown_height(&boss) > height).then_some(())
    })
    .await;
    let status = learner.wait();
    assert_eq!(status.code(), Some(1), "{}", learner.stderr());
    let told = learner.stderr();
    for part in [
        &format!(
            "error: this release of ledgerd does not support rules {newest}, with which block {height} is executed"
        ),
        "[LGR-5007]",
        &format!("found   rules {newest} from block {height} on"),
        &format!("wanted  rules {first}"),
        "which Org1/org1-node runs, or a later release, and start the node again; its data stay as they are",
    ] {
        assert!(told.contains(part), "{part:?} in {told}");
    }
    learner.no_panic();

    let mut again = fleet.nodes[1].start();
    assert_eq!(again.wait().code(), Some(1), "nor does it start again");
    let upgraded = start_newer(&fleet.nodes[1]);
    let wanted = shown_height(&boss);
    until("the upgraded node has executed what it missed", || async {
        let shown = boss.run(&["network", "status", "-o", "json"]).ok().json();
        let nodes = shown["nodes"].as_array().unwrap().clone();
        nodes.iter().any(|node| node["id"] == 2 && node["height"].as_u64() >= Some(wanted)).then_some(())
    })
    .await;
    drop((voter, upgraded));
}

/// The height that the node of Org1 has reached.
fn shown_height(ctl: &crate::support::Ctl) -> u64 {
    ctl.run(&["network", "status", "-o", "json"]).ok().json()["height"].as_u64().unwrap()
}
