//! Why policies deny, in words.

use super::Verdict;
use super::action::{Action, RobotAction};
use super::explain::Explanation;
use crate::records::principal::Principal;
use crate::records::robot::Robot;
use crate::records::target::Target;
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{Condition, Direction};
use std::collections::BTreeSet;

/// Those who stop a robot by rule.
const BY_RULE: &str = " the robot itself, a holder of one of its command services,";

/// The refusal: what somebody can do something about comes first.
pub(crate) fn explain(
    principal: &Principal,
    target: &Target,
    action: Action,
    verdict: Verdict,
    why: impl FnOnce() -> Explanation,
) -> Rejection {
    let (robot, who) = (&target.robot, principal.id());
    let owner = &robot.organisation;
    let (attribute, value) = robot.required();
    let verb = match action {
        Action::Acquire => "acquire",
        Action::Publish => "publish on",
        Action::Subscribe => "subscribe to",
        Action::Override => "take",
        Action::Confirm => "confirm who acquires",
    };
    let refused = format!("{who} may not {verb} {}", target.id);
    let ask_owner = format!("ask an admin of {owner}");
    // Policies that look at something else deny for another reason.
    let of_required = !matches!(verdict, Verdict::NotPermitted { of_required: false });
    match verdict {
        Verdict::Fault(fault) => {
            return Rejection::new(Code::PolicyError, format!("{refused}: a policy of {owner} cannot be evaluated"))
                .found(fault)
                .wanted("policies that evaluate without errors")
                .next(format!("{ask_owner} to correct it: ledgerctl policy list"));
        }
        Verdict::Forbidden(ids) => {
            return Rejection::new(Code::DeniedByPolicy, format!("{refused}: a policy of {owner} forbids it"))
                .found(forbidden(&ids, &why()))
                .wanted("no policy that forbids it")
                .next(format!("{ask_owner}, or read it: ledgerctl policy list"));
        }
        Verdict::Closed(windows) => return closed(owner, refused, &windows),
        Verdict::Permit(_) | Verdict::NotPermitted { .. } => {}
    }
    if matches!(action, Action::Override | Action::Confirm) {
        return may_not(principal, owner, refused, action.name(), &why());
    }
    if of_required && target.service.direction == Direction::Feed && action != Action::Subscribe {
        return Rejection::new(Code::DeniedByPolicy, format!("{refused}: it is a feed of the robot"))
            .found(format!("role {} of {}", principal.role, principal.organisation))
            .wanted(format!(
                "a call that the policies of {owner} permit; by default those of its robots, nodes and admins"
            ))
            .next(format!("subscribe to it: ledgerctl echo {}", target.id));
    }
    if of_required && !robot.trusted.contains(&principal.organisation) {
        return Rejection::new(Code::DeniedByPolicy, format!("{refused}: {owner} does not trust its organisation"))
            .found(format!("organisation {}", principal.organisation))
            .wanted(format!("one of {}", robot.trusted.join(", ")))
            .next(format!(
                "{ask_owner}: ledgerctl share {name} --with {who}, or, so that all attributes of {org} count, \
                 ledgerctl robot set {name} trust={trusted},{org}",
                name = robot.name,
                org = principal.organisation,
                trusted = robot.trusted.join(",")
            ));
    }
    if of_required && principal.attributes.get(attribute).map(String::as_str) != Some(value) {
        let carried: Vec<String> = principal.attributes.iter().map(|(key, value)| format!("{key}={value}")).collect();
        let found = if carried.is_empty() { "no attributes".to_owned() } else { carried.join(", ") };
        return Rejection::new(
            Code::MissingAttribute,
            format!("{refused}: the certificate lacks the attribute {attribute}={value}"),
        )
        .found(format!("attributes {found}").replace("attributes no ", "no "))
        .wanted(format!("attribute {attribute}={value}, as {} requires", robot.name))
        .next(format!("ask an admin of {} for the attribute, then enrol again", principal.organisation));
    }
    let refusal = Rejection::new(Code::DeniedByPolicy, format!("{refused}: no policy of {owner} permits it"))
        .next(format!("{ask_owner}, or read the policies: ledgerctl policy list"));
    match nearest(&why()) {
        Some((found, wanted)) => refusal.found(found).wanted(wanted),
        None => refusal
            .found(format!("role {}, attribute {attribute}={value}", principal.role))
            .wanted("a policy that permits it"),
    }
}

/// The conditions of the nearest policy that fail: what was found, and what is wanted.
fn nearest(why: &Explanation) -> Option<(String, String)> {
    let policy = &why.conditions.first()?.policy;
    let failed: Vec<&Condition> = why.conditions.iter().filter(|failed| failed.policy == *policy).collect();
    let found: Vec<&str> = failed.iter().map(|failed| failed.found.as_str()).collect();
    let wanted: Vec<&str> = failed.iter().map(|failed| failed.wanted.as_str()).collect();
    Some((
        found.join("; "),
        format!("{}, as policy {policy} requires, or another policy that permits it", wanted.join("; ")),
    ))
}

/// The policies that forbid something, and on what they have looked.
fn forbidden(ids: &[String], why: &Explanation) -> String {
    let found: BTreeSet<&str> = why.conditions.iter().map(|held| held.found.as_str()).collect();
    let found: Vec<&str> = found.into_iter().collect();
    let because = if found.is_empty() { String::new() } else { format!(", because {}", found.join("; ")) };
    format!("forbidden by {}{because}", ids.join(", "))
}

/// The refusal of what policies permit at other times.
fn closed(owner: &str, refused: String, windows: &[String]) -> Rejection {
    Rejection::new(Code::DeniedByPolicy, format!("{refused} now: the policies of {owner} permit it at other times"))
        .found("a time outside all windows")
        .wanted(format!("a time within {}", windows.join(", or ")))
        .next("try again within a window")
}

/// The refusal of something that the owner's admins may always do, and others if a policy permits the action.
fn may_not(principal: &Principal, owner: &str, refused: String, action: &str, why: &Explanation) -> Rejection {
    // The nearest policy shows what is missing; its condition and its value belong to the lines of their own.
    let (found, or) = match nearest(why) {
        Some((found, wanted)) => (format!("; {found}"), format!("; or {wanted}")),
        None => (String::new(), String::new()),
    };
    let by_rule = if action == RobotAction::Stop.name() { BY_RULE } else { "" };
    Rejection::new(Code::DeniedByPolicy, format!("{refused}: no policy of {owner} permits {action}"))
        .found(format!("role {} of {}{found}", principal.role, principal.organisation))
        .wanted(format!("an admin of {owner},{by_rule} or a permit that names the action {action}{or}"))
        .next(format!("ask an admin of {owner}, or read the policies: ledgerctl policy list"))
}

/// The refusal of an action on a whole robot.
pub(crate) fn explain_robot(
    principal: &Principal,
    robot: &Robot,
    action: RobotAction,
    verdict: Verdict,
    why: impl FnOnce() -> Explanation,
) -> Rejection {
    let (owner, action) = (&robot.organisation, action.name());
    let refused = format!("{} may not {action} {}", principal.id(), robot.name);
    match verdict {
        Verdict::Fault(fault) => {
            Rejection::new(Code::PolicyError, format!("{refused}: a policy of {owner} cannot be evaluated"))
                .found(fault)
                .wanted("policies that evaluate without errors")
                .next(format!("ask an admin of {owner} to correct it: ledgerctl policy list"))
        }
        Verdict::Forbidden(ids) => {
            Rejection::new(Code::DeniedByPolicy, format!("{refused}: a policy of {owner} forbids it"))
                .found(forbidden(&ids, &why()))
                .wanted("no policy that forbids it")
                .next(format!("ask an admin of {owner}, or read it: ledgerctl policy list"))
        }
        Verdict::Closed(windows) => closed(owner, refused, &windows),
        Verdict::Permit(_) | Verdict::NotPermitted { .. } => may_not(principal, owner, refused, action, &why()),
    }
}
