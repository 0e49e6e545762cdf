//! May somebody do something, and why: `can`, `could`, `check` and `diff`. They only read, and change nothing.
//!
//! They ask for permission alone: whether the service is free, is another question.

use super::{delegate, policy_sets, reachable};
use crate::arguments::{Arguments, shown};
use crate::policy::decider::{Action, Decider, Object, RobotAction};
use crate::policy::explain::Explanation;
use crate::policy::limits;
use crate::policy::{Texts, Verdict, refusal, texts};
use crate::records::principal::Principal;
use crate::records::service::Target;
use crate::records::{grant, robot, service, store};
use bytes::Bytes;
use ledger::{Context, Page};
use ledger_base::hash::Hash;
use ledger_base::nearest::did_you_mean;
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{Ask, Can, Could, Grant, PolicyDiff, PolicyText, WouldEnd};
use serde::Deserialize;

/// Longest question, in bytes: with it come policies.
const ASK_BYTES_MAX: usize = 1024 * 1024;
/// An explained decision takes the steps of so many others.
const EXPLAINED_STEPS: u64 = 8;
/// Actions on services, as policies name them.
const OF_SERVICE: [Action; 5] =
    [Action::Acquire, Action::Publish, Action::Subscribe, Action::Override, Action::Confirm];
/// Actions on robots.
const OF_ROBOT: [RobotAction; 2] = [RobotAction::Stop, RobotAction::Resume];

/// `can ASK_JSON`: may this person do that, and why?
pub(crate) fn can(ctx: &mut Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("can ASK_JSON", args, 1, 1)?;
    let ask = read(args)?;
    let caller = Principal::of(ctx.submitter()?);
    let principal = match &ask.who {
        Some(who) if *who != caller.id() => delegate::certified(ctx, who)?,
        _ => caller,
    };
    let case = Case::of(ctx, decider, &ask)?;
    store::json(&case.judge(ctx, decider, &principal)?)
}

/// `could ASK_JSON PAGE_JSON`: who of the caller's organisation may do that? For its admins.
pub(crate) fn could(ctx: &mut Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    /// The part of a registration that is of use here.
    #[derive(Deserialize)]
    struct Registered {
        organisation: String,
        name: String,
    }
    let args = Arguments::new("could ASK_JSON PAGE_JSON", args, 2, 2)?;
    let ask = read(args)?;
    let page = args.document(1, "PAGE_JSON", ASK_BYTES_MAX)?;
    if !page.starts_with('{') {
        return Err(args.bad(1, "PAGE_JSON", shown(page), "JSON of a page; {} is the first one"));
    }
    let case = Case::of(ctx, decider, &ask)?;
    let page = ctx.call("msp", "identities", &[Bytes::copy_from_slice(page.as_bytes())])?;
    let page: Page<Registered> = store::parse(b"msp identities", &page)?;
    let mut items = Vec::new();
    for Registered { organisation, name } in page.items {
        // Some have not enrolled yet, or no longer count.
        let Ok(principal) = delegate::certified(ctx, &format!("{organisation}/{name}")) else { continue };
        let Can { who, allowed, policies, .. } = case.judge(ctx, decider, &principal)?;
        items.push(Could { who, allowed, policies });
    }
    store::json(&Page { items, next: page.next })
}

/// `check TEXT`: the faults of a policy with their places; none if it is acceptable.
pub(crate) fn check(decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("check TEXT", args, 1, 1)?;
    store::json(&decider.diagnose(args.document(0, "TEXT", ASK_BYTES_MAX)?))
}

fn read(args: Arguments<'_>) -> Result<Ask, Rejection> {
    let wanted = "JSON with action and service, and some of who, at and policies";
    serde_json::from_str(args.document(0, "ASK_JSON", ASK_BYTES_MAX)?)
        .map_err(|fault| args.bad(0, "ASK_JSON", fault.to_string(), wanted))
}

/// The object of a question.
enum Asked {
    /// With all rights that the action needs.
    Service(Box<Target>, Vec<Action>),
    Robot(robot::Robot, RobotAction),
}

/// A question about anybody.
struct Case {
    action: String,
    asked: Asked,
    texts: Texts,
    /// The number of the set in force; 0 for policies of the question.
    version: u64,
    steps: u64,
    /// Microseconds since the UNIX epoch.
    time: u64,
}

impl Case {
    fn of(ctx: &Context<'_>, decider: &Decider, ask: &Ask) -> Result<Self, Rejection> {
        let name = ask.action.as_str();
        let asked = if let Some(action) = OF_ROBOT.into_iter().find(|action| action.name() == name) {
            let (robot, _) = service::split(&ask.service);
            Asked::Robot(robot::find(ctx, robot)?, action)
        } else if let Some(action) = OF_SERVICE.into_iter().find(|action| action.name() == name) {
            let target = service::resolve(ctx, &ask.service)?;
            let needed = needed(&target, action);
            Asked::Service(Box::new(target), needed)
        } else {
            let names = OF_SERVICE.map(Action::name).into_iter().chain(OF_ROBOT.map(RobotAction::name));
            let names: Vec<&str> = names.collect();
            return Err(Rejection::new(Code::BadArgument, "no action has this name")
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

    fn judge(&self, ctx: &Context<'_>, decider: &Decider, principal: &Principal) -> Result<Can, Rejection> {
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
        let mut denial = None;
        match &self.asked {
            Asked::Service(_, actions) if self.owner_may(principal) && actions.iter().all(Action::is_of_owner) => {}
            Asked::Robot(..) if self.owner_may(principal) => {}
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
                    denial = Some((refusal::explain_robot(principal, robot, *action, verdict, || why.clone()), why));
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
            reason: refused.message,
            found: refused.found,
            wanted: refused.wanted,
            next: refused.next,
            policies: if allowed { deciding } else { why.deciding },
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

/// Most grants that `diff` tells one by one.
const ENDS_MAX: usize = 256;

/// `diff POLICIES_JSON`: which grants of the caller's organisation would a set of policies end?
pub(crate) fn diff(ctx: &mut Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("diff POLICIES_JSON", args, 1, 1)?;
    let wanted = r#"JSON of policies: [{"id": "night", "text": "permit …;"}]"#;
    let policies: Vec<PolicyText> = serde_json::from_str(args.document(0, "POLICIES_JSON", ASK_BYTES_MAX)?)
        .map_err(|fault| args.bad(0, "POLICIES_JSON", fault.to_string(), wanted))?;
    let organisation = &ctx.submitter()?.organisation;
    let texts = given(ctx, decider, &policies)?;
    let own = texts::own(ctx, organisation)?;
    let text_of = |texts: &Texts, id: &str| texts.iter().find(|(known, _)| known == id).map(|(_, text)| text.clone());
    let ids = |of: &Texts, keep: &dyn Fn(&str) -> bool| {
        of.iter().map(|(id, _)| id.clone()).filter(|id| keep(id)).collect::<Vec<_>>()
    };
    let mut diff = PolicyDiff {
        organisation: organisation.clone(),
        added: ids(&texts, &|id| !policies.is_empty() && text_of(&own, id).is_none()),
        changed: ids(&texts, &|id| text_of(&own, id).is_some_and(|text| text_of(&texts, id) != Some(text))),
        removed: ids(&own, &|id| text_of(&texts, id).is_none()),
        grants: 0,
        ends: Vec::new(),
        ended: 0,
        unreachable: reachable::cut_off(ctx, decider, organisation, &texts)?,
    };
    let steps = limits::steps_of_all(&texts)?;
    let of_owner = robot::all(ctx)?.into_iter().filter(|robot| robot.organisation == *organisation);
    for target in of_owner.flat_map(|robot| Target::all_of(&robot).collect::<Vec<_>>()) {
        for holding in grant::live(ctx, &target.id)? {
            diff.grants += 1;
            let action = if holding.grant.taken.is_some() { Action::Override } else { Action::Acquire };
            let asked = Asked::Service(Box::new(target.clone()), needed(&target, action));
            let time = ctx.block_time();
            let (action, texts) = (action.name().to_owned(), texts.clone());
            let case = Case { action, asked, texts, version: 0, steps, time };
            let people = std::iter::once(&holding.principal).chain(holding.givers.iter().map(|giver| &giver.principal));
            for principal in people {
                let Can { allowed, reason, found, wanted, .. } = case.judge(ctx, decider, principal)?;
                if allowed {
                    continue;
                }
                diff.ended += 1;
                if diff.ends.len() < ENDS_MAX {
                    let Grant { service, holder, epoch, .. } = holding.grant;
                    diff.ends.push(WouldEnd { service, holder, epoch, reason, found, wanted });
                }
                break;
            }
        }
    }
    store::json(&diff)
}

/// The rights that an action needs.
fn needed(target: &Target, action: Action) -> Vec<Action> {
    match action {
        Action::Acquire if target.is_for_readers() => vec![Action::Subscribe],
        Action::Acquire => vec![Action::Acquire, Action::Publish],
        action => vec![action],
    }
}

/// The policies of a question; the built-in one if there are none.
fn given(ctx: &Context<'_>, decider: &Decider, policies: &[PolicyText]) -> Result<Texts, Rejection> {
    let texts = policy_sets::checked(ctx, decider, policies)?;
    Ok(if texts.is_empty() { texts::built_in() } else { texts })
}
