//! The rights of people on robots, under the policies in force or under others, and how they differ.

use crate::lifecycle::people;
use crate::policy::action::{Action, Object, RobotAction};
use crate::policy::decider::Decider;
use crate::policy::texts::TextSet;
use crate::policy::{Permit, Verdict, by_rule};
use crate::records::principal::Principal;
use crate::records::robot::Robot;
use crate::records::store;
use crate::records::target::Target;
use ledger::{Context, Page, Paging};
use ledger_base::hash::Hash;
use ledger_base::rejection::Rejection;
use ledger_contract::{LimitChange, PolicyDiff, Right, RightOf};
use std::collections::BTreeSet;

/// Most questions to the policies in one comparison.
const QUESTIONS_MAX: usize = 16 * 1024;
/// Questions about a service, and about a robot.
const OF_SERVICE: usize = 5;
const OF_ROBOT: usize = 2;
/// Most steps of all questions of one comparison.
const STEPS_MAX: u64 = 128 * 1024 * 1024;
/// Most rights that a comparison lists of each kind.
const LISTED_MAX: usize = 1024;

/// All rights of a person on a robot at a time (microseconds).
///
/// # Errors
/// The store; a fault of the machinery that decides.
pub(crate) fn rights(
    ctx: &Context<'_>,
    decider: &Decider,
    principal: &Principal,
    robot: &Robot,
    set: &TextSet,
    time: u64,
) -> Result<Vec<Right>, Rejection> {
    let questions = (robot.services.len() * OF_SERVICE + OF_ROBOT) as u64;
    let name = || Hash::of(&[b"rights\0", &principal.fingerprint.0, &robot.version.0, &set.hash.0]);
    ctx.charge_steps(&robot.organisation, set.steps.saturating_mul(questions), name);
    let ask = |object: Object<'_>| decider.decide_by(ctx, principal, object, set, time);
    let governs = principal.governs(robot);
    let mut rights = Vec::new();
    for target in robot.services.iter().map(|service| Target::of(robot, service)) {
        let of_service = |action: Action| ask(Object::Service(&target, action));
        let publish = of_service(Action::Publish)?;
        let acquire = both(of_service(Action::Acquire)?, &publish);
        rights.extend(right(&target.id, Action::Acquire.name(), acquire));
        rights.extend(right(&target.id, Action::Publish.name(), publish));
        rights.extend(right(&target.id, Action::Subscribe.name(), of_service(Action::Subscribe)?));
        for action in [Action::Override, Action::Confirm] {
            match governs {
                true => rights.push(given_by(&target.id, action.name(), by_rule::OF_OWNER.to_owned())),
                false => rights.extend(right(&target.id, action.name(), of_service(action)?)),
            }
        }
    }
    for action in [RobotAction::Stop, RobotAction::Resume] {
        if governs {
            rights.push(given_by(&robot.name, action.name(), by_rule::OF_OWNER.to_owned()));
            continue;
        }
        match right(&robot.name, action.name(), ask(Object::Robot(robot, action))?) {
            Some(right) => rights.push(right),
            None if action == RobotAction::Stop => {
                if let Some(reason) = by_rule::stops(ctx, principal, robot)?
                    && matches!(ask(Object::ByRule(robot, action))?, Verdict::Permit(_))
                {
                    rights.push(given_by(&robot.name, action.name(), reason));
                }
            }
            None => {}
        }
    }
    Ok(rights)
}

fn right(of: &str, action: &str, verdict: Verdict) -> Option<Right> {
    let (permit, closed) = match verdict {
        Verdict::Permit(permit) => (permit, Vec::new()),
        Verdict::Closed(windows) => (Permit::default(), windows),
        Verdict::NotPermitted { .. } | Verdict::Forbidden(_) | Verdict::Fault(_) => return None,
    };
    let Permit { limits, policies, .. } = permit;
    Some(Right { of: of.to_owned(), action: action.to_owned(), policies, rule: String::new(), limits, closed })
}

fn given_by(of: &str, action: &str, rule: String) -> Right {
    let (of, action) = (of.to_owned(), action.to_owned());
    Right { of, action, policies: Vec::new(), rule, limits: ledger_contract::Limits::default(), closed: Vec::new() }
}

/// The verdict on a use that needs both.
fn both(one: Verdict, other: &Verdict) -> Verdict {
    match (one, other) {
        (Verdict::Permit(one), Verdict::Permit(other)) => Verdict::Permit(one.and(other.clone())),
        (Verdict::Closed(one), Verdict::Closed(other)) => {
            Verdict::Closed(BTreeSet::from_iter(one.into_iter().chain(other.clone())).into_iter().collect())
        }
        (Verdict::Permit(_), other) => other.clone(),
        (one, _) => one,
    }
}

/// A page of the people to whom a CA of the network has issued a certificate that counts.
///
/// # Errors
/// The page cannot be read.
pub(crate) fn people_of(ctx: &mut Context<'_>, paging: &Paging) -> Result<Page<Principal>, Rejection> {
    let page = ctx.call("msp", "enrolled", &[store::json(paging)?])?;
    let page: Page<String> = store::parse(b"msp enrolled", &page)?;
    let items = page.items.iter().filter_map(|id| people::certified(ctx, id).ok()).collect();
    Ok(Page { items, next: page.next })
}

/// Enters the rights that people gain, lose or keep with other limits in a difference of policies, on some robots as they are now and
/// then.
///
/// # Errors
/// As [`rights`].
pub(crate) fn compare(
    ctx: &mut Context<'_>,
    decider: &Decider,
    robots: &[(Option<Robot>, Option<Robot>)],
    (before, after): (&TextSet, &TextSet),
    time: u64,
    diff: &mut PolicyDiff,
) -> Result<(), Rejection> {
    let of_robot = |robot: &Robot| robot.services.len() * OF_SERVICE + OF_ROBOT;
    let of_person: usize = robots.iter().flat_map(|(now, then)| [now, then]).flatten().map(of_robot).sum();
    let steps = before.steps.max(after.steps).max(1);
    let most = QUESTIONS_MAX.min(usize::try_from(STEPS_MAX / steps).unwrap_or(QUESTIONS_MAX));
    let (mut asked, mut after_name) = (0, None);
    loop {
        let page = people_of(ctx, &Paging::at(after_name))?;
        for principal in page.items {
            asked += of_person;
            if asked > most {
                diff.incomplete = true;
                return Ok(());
            }
            for (now, then) in robots {
                let ask = |robot: &Option<Robot>, set| match robot {
                    Some(robot) => rights(ctx, decider, &principal, robot, set, time),
                    None => Ok(Vec::new()),
                };
                let (now, then) = (ask(now, before)?, ask(then, after)?);
                enter(&principal.id(), now, then, diff);
            }
        }
        after_name = page.next;
        if after_name.is_none() {
            return Ok(());
        }
    }
}

fn enter(who: &str, now: Vec<Right>, then: Vec<Right>, diff: &mut PolicyDiff) {
    let is_same = |one: &Right, other: &Right| one.of == other.of && one.action == other.action;
    let missing = |from: &[Right], among: &[Right]| -> Vec<RightOf> {
        let missing = from.iter().filter(|right| !among.iter().any(|other| is_same(right, other)));
        missing.map(|right| RightOf { who: who.to_owned(), right: right.clone() }).collect()
    };
    diff.gained.extend(missing(&then, &now));
    diff.lost.extend(missing(&now, &then));
    for (before, after) in now.iter().filter_map(|now| Some((now, then.iter().find(|then| is_same(now, then))?))) {
        if before.limits != after.limits && before.closed.is_empty() && after.closed.is_empty() {
            let Right { of, action, limits, .. } = before.clone();
            diff.limited.push(LimitChange {
                who: who.to_owned(),
                of,
                action,
                before: limits,
                after: after.limits.clone(),
            });
        }
    }
    for list in [&mut diff.gained, &mut diff.lost] {
        diff.incomplete |= list.len() > LISTED_MAX;
        list.truncate(LISTED_MAX);
    }
    diff.incomplete |= diff.limited.len() > LISTED_MAX;
    diff.limited.truncate(LISTED_MAX);
}
