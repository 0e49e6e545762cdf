//! Several robots and the policies of their owner in one step.

use crate::fleet::{Fleet, HUSKY, TURTLEBOT, admin1, farhad, owner, robot, salma};
use ledger_abac::{
    DEFAULT_POLICY, FleetChange, FleetPlan, PolicyDraft, PolicyText, RemovedRobot, RobotAsset, RobotSpec, ShareTerms,
};
use ledger_base::rejection::Code;

fn asset(fleet: &mut Fleet, name: &str) -> RobotAsset {
    fleet.get(&owner(), "robot", &[name])
}

/// A robot of the paper with this trust, made from its registered version.
fn spec(fleet: &mut Fleet, name: &str, trusted: &[&str]) -> RobotSpec {
    let spec: RobotSpec = serde_json::from_str(&robot(name, "exclusive")).unwrap();
    let trusted = Some(trusted.iter().map(|name| (*name).to_owned()).collect());
    RobotSpec { trusted, base: Some(asset(fleet, name).version), ..spec }
}

fn set(base: u64, texts: &[(&str, &str)]) -> Option<PolicyDraft> {
    let policies =
        texts.iter().map(|(id, text)| PolicyText { id: (*id).to_owned(), text: (*text).to_owned() }).collect();
    Some(PolicyDraft { policies: Some(policies), base: Some(base), ..PolicyDraft::default() })
}

fn json(plan: &FleetPlan) -> String {
    serde_json::to_string(plan).unwrap()
}

#[test]
fn no_grant_ends_because_of_a_state_between_two_changes_of_one_plan() {
    let mut fleet = Fleet::of_the_paper();
    fleet.ok(&salma(), "acquire", &[HUSKY]);
    // Her organisation loses the trust, and she is named by a policy instead.
    let salmas = ShareTerms { resource: "Husky".into(), with: "Org1/Salma".into(), ..ShareTerms::default() }.text();
    let robots = vec![spec(&mut fleet, "Husky", &["Org2"])];
    let policies = set(0, &[("default", DEFAULT_POLICY), ("salma", &salmas)]);
    let change: FleetChange =
        fleet.get(&owner(), "reconcile", &[&json(&FleetPlan { robots, policies, ..FleetPlan::default() })]);
    assert_eq!(change.policies.unwrap().ended, []);
    assert_eq!(
        (change.robots[0].ended.len(), change.robots[0].robot.trusted.as_slice()),
        (0, &["Org2".to_owned()][..])
    );
    assert_eq!(asset(&mut fleet, "Husky").services[0].holder, "Org1/Salma");
    // And back: trust comes, the policy goes.
    let robots = vec![spec(&mut fleet, "Husky", &["Org1", "Org2"])];
    let change: FleetChange = fleet.get(
        &owner(),
        "reconcile",
        &[&json(&FleetPlan { robots, policies: set(1, &[]), ..FleetPlan::default() })],
    );
    assert_eq!((change.policies.unwrap().ended.len(), change.robots[0].ended.len()), (0, 0));
    assert_eq!(asset(&mut fleet, "Husky").services[0].holder, "Org1/Salma");
}

#[test]
fn a_plan_comes_in_force_whole_or_not_at_all() {
    let mut fleet = Fleet::of_the_paper();
    let before = asset(&mut fleet, "Husky");
    let husky = spec(&mut fleet, "Husky", &["Org2"]);
    let removed = vec![RemovedRobot { name: "OptiTrack".into(), base: asset(&mut fleet, "OptiTrack").version }];
    let plan = FleetPlan { robots: vec![husky.clone()], removed, policies: set(0, &[("p", "permit (")]) };
    fleet.refused(&owner(), Code::PolicyInvalid, "reconcile", &[&json(&plan)]);
    assert_eq!(asset(&mut fleet, "Husky").version, before.version);
    assert!(!asset(&mut fleet, "OptiTrack").version.is_empty());
    // Another admin has changed something meanwhile.
    fleet.ok(&owner(), "configure", &[HUSKY, r#"{"lease_ms":20000}"#]);
    let refused = fleet.refused(
        &owner(),
        Code::RobotChanged,
        "reconcile",
        &[&json(&FleetPlan { robots: vec![husky], ..FleetPlan::default() })],
    );
    assert!(refused.wanted.contains(&before.version), "{refused}");
    let stale = FleetPlan { policies: set(1, &[]), ..FleetPlan::default() };
    fleet.refused(&owner(), Code::PoliciesChanged, "reconcile", &[&json(&stale)]);
    let gone = RemovedRobot { name: "Husky".into(), base: before.version };
    fleet.refused(
        &owner(),
        Code::RobotChanged,
        "reconcile",
        &[&json(&FleetPlan { removed: vec![gone], ..FleetPlan::default() })],
    );
    let known = RobotSpec { base: Some(String::new()), ..spec(&mut fleet, "Turtlebot4", &["Org2"]) };
    fleet.refused(
        &owner(),
        Code::RobotChanged,
        "reconcile",
        &[&json(&FleetPlan { robots: vec![known], ..FleetPlan::default() })],
    );
}

#[test]
fn a_question_says_which_grants_end_and_who_gains_and_loses_and_changes_nothing() {
    let mut fleet = Fleet::of_the_paper();
    *fleet.members.2.lock().unwrap() = vec!["Org1/Farhad", "Org1/Salma", "Org2/admin"];
    fleet.ok(&farhad(), "acquire", &[TURTLEBOT]);
    let version = asset(&mut fleet, "Turtlebot4").version;
    let spot: RobotSpec = serde_json::from_str(
        &robot("Spot", "exclusive").replace("\"attribute_required\":\"Spot\"", "\"attribute_required\":\"Husky\""),
    )
    .unwrap();
    let plan = FleetPlan {
        robots: vec![RobotSpec { base: Some(String::new()), ..spot }],
        removed: vec![RemovedRobot { name: "Turtlebot4".into(), base: version }],
        policies: None,
    };
    let answer = fleet.simulate(&owner(), "reconcile", &[json(&plan).into()]).unwrap();
    let change: FleetChange = serde_json::from_slice(&answer).unwrap();
    assert_eq!(change.removed.iter().map(|ended| ended.holder.as_str()).collect::<Vec<_>>(), ["Org1/Farhad"]);
    let diff = change.diff.unwrap();
    let told = |rights: &[ledger_abac::RightOf]| -> Vec<String> {
        rights
            .iter()
            .filter(|one| one.right.action == "acquire")
            .map(|one| format!("{} {}", one.who, one.right.of))
            .collect()
    };
    assert_eq!(told(&diff.gained), ["Org1/Salma Spot/cmd_vel"]);
    assert_eq!(told(&diff.lost), ["Org1/Farhad Turtlebot4/cmd_vel", "Org1/Salma Turtlebot4/cmd_vel"]);
    assert_eq!(asset(&mut fleet, "Turtlebot4").services[0].holder, "Org1/Farhad");
}

#[test]
fn only_an_admin_of_the_owner_reconciles_its_robots() {
    let mut fleet = Fleet::of_the_paper();
    let husky = spec(&mut fleet, "Husky", &["Org2"]);
    let removed = vec![RemovedRobot { name: "Husky".into(), base: husky.base.clone().unwrap() }];
    let plans =
        [FleetPlan { robots: vec![husky], ..FleetPlan::default() }, FleetPlan { removed, ..FleetPlan::default() }];
    for plan in &plans {
        fleet.refused(&admin1(), Code::NotOwner, "reconcile", &[&json(plan)]);
        fleet.refused(&salma(), Code::NotAdmin, "reconcile", &[&json(plan)]);
    }
    fleet.refused(&owner(), Code::BadArgument, "reconcile", &["{\"robot\":[]}"]);
}
