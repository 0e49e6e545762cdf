//! Numbered sets of policies: who may replace them, what is kept of them, and what names them.

use crate::fleet::{Fleet, HUSKY, SECOND, TURTLEBOT, admin1, farhad, identity, owner, robot, salma};
use ledger::msp::QUOTAS;
use ledger_abac::{
    Acquired, Ask, Can, DEFAULT_POLICY, Grant, Permitted, PolicyApprovals, PolicyChange, PolicyDraft, PolicyProposal,
    PolicyProposalTexts, PolicySet, PolicySetTexts, PolicyText,
};
use ledger_base::rejection::Code;
use ledger_identity::{Identity, Role};

const ALL: &str = "permit (principal, action, resource);";
const DAY: u64 = 24 * 3600 * SECOND;

fn policy(id: &str, text: &str) -> PolicyText {
    PolicyText { id: id.into(), text: text.into() }
}

/// A set of one policy that permits everything, and says so.
fn set(message: &str) -> PolicyDraft {
    let text = format!("// {message}\n{ALL}");
    PolicyDraft { policies: Some(vec![policy("all", &text)]), message: message.into(), ..PolicyDraft::default() }
}

fn json(draft: &PolicyDraft) -> String {
    serde_json::to_string(draft).unwrap()
}

/// Another admin of the owner.
fn second() -> Identity {
    identity("Org2", "second", Role::Admin, &[], 40)
}

fn third() -> Identity {
    identity("Org2", "third", Role::Admin, &[], 41)
}

fn history(fleet: &mut Fleet) -> Vec<PolicySet> {
    fleet.get(&salma(), "policy_history", &["Org2"])
}

fn propose(fleet: &mut Fleet, who: &Identity, draft: &PolicyDraft) -> PolicyProposal {
    fleet.get(who, "policy", &["propose", &json(draft)])
}

/// Org2 with a rule of its own: two of its admins must agree.
fn two_of_admins() -> Fleet {
    let mut fleet = Fleet::of_the_paper();
    let draft = PolicyDraft { approvals: Some("admins = 2".into()), ..set("first") };
    fleet.ok(&owner(), "policy", &["apply", &json(&draft)]);
    fleet
}

#[test]
fn every_change_makes_a_set_with_the_next_number_author_and_message() {
    let mut fleet = Fleet::of_the_paper();
    let change: PolicyChange = fleet.get(&owner(), "policy", &["put", "all", ALL]);
    assert_eq!((change.version, change.by.as_str()), (1, "Org2/admin"));
    let change: PolicyChange = fleet.get(&second(), "policy", &["apply", &json(&set("second"))]);
    assert_eq!((change.version, change.change.as_str(), change.message.as_str()), (2, "applied", "second"));
    let change: PolicyChange = fleet.get(&owner(), "policy", &["remove", "all"]);
    assert!(change.default_in_force && change.version == 3);
    let sets = history(&mut fleet);
    let told: Vec<_> = sets.iter().map(|set| (set.version, set.by.as_str(), set.policies.len())).collect();
    assert_eq!(told, [(3, "Org2/admin", 0), (2, "Org2/second", 1), (1, "Org2/admin", 1)]);
    assert_eq!(sets[1].message, "second");
    assert_ne!(sets[1].hash, sets[2].hash);
    let kept: PolicySetTexts = fleet.get(&salma(), "policy_set", &["Org2", "1"]);
    assert_eq!(kept.policies, [policy("all", ALL)]);
}

#[test]
fn a_set_is_replaced_whole_and_one_that_is_in_force_already_changes_nothing() {
    let mut fleet = Fleet::of_the_paper();
    fleet.ok(&owner(), "policy", &["put", "old", ALL]);
    let draft = PolicyDraft { policies: Some(vec![policy("a", ALL), policy("b", DEFAULT_POLICY)]), ..set("two") };
    let change: PolicyChange = fleet.get(&owner(), "policy", &["apply", &json(&draft)]);
    assert_eq!(change.version, 2);
    let kept: PolicySetTexts = fleet.get(&salma(), "policy_set", &["Org2", "2"]);
    assert_eq!(kept.policies.iter().map(|policy| policy.id.as_str()).collect::<Vec<_>>(), ["a", "b"]);
    let again: PolicyChange = fleet.get(&owner(), "policy", &["apply", &json(&draft)]);
    assert_eq!((again.version, again.change.as_str()), (2, "unchanged"));
    assert_eq!(history(&mut fleet).len(), 2);
}

#[test]
fn grants_refusals_and_answers_name_the_set_that_decided() {
    let mut fleet = Fleet::of_the_paper();
    let granted: Grant = fleet.get(&salma(), "acquire", &[HUSKY]);
    assert_eq!(granted.policy_version, 0, "the built-in policy, never changed");
    assert!(!granted.policies.is_empty() && granted.policies.iter().all(|id| id.starts_with("default")), "{granted:?}");
    fleet.ok(&salma(), "release", &[HUSKY]);
    fleet.ok(&owner(), "policy", &["apply", &json(&set("first"))]);
    fleet.ok(&owner(), "policy", &["apply", &json(&set("again"))]);
    let granted: Grant = fleet.get(&salma(), "acquire", &[HUSKY]);
    assert_eq!(granted.policy_version, 2);
    let only = "permit (principal, action, resource) when { principal.name == \"Salma\" };";
    let draft = PolicyDraft { policies: Some(vec![policy("all", only)]), ..set("") };
    fleet.ok(&owner(), "policy", &["apply", &json(&draft)]);
    let renewed: Grant = fleet.get(&salma(), "renew", &[HUSKY]);
    assert_eq!((renewed.policy_version, renewed.policies), (3, vec!["all".to_owned()]));
    let refused = fleet.refused(&farhad(), Code::DeniedByPolicy, "acquire", &[TURTLEBOT]);
    assert!(refused.message.ends_with("(policies of Org2, version 3)"), "{refused}");
    let not_farhad = "forbid (principal, action, resource) when { principal.name == \"Farhad\" };";
    let policies = vec![policy("all", ALL), policy("also", ALL), policy("not-farhad", not_farhad)];
    fleet.ok(&owner(), "policy", &["apply", &json(&PolicyDraft { policies: Some(policies), ..set("") })]);
    let renewed: Grant = fleet.get(&salma(), "renew", &[HUSKY]);
    assert_eq!((renewed.policy_version, renewed.policies), (4, vec!["all".to_owned(), "also".to_owned()]));
    let refused = fleet.refused(&farhad(), Code::DeniedByPolicy, "acquire", &[TURTLEBOT]);
    assert!(refused.message.ends_with("(policies of Org2, version 4: not-farhad)"), "{refused}");
    let ask = Ask { action: "acquire".into(), service: TURTLEBOT.into(), ..Ask::default() };
    let can: Can = fleet.get(&farhad(), "can", &[&serde_json::to_string(&ask).unwrap()]);
    assert_eq!((can.allowed, can.policy_version), (false, 4));
}

#[test]
fn a_publisher_without_a_grant_is_told_with_the_policies_that_permit_it_once_and_when_they_change() {
    let mut fleet = Fleet::empty();
    fleet.ok(&owner(), "setup", &[&robot("Turtlebot4", "open")]);
    let told = |fleet: &Fleet, since: usize| fleet.told(since).iter().filter(|(name, _)| *name == "permitted").count();
    fleet.set(&salma(), TURTLEBOT, 0, 1, 1).unwrap();
    let first: Permitted = fleet.newest("permitted");
    assert_eq!((first.publisher.as_str(), first.policy_version), ("Org1/Salma", 0));
    assert!(!first.policies.is_empty() && first.policies.iter().all(|id| id.starts_with("default")), "{first:?}");
    fleet.set(&salma(), TURTLEBOT, 0, 2, 1).unwrap();
    fleet.set(&farhad(), TURTLEBOT, 0, 1, 1).unwrap();
    fleet.set(&salma(), TURTLEBOT, 0, 3, 1).unwrap();
    assert_eq!(told(&fleet, 0), 2, "each of both once");
    let named = |fleet: &mut Fleet, ids: &[&str]| {
        let policies = ids.iter().map(|id| policy(id, ALL)).collect();
        fleet.ok(&owner(), "policy", &["apply", &json(&PolicyDraft { policies: Some(policies), ..set("") })]);
    };
    named(&mut fleet, &["all"]);
    fleet.set(&salma(), TURTLEBOT, 0, 4, 1).unwrap();
    let permitted: Permitted = fleet.newest("permitted");
    assert_eq!((permitted.policy_version, permitted.policies), (1, vec!["all".to_owned()]));
    named(&mut fleet, &["all", "also"]);
    fleet.set(&salma(), TURTLEBOT, 0, 5, 1).unwrap();
    fleet.set(&salma(), TURTLEBOT, 0, 6, 1).unwrap();
    let permitted: Permitted = fleet.newest("permitted");
    assert_eq!((permitted.policy_version, permitted.policies), (2, vec!["all".to_owned(), "also".to_owned()]));
    assert_eq!(told(&fleet, 0), 4);
}

#[test]
fn a_rollback_brings_policies_and_rule_of_an_earlier_set_back_as_a_new_one() {
    let mut fleet = Fleet::of_the_paper();
    fleet.ok(&owner(), "policy", &["apply", &json(&set("first"))]);
    let forbid = "permit (principal, action, resource) when { principal.name == \"Farhad\" };";
    let draft = PolicyDraft { policies: Some(vec![policy("one", forbid)]), ..set("second") };
    fleet.ok(&owner(), "policy", &["apply", &json(&draft)]);
    fleet.refused(&salma(), Code::DeniedByPolicy, "acquire", &[HUSKY]);
    let back = PolicyDraft { restores: Some(1), message: "it was too strict".into(), ..PolicyDraft::default() };
    let change: PolicyChange = fleet.get(&owner(), "policy", &["apply", &json(&back)]);
    assert_eq!((change.version, change.change.as_str()), (3, "restored"));
    fleet.ok(&salma(), "acquire", &[HUSKY]);
    let sets = history(&mut fleet);
    assert_eq!((sets[0].restores, &sets[0].hash), (Some(1), &sets[2].hash));
    let missing = PolicyDraft { restores: Some(9), ..PolicyDraft::default() };
    fleet.refused(&owner(), Code::NotFound, "policy", &["apply", &json(&missing)]);
}

#[test]
fn the_newest_sets_are_kept_and_texts_go_with_the_last_set_that_has_them() {
    let mut fleet = Fleet::of_the_paper();
    for number in 0..40 {
        let own = format!("// {number}\n{ALL}");
        let draft = PolicyDraft { policies: Some(vec![policy("same", ALL), policy("own", &own)]), ..set("") };
        fleet.ok(&owner(), "policy", &["apply", &json(&draft)]);
    }
    let sets = history(&mut fleet);
    assert_eq!((sets.len(), sets[0].version, sets[31].version), (32, 40, 9));
    assert_eq!(fleet.keys("text/Org2/"), 33, "one for each kept set, and the one that they share");
    let kept: PolicySetTexts = fleet.get(&salma(), "policy_set", &["Org2", "9"]);
    assert_eq!(kept.policies[1], policy("same", ALL));
    let gone = PolicyDraft { restores: Some(8), ..PolicyDraft::default() };
    fleet.refused(&owner(), Code::NotFound, "policy", &["apply", &json(&gone)]);
}

#[test]
fn a_set_that_was_made_from_another_one_than_that_in_force_is_refused() {
    let mut fleet = Fleet::of_the_paper();
    let draft = PolicyDraft { base: Some(0), ..set("first") };
    fleet.ok(&owner(), "policy", &["apply", &json(&draft)]);
    let refused = fleet.refused(&second(), Code::PoliciesChanged, "policy", &["apply", &json(&draft)]);
    assert_eq!((refused.found.as_str(), refused.wanted.starts_with("version 0")), ("version 1 in force", true));
}

#[test]
fn no_organisation_takes_the_room_of_another_ones_admins() {
    let mut fleet = two_of_admins();
    let proposed = propose(&mut fleet, &owner(), &set("more"));
    let strange = |number: u8| identity("Org1", &format!("admin{number}"), Role::Admin, &[], 100 + number);
    for number in 0..16 {
        fleet.ok(&strange(number), "policy", &["approve", &proposed.id]);
    }
    let refused = fleet.refused(&strange(16), Code::LimitExceeded, "policy", &["approve", &proposed.id]);
    assert!(refused.message.contains("admins of Org1"), "{refused}");
    fleet.ok(&strange(3), "policy", &["approve", &proposed.id]);
    fleet.ok(&second(), "policy", &["approve", &proposed.id]);
    fleet.lose_authority(&strange(0));
    let standing: PolicyProposal = fleet.get(&owner(), "policy", &["approve", &proposed.id]);
    let approved: Vec<_> = standing.approved.iter().map(|approval| approval.who.as_str()).collect();
    assert_eq!(approved, ["Org2/second", "Org2/admin"], "approvals end with the authority");
    fleet.ok(&owner(), "policy", &["enact", &proposed.id]);
}

#[test]
fn a_set_with_a_fault_is_refused_whole() {
    let mut fleet = Fleet::of_the_paper();
    let two = |one: &str, other: &str| {
        let policies = vec![policy("good", ALL), policy(one, other)];
        json(&PolicyDraft { policies: Some(policies), ..PolicyDraft::default() })
    };
    for (draft, code) in [
        (two("bad", "permit (principal"), Code::PolicyInvalid),
        (two("good", ALL), Code::BadArgument),
        (two("no/name", ALL), Code::BadName),
        (json(&PolicyDraft::default()), Code::BadArgument),
        (json(&PolicyDraft { restores: Some(1), ..set("") }), Code::BadArgument),
        (json(&set(&"m".repeat(513))), Code::BadArgument),
        (json(&PolicyDraft { approvals: Some("admins = 0".into()), ..set("") }), Code::BadArgument),
        (json(&PolicyDraft { approvals: Some("admins of Nobody = 1".into()), ..set("") }), Code::BadArgument),
        ("{\"policies\":[],\"more\":1}".to_owned(), Code::BadArgument),
    ] {
        fleet.refused(&owner(), code, "policy", &["apply", &draft]);
    }
    let many = (0..=QUOTAS.policies).map(|number| policy(&format!("p{number}"), ALL)).collect();
    let draft = PolicyDraft { policies: Some(many), ..PolicyDraft::default() };
    fleet.refused(&owner(), Code::QuotaReached, "policy", &["apply", &json(&draft)]);
    // Nobody asks about as many either: each is validated.
    let asked = Ask { action: "acquire".into(), service: HUSKY.into(), policies: draft.policies, ..Ask::default() };
    fleet.refused(&salma(), Code::LimitExceeded, "can", &[&serde_json::to_string(&asked).unwrap()]);
    assert_eq!(history(&mut fleet), []);
    fleet.refused(&salma(), Code::NotAdmin, "policy", &["apply", &json(&set(""))]);
}

#[test]
fn where_two_admins_must_agree_one_alone_changes_nothing_in_any_way() {
    let mut fleet = two_of_admins();
    for args in [
        vec!["put", "more", ALL],
        vec!["remove", "all"],
        vec!["apply", &json(&set("alone"))],
        vec!["apply", &json(&PolicyDraft { approvals: Some("none".into()), ..set("first") })],
        vec![
            "apply",
            &json(&PolicyDraft { restores: Some(1), approvals: Some("none".into()), ..PolicyDraft::default() }),
        ],
    ] {
        let refused = fleet.refused(&owner(), Code::NeedsApproval, "policy", &args);
        assert!(refused.wanted.starts_with("admins = 2, as Org2 requires: 1 more"), "{refused}");
    }
    let proposal = propose(&mut fleet, &owner(), &set("together"));
    fleet.refused(&owner(), Code::NeedsApproval, "policy", &["enact", &proposal.id]);
    assert_eq!(history(&mut fleet).len(), 1);
}

#[test]
fn a_proposal_comes_in_force_once_two_different_admins_agree_and_the_proposer_counts_once() {
    let mut fleet = two_of_admins();
    let proposal = propose(&mut fleet, &owner(), &set("together"));
    assert_eq!((proposal.needs[0].missing, proposal.approved.len()), (1, 1));
    // The same admin again, also with a new certificate, and an admin of another organisation.
    let again: PolicyProposal = fleet.get(&owner(), "policy", &["approve", &proposal.id]);
    assert_eq!((again.needs[0].missing, again.approved.len()), (1, 1));
    let renewed = identity("Org2", "admin", Role::Admin, &[], 77);
    let again: PolicyProposal = fleet.get(&renewed, "policy", &["approve", &proposal.id]);
    assert_eq!((again.needs[0].missing, again.approved.len()), (1, 1));
    let other: PolicyProposal = fleet.get(&admin1(), "policy", &["approve", &proposal.id]);
    assert_eq!(other.needs[0].missing, 1, "an admin of Org1 is none of Org2's");
    fleet.refused(&salma(), Code::NotAdmin, "policy", &["approve", &proposal.id]);
    let agreed: PolicyProposal = fleet.get(&second(), "policy", &["approve", &proposal.id]);
    assert_eq!(agreed.needs[0].missing, 0);
    fleet.refused(&admin1(), Code::NotOwner, "policy", &["enact", &proposal.id]);
    let change: PolicyChange = fleet.get(&second(), "policy", &["enact", &proposal.id]);
    assert_eq!((change.version, change.by.as_str(), change.message.as_str()), (2, "Org2/admin", "together"));
    let newest = history(&mut fleet).remove(0);
    assert_eq!(newest.approved_by, ["Org2/admin", "Org1/admin", "Org2/second"]);
    assert_eq!((newest.approvals.as_deref(), newest.break_glass), (Some("admins = 2"), false), "the rule stays");
    fleet.refused(&second(), Code::NotFound, "policy", &["enact", &proposal.id]);
}

#[test]
fn an_approval_counts_for_seven_days_and_ends_with_a_revoked_certificate() {
    let mut fleet = two_of_admins();
    let proposal = propose(&mut fleet, &owner(), &set("together"));
    fleet.ok(&second(), "policy", &["approve", &proposal.id]);
    fleet.revoke(&second());
    let refused = fleet.refused(&owner(), Code::NeedsApproval, "policy", &["enact", &proposal.id]);
    assert_eq!(refused.found, "approved by Org2/admin");
    fleet.ok(&third(), "policy", &["approve", &proposal.id]);
    fleet.time += 7 * DAY;
    fleet.ok(&third(), "policy", &["approve", &proposal.id]);
    let refused = fleet.refused(&owner(), Code::NeedsApproval, "policy", &["enact", &proposal.id]);
    assert_eq!(refused.found, "approved by Org2/third", "the proposer's own has ended");
    fleet.ok(&owner(), "policy", &["approve", &proposal.id]);
    fleet.ok(&owner(), "policy", &["enact", &proposal.id]);
}

#[test]
fn a_proposal_replaces_only_the_set_that_it_was_made_for() {
    let mut fleet = two_of_admins();
    let first = propose(&mut fleet, &owner(), &set("one"));
    let other = propose(&mut fleet, &second(), &set("other"));
    for proposal in [&first, &other] {
        fleet.ok(&owner(), "policy", &["approve", &proposal.id]);
        fleet.ok(&second(), "policy", &["approve", &proposal.id]);
    }
    fleet.ok(&owner(), "policy", &["enact", &first.id]);
    fleet.refused(&owner(), Code::PoliciesChanged, "policy", &["enact", &other.id]);
    fleet.refused(&third(), Code::PoliciesChanged, "policy", &["approve", &other.id]);
    fleet.ok(&third(), "policy", &["withdraw", &other.id]);
    let left: Vec<PolicyProposal> = fleet.get(&salma(), "policy_proposals", &[]);
    assert_eq!(left, []);
    assert_eq!(fleet.keys("text/Org2/"), 2, "texts of the two sets, and none of the withdrawn one");
}

#[test]
fn proposals_are_few_and_show_their_texts_to_who_shall_approve_them() {
    let mut fleet = two_of_admins();
    let mut last = String::new();
    for number in 0..8 {
        last = propose(&mut fleet, &owner(), &set(&format!("number {number}"))).id;
    }
    fleet.refused(&owner(), Code::LimitExceeded, "policy", &["propose", &json(&set("one more"))]);
    let shown: PolicyProposalTexts = fleet.get(&second(), "policy_proposal", &[&last]);
    assert_eq!(shown.policies, [policy("all", &format!("// number 7\n{ALL}"))]);
    // Another organisation has its own place.
    propose(&mut fleet, &admin1(), &set("of Org1"));
    fleet.refused(&owner(), Code::AlreadyExists, "policy", &["propose", &json(&set("first"))]);
    fleet.refused(&admin1(), Code::NotFound, "policy", &["withdraw", &last]);
    fleet.refused(&second(), Code::NotFound, "policy", &["approve", &last[..12]]);
}

#[test]
fn the_network_may_demand_that_other_organisations_agree_and_no_glass_breaks_that() {
    let mut fleet = Fleet::of_the_paper();
    fleet.refused(&owner(), Code::NeedsApproval, "set_policy_approvals", &["organisations = 2"]);
    fleet.approved("set_policy_approvals", &["organisations = 2"]);
    let rules: PolicyApprovals = fleet.get(&salma(), "policy_approvals", &["Org2"]);
    assert_eq!((rules.network.as_deref(), rules.own), (Some("organisations = 2"), None));
    let refused = fleet.refused(&owner(), Code::NeedsApproval, "policy", &["put", "all", ALL]);
    assert!(refused.wanted.contains("as the network requires"), "{refused}");
    let proposal = propose(&mut fleet, &owner(), &set("for both"));
    fleet.ok(&second(), "policy", &["approve", &proposal.id]);
    fleet.refused(&owner(), Code::NeedsApproval, "policy", &["enact", &proposal.id]);
    fleet.time += 4 * DAY;
    fleet.refused(&owner(), Code::NeedsApproval, "policy", &["enact", &proposal.id, "break-glass"]);
    fleet.ok(&admin1(), "policy", &["approve", &proposal.id]);
    fleet.ok(&owner(), "policy", &["enact", &proposal.id]);
    // Nobody else can propose for Org2.
    let foreign = propose(&mut fleet, &admin1(), &set("foreign"));
    assert_eq!(foreign.organisation, "Org1");
}

#[test]
fn an_organisation_whose_own_rule_nobody_can_meet_gets_out_of_it_after_three_days() {
    let mut fleet = Fleet::of_the_paper();
    let draft = PolicyDraft { approvals: Some("admins = 16".into()), ..set("first") };
    fleet.ok(&owner(), "policy", &["apply", &json(&draft)]);
    let free = PolicyDraft { approvals: Some("none".into()), ..set("free again") };
    let proposal = propose(&mut fleet, &owner(), &free);
    let refused = fleet.refused(&owner(), Code::NeedsApproval, "policy", &["enact", &proposal.id, "break-glass"]);
    assert!(refused.advice().contains("or 72 hours: then"), "{refused}");
    fleet.time += 3 * DAY;
    fleet.refused(&owner(), Code::NeedsApproval, "policy", &["enact", &proposal.id]);
    fleet.ok(&owner(), "policy", &["enact", &proposal.id, "break-glass"]);
    let newest = history(&mut fleet).remove(0);
    assert!(newest.break_glass && newest.approvals.is_none());
    fleet.ok(&owner(), "policy", &["put", "more", ALL]);
}

#[test]
fn a_set_under_which_nobody_may_publish_to_a_robot_is_put_only_by_who_means_it() {
    let mut fleet = Fleet::of_the_paper();
    let nobody = "forbid (principal, action, resource in Robot::\"Husky\");";
    // Where no CA of the network has issued a certificate, nobody can tell who there is.
    fleet.ok(&owner(), "policy", &["put", "nobody", nobody]);
    fleet.ok(&owner(), "policy", &["remove", "nobody"]);
    *fleet.members.2.lock().unwrap() = vec!["Org1/Salma", "Org1/Farhad", "Org2/admin"];
    let draft = |means_it| PolicyDraft {
        policies: Some(vec![policy("all", ALL), policy("nobody", nobody)]),
        means_it,
        ..PolicyDraft::default()
    };
    let refused = fleet.refused(&owner(), Code::NobodyMayPublish, "policy", &["apply", &json(&draft(false))]);
    assert_eq!(refused.found, "Husky");
    fleet.refused(&owner(), Code::NobodyMayPublish, "policy", &["propose", &json(&draft(false))]);
    fleet.ok(&owner(), "policy", &["apply", &json(&draft(true))]);
    // It is said once: another set leaves the robot as it is. One that closes another robot is refused again.
    fleet.ok(&owner(), "policy", &["put", "other", nobody]);
    let all = "forbid (principal, action, resource);";
    let refused = fleet.refused(&owner(), Code::NobodyMayPublish, "policy", &["put", "other", all]);
    assert_eq!(refused.found, "Turtlebot4");
    fleet.ok(&owner(), "policy", &["put", "other", all, "i-mean-it"]);
    // A window that is closed now opens again.
    let night = "@between(\"02:00-03:00 Z\")\npermit (principal, action, resource);";
    let draft = PolicyDraft { policies: Some(vec![policy("night", night)]), ..PolicyDraft::default() };
    fleet.ok(&owner(), "policy", &["apply", &json(&draft)]);
}

#[test]
fn sets_proposals_and_policies_of_an_organisation_that_leaves_are_forgotten_and_numbers_go_on() {
    let mut fleet = two_of_admins();
    propose(&mut fleet, &owner(), &set("together"));
    fleet.remove_organisation("Org2");
    for prefix in ["policy/Org2/", "text/Org2/", "set/Org2/", "proposed/"] {
        assert_eq!(fleet.keys(prefix), 0, "{prefix}");
    }
    let change: PolicyChange = fleet.get(&owner(), "policy", &["put", "all", ALL]);
    assert_eq!(change.version, 2);
}

#[test]
fn approvals_and_rules_of_an_organisation_that_leaves_count_no_more() {
    let mut fleet = Fleet::of_the_paper();
    fleet.approved("set_policy_approvals", &["admins of Org1 = 1"]);
    let proposed = propose(&mut fleet, &owner(), &set("more"));
    fleet.refused(&owner(), Code::NeedsApproval, "policy", &["enact", &proposed.id]);
    fleet.ok(&admin1(), "policy", &["approve", &proposed.id]);
    fleet.remove_organisation("Org1");
    fleet.members.0.lock().unwrap().retain(|name| *name != "Org1");
    let standing: PolicyProposal = fleet.get(&owner(), "policy", &["approve", &proposed.id]);
    let approved: Vec<_> = standing.approved.iter().map(|approval| approval.who.as_str()).collect();
    assert_eq!((approved, fleet.keys("approving/")), (vec!["Org2/admin"], 1));
    // Nobody could ever meet that rule again.
    fleet.ok(&owner(), "policy", &["enact", &proposed.id]);
}

#[test]
fn a_holder_of_an_earlier_set_keeps_what_the_new_one_permits() {
    let mut fleet = Fleet::of_the_paper();
    let acquired: Acquired = fleet.get(&salma(), "acquire", &[HUSKY]);
    assert!(matches!(acquired, Acquired::Granted(_)));
    let change: PolicyChange = fleet.get(&owner(), "policy", &["apply", &json(&set("first"))]);
    assert_eq!(change.ended, []);
    fleet.set(&salma(), HUSKY, 1, 1, 1).unwrap();
}
