//! The reads of publishing: they must not grow with robots, users and policies.

use crate::fleet::{Fleet, TURTLEBOT, TWIST, bytes, owner, robot, salma};
use bytes::Bytes;
use ledger::{Context, Registry};
use ledger_abac::Grant;
use ledger_base::rejection::Rejection;
use ledger_storage::state::{MemoryState, Overlay, StateRead};
use std::sync::{Arc, Mutex};

/// A state that notes what is asked of it.
#[derive(Default)]
struct Noting {
    state: Arc<MemoryState>,
    asked: Mutex<Vec<String>>,
}

impl Noting {
    fn note(&self, what: &str, key: &[u8]) {
        self.asked.lock().unwrap().push(format!("{what} {}", String::from_utf8_lossy(key).replace('\0', " ")));
    }
}

impl StateRead for Noting {
    fn get(&self, key: &[u8]) -> Result<Option<Bytes>, Rejection> {
        self.note("get", key);
        StateRead::get(&*self.state, key)
    }

    fn range(&self, prefix: &[u8], after: Option<&[u8]>, limit: usize) -> Result<Vec<(Bytes, Bytes)>, Rejection> {
        self.note("range", prefix);
        StateRead::range(&*self.state, prefix, after, limit)
    }
}

/// The reads of the state when Salma publishes, and those of the decision that she may.
fn reads(fleet: &Fleet, epoch: u64) -> [Vec<String>; 2] {
    let salma = salma();
    let noting = || Arc::new(Noting { state: Arc::clone(&fleet.state), ..Noting::default() });
    let asked = |noting: &Noting| std::mem::take(&mut *noting.asked.lock().unwrap());

    let (state, mut events) = (noting(), vec![]);
    let mut overlay = Overlay::new(state.clone());
    let mut args = bytes(&[TURTLEBOT, &epoch.to_string(), "7"]);
    args.push(Bytes::from_static(&TWIST));
    Registry::invoke(fleet.environment(Some(&salma)), &mut overlay, &mut events, "abac", "set", &args).unwrap();
    let published = asked(&state);

    let mut overlay = Overlay::new(state.clone());
    let ctx = Context::new(fleet.environment(Some(&salma)), "abac", &mut overlay, &mut events);
    fleet.abac.may_publish(&ctx, TURTLEBOT, epoch).unwrap();
    [published, asked(&state)]
}

#[test]
fn publishing_with_a_grant_reads_the_robot_the_grant_and_the_last_message_and_no_policy() {
    let mut fleet = Fleet::of_the_paper();
    let grant: Grant = fleet.get(&salma(), "acquire", &[TURTLEBOT]);
    let decision = [
        "get abac robot/Turtlebot4",
        "get abac grant/Turtlebot4/cmd_vel Org1/Salma",
        "get abac undecided/Org2/Turtlebot4",
    ];
    let publishing = [&decision[..], &["get abac last/Turtlebot4/cmd_vel"]].concat();
    assert_eq!(reads(&fleet, grant.epoch), [publishing.clone(), decision.to_vec()]);

    // With many more robots and policies around it is the same.
    for number in 0..50 {
        fleet.ok(&owner(), "setup", &[&robot(&format!("Robot{number}"), "exclusive")]);
        let rule = format!("permit (principal, action, resource in Robot::\"Robot{number}\");");
        fleet.ok(&owner(), "policy", &["put", &format!("p{number}"), &rule]);
        if number == 0 {
            // The first policy of its own replaced the built-in one, which had permitted it.
            fleet.ok(&owner(), "policy", &["put", "all", "permit (principal, action, resource);"]);
        }
    }
    let grant: Grant = fleet.get(&salma(), "acquire", &[TURTLEBOT]);
    assert_eq!(reads(&fleet, grant.epoch), [publishing, decision.to_vec()]);
}

#[test]
fn what_is_remembered_of_robots_and_grants_never_decides_against_the_state() {
    let mut fleet = Fleet::of_the_paper();
    fleet.ok(&salma(), "acquire", &[TURTLEBOT]);
    fleet.set(&salma(), TURTLEBOT, 1, 1, 1).unwrap();
    fleet.ok(&salma(), "release", &[TURTLEBOT]);
    assert!(fleet.set(&salma(), TURTLEBOT, 1, 2, 1).is_err());
    fleet.ok(&owner(), "replace", &[&robot("Turtlebot4", "open")]);
    fleet.set(&salma(), TURTLEBOT, 0, 3, 1).unwrap();
    fleet.ok(&owner(), "remove", &["Turtlebot4"]);
    assert!(fleet.set(&salma(), TURTLEBOT, 0, 4, 1).is_err());
}
