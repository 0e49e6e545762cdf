//! A node of an older release, which does not speak the rules that its network activates.

use crate::rules;
use crate::support::network::{MARKER, NodePlace};
use crate::support::{Fleet, Process, until};
use ledger::Rules;
use ledger_identity::Role;
use ledgerd::Node;
use std::ffi::OsString;
use std::process::{Command, ExitCode, exit};

/// Set in a process that is to be a node of an older release: its configuration.
const CONFIG: &str = "LEDGERD_TEST_OLDER_RELEASE";

/// Starts a node of an older release: this test program runs itself again, as a program of one's own does, with a node that
/// speaks less.
fn start_older(place: &NodePlace) -> Process {
    let mut command = Command::new(std::env::current_exe().unwrap());
    let name = "older::a_node_that_does_not_speak_the_activated_rules_stops_before_them_and_comes_back_when_upgraded";
    command
        .env_remove("RUST_LOG")
        .env("LEDGERD_LOG_FORMAT", "text")
        .args(["--exact", name, "--nocapture"])
        .env(CONFIG, &place.config);
    place.start_as(command)
}

/// The whole life of a process that is such a node.
fn be_older(config: OsString) -> ! {
    let arguments = ["ledgerd".into(), "run".into(), "--config".into(), config];
    let ended = ledgerd::run_with(Node::builder().rules_up_to(Rules::FIRST), arguments);
    exit((0..=255).find(|code| ExitCode::from(*code) == ended).map_or(255, i32::from))
}

#[test]
fn a_node_that_does_not_speak_the_activated_rules_stops_before_them_and_comes_back_when_upgraded() {
    if let Some(config) = std::env::var_os(CONFIG) {
        be_older(config);
    }
    tokio::runtime::Runtime::new().unwrap().block_on(story());
}

async fn story() {
    let fleet = Fleet::found(2);
    rules::older(&fleet);
    fleet.issue("Org1", "Boss", Role::Admin, &[]);
    fleet.owner();
    let (boss, owner) = (fleet.ctl().as_("Boss"), fleet.ctl().as_("Admin"));
    let voter = fleet.nodes[0].start();
    let mut learner = start_older(&fleet.nodes[1]);
    let (first, newest) = (Rules::FIRST, Rules::NEWEST);
    let shown = rules::rules(&boss, "the voter has said what it speaks", |shown| {
        shown["nodes"][0]["newest"] == newest.number()
    })
    .await;
    assert_eq!(
        shown["nodes"][1]["newest"],
        first.number(),
        "the older release says nothing: it speaks what is in force"
    );

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
        &format!("error: this release of ledgerd does not speak rules {newest}, by which block {height} is executed"),
        "[LGR-5007]",
        &format!("found   rules {newest} from block {height} on"),
        &format!("wanted  rules {first}"),
        "which Org1/org1-node runs, or a later release, and start the node again with its data as it is",
    ] {
        assert!(told.contains(part), "{part:?} in {told}");
    }
    learner.no_panic();

    let mut again = start_older(&fleet.nodes[1]);
    assert_eq!(again.wait().code(), Some(1), "nor does it start again");
    let upgraded = fleet.nodes[1].start();
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
