//! Questions about permission. They only read, and change nothing.
//!
//! They ask for permission alone: whether the service is free, is another question.

use crate::arguments::{Arguments, shown};
use crate::lifecycle::policy_sets;
use crate::policy::action::{Action, Object, RobotAction};
use crate::policy::decider::Decider;
use crate::policy::explain::Explanation;
use crate::policy::{Texts, Verdict, by_rule, limits, refusal, texts};
use crate::records::principal::Principal;
use crate::records::target::Target;
use crate::records::{robot, target};
use ledger::Context;
use ledger_base::hash::Hash;
use ledger_base::nearest::did_you_mean;
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{Ask, Can, PolicyText};

/// Longest question, in bytes: with it come policies.
pub(crate) const ASK_BYTES_MAX: usize = 1024 * 1024;

/// An explained decision takes the steps of N others.
const EXPLAINED_STEPS: u64 = 8;

/// Actions on services, as policies name them.
pub(crate) const OF_SERVICE: [Action; 5] =
    [Action::Acquire, Action::Publish, Action::Subscribe, Action::Override, Action::Confirm];

/// Actions on robots.
pub(crate) const OF_ROBOT: [RobotAction; 2] = [RobotAction::Stop, RobotAction::Resume];

pub(crate) fn read(args: Arguments<'_>) -> Result<Ask, Rejection> {
    let wanted = "JSON with action and service, and some of who, at and policies";
    serde_json::from_str(args.document(0, "ASK_JSON", ASK_BYTES_MAX)?)
        .map_err(|fault| args.bad(0, "ASK_JSON", fault.to_string(), wanted))
}

/// The object of a question.
pub(crate) enum Asked {
    /// With all rights that the action needs.
    Service(Box<Target>, Vec<Action>),
    Robot(robot::Robot, RobotAction),
}

/// A question about anybody.
pub(crate) struct Case {
    pub(crate) action: String,
    pub(crate) asked: Asked,
    pub(crate) texts: Texts,
    /// The number of the set in force; 0 for policies of the question.
    pub(crate) version: u64,
    pub(crate) steps: u64,
    /// Microseconds since the UNIX epoch.
    pub(crate) time: u64,
}

impl Case {
    pub(crate) fn of(ctx: &Context<'_>, decider: &Decider, ask: &Ask) -> Result<Self, Rejection> {
        let name = ask.action.as_str();
        let asked = if let Some(action) = OF_ROBOT.into_iter().find(|action| action.name() == name) {
            let (robot, _) = target::split(&ask.service);
            Asked::Robot(robot::find(ctx, robot)?, action)
        } else if let Some(action) = OF_SERVICE.into_iter().find(|action| action.name() == name) {
            let target = target::resolve(ctx, &ask.service)?;
            let needed = needed(&target, action);
            Asked::Service(Box::new(target), needed)
        } else {
            let names = OF_SERVICE.map(Action::name).into_iter().chain(OF_ROBOT.map(RobotAction::name));
            let names: Vec<&str> = names.collect();
            return Err(Rejection::new(Code::BadArgument, "there is no action of this name")
                .found(shown(name))
                .wanted(names.join(", "))
                .next(did_you_mean(name, names, "")));
        };
        let owner = &asked.robot().organisation;
        let (texts, version) = match &ask.policies {
            Some(policies) => (given(ctx, decider, policies)?, 0),
            None => (texts::in_force(ctx, owner)?, texts::version(ctx, owner)?.number),
        };
        let steps = limits::steps_of_all(&texts)?;
        let time = ask.at.unwrap_or(ctx.block_time());
        Ok(Self { action: name.to_owned(), asked, texts, version, steps, time })
    }

    pub(crate) fn judge(&self, ctx: &Context<'_>, decider: &Decider, principal: &Principal) -> Result<Can, Rejection> {
        let robot = self.asked.robot();
        let explain = |object: Object<'_>| {
            let question = || Hash::of(&[&principal.fingerprint.0, object.action().as_bytes()]);
            ctx.charge_steps(&robot.organisation, self.steps.saturating_mul(EXPLAINED_STEPS), question);
            decider.explain(principal, object, &self.texts, self.time)
        };
        let mut deciding = Vec::new();
        let mut permits = |why: Explanation| {
            let new: Vec<String> = why.deciding.into_iter().filter(|id| !deciding.contains(id)).collect();
            deciding.extend(new);
        };
        let (mut denial, mut rule) = (None, String::new());
        match &self.asked {
            Asked::Service(_, actions) if self.owner_may(principal) && actions.iter().all(Action::is_of_owner) => {
                by_rule::OF_OWNER.clone_into(&mut rule);
            }
            Asked::Robot(..) if self.owner_may(principal) => by_rule::OF_OWNER.clone_into(&mut rule),
            Asked::Service(target, actions) => {
                for action in actions {
                    match explain(Object::Service(target, *action))? {
                        (Verdict::Permit(_), why) => permits(why),
                        (verdict, why) => {
                            let refused = refusal::explain(principal, target, *action, verdict, || why.clone());
                            denial = Some((refused, why));
                            break;
                        }
                    }
                }
            }
            Asked::Robot(robot, action) => match explain(Object::Robot(robot, *action))? {
                (Verdict::Permit(_), why) => permits(why),
                (verdict, why) => {
                    let by_rule = match action {
                        RobotAction::Stop => by_rule::stops(ctx, principal, robot)?,
                        RobotAction::Resume => None,
                    };
                    let (verdict, why, reason) = match by_rule {
                        Some(reason) => {
                            let (verdict, why) = explain(Object::ByRule(robot, *action))?;
                            (verdict, why, reason)
                        }
                        None => (verdict, why, String::new()),
                    };
                    match verdict {
                        Verdict::Permit(_) => rule = reason,
                        verdict => {
                            let refused = refusal::explain_robot(principal, robot, *action, verdict, || why.clone());
                            denial = Some((refused, why));
                        }
                    }
                }
            },
        }
        let allowed = denial.is_none();
        let (refused, why) = denial.unwrap_or_else(|| (Rejection::new(Code::Ok, ""), Explanation::default()));
        Ok(Can {
            who: principal.id(),
            action: self.action.clone(),
            service: self.asked.id().to_owned(),
            allowed,
            code: refused.code.to_string(),
            name: refused.code.name().to_owned(),
            next: refused.advice().to_owned(),
            reason: refused.message,
            found: refused.found,
            wanted: refused.wanted,
            policies: if allowed { deciding } else { why.deciding },
            rule,
            conditions: why.conditions,
            policy_version: self.version,
        })
    }

    fn owner_may(&self, principal: &Principal) -> bool {
        principal.governs(self.asked.robot())
    }
}

impl Asked {
    fn robot(&self) -> &robot::Robot {
        match self {
            Self::Service(target, _) => &target.robot,
            Self::Robot(robot, _) => robot,
        }
    }

    fn id(&self) -> &str {
        match self {
            Self::Service(target, _) => &target.id,
            Self::Robot(robot, _) => &robot.name,
        }
    }
}

/// The rights that an action needs.
pub(crate) fn needed(target: &Target, action: Action) -> Vec<Action> {
    match action {
        Action::Acquire if target.is_for_readers() => vec![Action::Subscribe],
        Action::Acquire => vec![Action::Acquire, Action::Publish],
        action => vec![action],
    }
}

/// The policies of a question; the built-in one if there are none.
pub(crate) fn given(ctx: &Context<'_>, decider: &Decider, policies: &[PolicyText]) -> Result<Texts, Rejection> {
    let texts = policy_sets::checked(ctx, decider, policies)?;
    Ok(if texts.is_empty() { texts::built_in() } else { texts })
}
