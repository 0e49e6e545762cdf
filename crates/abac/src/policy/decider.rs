//! Permission: asks the owner's policies and remembers the answers.

use super::action::{Action, Object, RobotAction};
use super::explain::{Explanation, WORK_OF_QUESTION, WORK_OF_REFUSAL};
use super::limits;
use super::texts::{self, TextSet, Version};
use super::{Answer, Engine, Permit, Question, Resource, Texts, User, Verdict, by_rule, refusal};
use crate::records::Records;
use crate::records::grant::Holding;
use crate::records::principal::Principal;
use crate::records::robot::Robot;
use crate::records::target::Target;
use crate::rules::Table;
use ledger::Context;
use ledger_base::hash::Hash;
use ledger_base::rejection::Rejection;
use ledger_contract::{Attributes, Limits, PolicyCheck, PolicyFault};
use quick_cache::unsync::Cache;
use std::hash::Hasher;
use std::sync::{Mutex, OnceLock, PoisonError};

/// Most decisions that are remembered.
const DECISIONS_MAX: usize = 16 * 1024;
/// Most reasons of denials that are remembered.
const REASONS_MAX: usize = 1024;

/// All that a decision depends on besides the time. Policies and robots go by hashes of their contents, so an
/// answer stays true for ever, and one learned in a simulated call is true in an executed one.
#[derive(Clone, PartialEq, Eq)]
struct Key {
    fingerprint: Hash,
    principal: String,
    policies: Hash,
    robot: Hash,
    /// Empty if the question is about the robot.
    service: String,
    action: &'static str,
    by_rule: bool,
}

/// Keys that are equal have equal parts; these are enough to tell most others apart, and quick to hash.
impl std::hash::Hash for Key {
    fn hash<H: Hasher>(&self, state: &mut H) {
        for hash in [&self.fingerprint, &self.robot] {
            state.write(hash.0.first_chunk::<8>().unwrap_or(&[0; 8]));
        }
        state.write(self.service.as_bytes());
        state.write(self.action.as_bytes());
    }
}

impl Key {
    /// Names the question in a block, whose time it is asked at.
    fn question(&self) -> Hash {
        let Self { fingerprint, principal, policies, robot, service, action, by_rule } = self;
        let rule = if *by_rule { "by rule" } else { "" };
        let text = [principal.as_str(), service, action, rule].join("\0");
        Hash::of(&[&fingerprint.0, &policies.0, &robot.0, text.as_bytes()])
    }
}

/// Asks policies. The memory saves time and never changes an answer.
pub(crate) struct Decider {
    engine: Engine,
    /// For long questions, from the first one on.
    aside: OnceLock<Result<Engine, Rejection>>,
    decisions: Mutex<Cache<Key, Verdict>>,
    /// The reasons of denials.
    reasons: Mutex<Cache<Key, Explanation>>,
    /// The objects of the questions, parsed before.
    pub(crate) records: Records,
    /// The rules that decide between those who may.
    pub(crate) rules: Table,
}

impl Decider {
    /// # Errors
    /// As [`Engine::start`].
    pub(crate) fn new(rules: Table) -> Result<Self, Rejection> {
        Ok(Self {
            rules,
            engine: Engine::start()?,
            aside: OnceLock::new(),
            decisions: Mutex::new(Cache::new(DECISIONS_MAX)),
            reasons: Mutex::new(Cache::new(REASONS_MAX)),
            records: Records::default(),
        })
    }

    /// Is this text acceptable as a policy?
    pub(crate) fn check(&self, ctx: &Context<'_>, text: &str) -> Result<(), Rejection> {
        limits::steps(text)?;
        self.engine_for(ctx)?.check(text)
    }

    /// The faults of a text as a policy, with their places, or the meaning of its policies.
    pub(crate) fn diagnose(&self, text: &str) -> PolicyCheck {
        let whole = |refused: Rejection| {
            let message = format!("{}: found {}, wanted {}", refused.message, refused.found, refused.wanted);
            let fault =
                PolicyFault { message, help: String::new(), line: 0, column: 0, length: 0, text: String::new() };
            PolicyCheck { faults: vec![fault], ..PolicyCheck::default() }
        };
        match limits::check(text).and_then(|()| limits::steps(text)) {
            Ok(_) => self.aside().and_then(|engine| engine.diagnose(text)).unwrap_or_else(whole),
            Err(refused) => whole(refused),
        }
    }

    /// Does each policy of a text, in its order, apply to one of these people and one of these objects now?
    pub(crate) fn matching(
        &self,
        ctx: &Context<'_>,
        people: &[Principal],
        objects: &[Object<'_>],
        text: &str,
    ) -> Vec<bool> {
        let time = milliseconds(ctx.block_time());
        let ask = |principal| objects.iter().map(move |object| question(principal, *object, Hash::ZERO, time));
        let questions = people.iter().flat_map(ask).collect();
        self.aside().map(|engine| engine.matching(questions, text)).unwrap_or_default()
    }

    /// May this principal do that, says the owner of the robot?
    ///
    /// # Errors
    /// Why not: [`ledger_base::rejection::Code::MissingAttribute`], [`ledger_base::rejection::Code::DeniedByPolicy`] or [`ledger_base::rejection::Code::PolicyError`].
    pub(crate) fn decide(
        &self,
        ctx: &Context<'_>,
        principal: &Principal,
        target: &Target,
        action: Action,
    ) -> Result<Permit, Rejection> {
        match self.verdict(ctx, principal, Object::Service(target, action))? {
            Verdict::Permit(permit) => Ok(permit),
            denial => {
                let why = || self.explanation(ctx, principal, Object::Service(target, action));
                let forbidding = denial.forbidding();
                let refused = refusal::explain(principal, target, action, denial, why);
                Err(by_version(ctx, &target.robot.organisation, &forbidding, refused))
            }
        }
    }

    /// May this principal do that to the robot? An admin of its owner may always: the owner is never locked out. The robot itself
    /// and the holders of its command services may stop it by rule.
    ///
    /// # Errors
    /// As [`Decider::decide`].
    pub(crate) fn decide_on_robot(
        &self,
        ctx: &Context<'_>,
        principal: &Principal,
        robot: &Robot,
        action: RobotAction,
    ) -> Result<(), Rejection> {
        if principal.governs(robot) {
            return Ok(());
        }
        let mut object = Object::Robot(robot, action);
        let mut verdict = self.verdict(ctx, principal, object)?;
        let denied = !matches!(verdict, Verdict::Permit(_));
        if denied && action == RobotAction::Stop && by_rule::stops(ctx, principal, robot)?.is_some() {
            object = Object::ByRule(robot, action);
            verdict = self.verdict(ctx, principal, object)?;
        }
        match verdict {
            Verdict::Permit(_) => Ok(()),
            denial => {
                let why = || self.explanation(ctx, principal, object);
                let forbidding = denial.forbidding();
                let refused = refusal::explain_robot(principal, robot, action, denial, why);
                Err(by_version(ctx, &robot.organisation, &forbidding, refused))
            }
        }
    }

    fn verdict(&self, ctx: &Context<'_>, principal: &Principal, object: Object<'_>) -> Result<Verdict, Rejection> {
        let robot = object.robot();
        let owner = &robot.organisation;
        let Version { hash, steps, .. } = texts::version(ctx, owner)?;
        let key = key(principal, object, hash);
        ctx.charge_steps(owner, steps, || key.question());
        let known = self.decisions.lock().unwrap_or_else(PoisonError::into_inner).get(&key).cloned();
        if let Some(verdict) = known {
            return Ok(verdict);
        }
        let answer = self.ask(ctx, principal, object, hash)?;
        if answer.timeless {
            self.remember(key, answer.verdict.clone());
        }
        Ok(answer.verdict)
    }

    fn ask(
        &self,
        ctx: &Context<'_>,
        principal: &Principal,
        object: Object<'_>,
        version: Hash,
    ) -> Result<Answer, Rejection> {
        let question = question(principal, object, version, milliseconds(ctx.block_time()));
        self.engine.decide(question, || ctx.remembered(|| texts::in_force(ctx, &object.robot().organisation)))
    }

    /// The reasons of a denial by the policies in force.
    fn explanation(&self, ctx: &Context<'_>, principal: &Principal, object: Object<'_>) -> Explanation {
        let owner = &object.robot().organisation;
        let Ok(Version { hash, .. }) = texts::version(ctx, owner) else { return Explanation::default() };
        let key = key(principal, object, hash);
        let known = self.reasons.lock().unwrap_or_else(PoisonError::into_inner).get(&key).cloned();
        if let Some(why) = known {
            return why;
        }
        let question = question(principal, object, hash, milliseconds(ctx.block_time()));
        let texts = || ctx.remembered(|| texts::in_force(ctx, owner));
        let why = self.engine.explain(question, WORK_OF_REFUSAL, texts).map(|(_, why)| why).unwrap_or_default();
        if why.timeless {
            self.reasons.lock().unwrap_or_else(PoisonError::into_inner).insert(key, why.clone());
        }
        why
    }

    /// What do these policies decide at a time (microseconds), and why? On a thread of its own, because it takes long.
    pub(crate) fn explain(
        &self,
        principal: &Principal,
        object: Object<'_>,
        texts: &Texts,
        time: u64,
    ) -> Result<(Verdict, Explanation), Rejection> {
        let question = question(principal, object, texts::hash(texts), milliseconds(time));
        self.aside()?.explain(question, WORK_OF_QUESTION, || Ok(texts.clone()))
    }

    /// What do these policies decide at a time (microseconds)?
    ///
    /// # Errors
    /// [`ledger_base::rejection::Code::Internal`] if nothing can decide.
    pub(crate) fn decide_by(
        &self,
        ctx: &Context<'_>,
        principal: &Principal,
        object: Object<'_>,
        set: &TextSet,
        time: u64,
    ) -> Result<Verdict, Rejection> {
        let question = question(principal, object, set.hash, milliseconds(time));
        Ok(self.engine_for(ctx)?.decide(question, || Ok(set.texts.clone()))?.verdict)
    }

    /// Would these policies permit it, now or when a window opens?
    pub(crate) fn could(
        &self,
        ctx: &Context<'_>,
        principal: &Principal,
        target: &Target,
        action: Action,
        texts: &Texts,
    ) -> bool {
        let (object, time) = (Object::Service(target, action), milliseconds(ctx.block_time()));
        let question = question(principal, object, texts::hash(texts), time);
        let answer = self.engine_for(ctx).and_then(|engine| engine.decide(question, || Ok(texts.clone())));
        answer.is_ok_and(|answer| matches!(answer.verdict, Verdict::Permit(_) | Verdict::Closed(_)))
    }

    /// The engine for policies that are not in force: no block waits while a question asks about them.
    fn engine_for(&self, ctx: &Context<'_>) -> Result<&Engine, Rejection> {
        if ctx.is_query() { self.aside() } else { Ok(&self.engine) }
    }

    /// The engine for questions that no block waits for.
    fn aside(&self) -> Result<&Engine, Rejection> {
        self.aside.get_or_init(Engine::start).as_ref().map_err(Clone::clone)
    }

    fn remember(&self, key: Key, verdict: Verdict) {
        self.decisions.lock().unwrap_or_else(PoisonError::into_inner).insert(key, verdict);
    }
}

/// A refusal names the set of policies that decided, if it has a number, and those of it that forbid.
fn by_version(ctx: &Context<'_>, owner: &str, forbidding: &[String], mut refused: Rejection) -> Rejection {
    let number = texts::version(ctx, owner).map_or(0, |version| version.number);
    if number > 0 {
        let ids = if forbidding.is_empty() { String::new() } else { format!(": {}", forbidding.join(", ")) };
        refused.message = format!("{} (policies of {owner}, version {number}{ids})", refused.message);
    }
    refused
}

/// All that a decision depends on besides the time.
fn key(principal: &Principal, object: Object<'_>, policies: Hash) -> Key {
    Key {
        fingerprint: principal.fingerprint,
        principal: principal.id(),
        policies,
        robot: object.robot().version,
        service: match object {
            Object::Service(target, _) => target.service_id().to_owned(),
            Object::Robot(..) | Object::ByRule(..) => String::new(),
        },
        action: object.action(),
        by_rule: object.is_by_rule(),
    }
}

/// A time of the ledger (microseconds) in milliseconds, as policies have it.
fn milliseconds(time: u64) -> i64 {
    i64::try_from(time / 1000).unwrap_or(i64::MAX)
}

/// The question to the policies of the owner.
fn question(principal: &Principal, object: Object<'_>, version: Hash, time_ms: i64) -> Question {
    let robot = object.robot();
    let (attribute, value) = robot.required();
    let required = [("requiredAttribute", attribute.to_owned()), ("requiredValue", value.to_owned())];
    let of_service = |target: &Target| {
        let service = &target.service;
        let mut texts = vec![
            ("topic", service.topic.clone()),
            ("type", service.type_name.clone()),
            ("mode", service.mode.to_string()),
            ("direction", service.direction.to_string()),
        ];
        texts.extend(required.clone());
        (target.service_id().to_owned(), texts)
    };
    Question {
        version,
        user: User {
            organisation: principal.organisation.clone(),
            name: principal.name.clone(),
            role: principal.role.as_str(),
            attributes: principal.attributes.clone(),
        },
        action: object.action(),
        by_rule: object.is_by_rule(),
        resource: Resource {
            service: match object {
                Object::Service(target, _) => Some(of_service(target)),
                Object::Robot(..) | Object::ByRule(..) => None,
            },
            robot: robot.name.clone(),
            owner: robot.organisation.clone(),
            trusted: robot.trusted.clone(),
            of_robot: required.to_vec(),
            own: match object {
                Object::Service(target, _) => (robot.attributes.clone(), target.service.attributes.clone()),
                Object::Robot(..) | Object::ByRule(..) => (robot.attributes.clone(), Attributes::new()),
            },
        },
        time_ms,
    }
}

/// May they hold a grant? It is the right to acquire and to publish; for the place of a subscriber, to subscribe. Answers with
/// what the policies bind it to. A subscriber sends nothing, so only windows limit its place.
pub(crate) fn may_hold(
    ctx: &Context<'_>,
    decider: &Decider,
    principal: &Principal,
    target: &Target,
) -> Result<Permit, Rejection> {
    if target.is_for_readers() {
        let subscribe = decider.decide(ctx, principal, target, Action::Subscribe)?;
        let limits = Limits { between: subscribe.limits.between.clone(), ..Limits::default() };
        return Ok(Permit { limits, ..subscribe });
    }
    let acquire = decider.decide(ctx, principal, target, Action::Acquire)?;
    let publish = decider.decide(ctx, principal, target, Action::Publish)?;
    Ok(acquire.and(publish))
}

/// May they take a service whatever its rule says? An admin of the owner may always.
pub(crate) fn may_override(
    ctx: &Context<'_>,
    decider: &Decider,
    principal: &Principal,
    target: &Target,
) -> Result<Permit, Rejection> {
    if principal.governs(&target.robot) {
        Ok(Permit::default())
    } else {
        decider.decide(ctx, principal, target, Action::Override)
    }
}

/// May they confirm who acquires a service? An admin of the owner may always.
pub(crate) fn may_confirm(
    ctx: &Context<'_>,
    decider: &Decider,
    principal: &Principal,
    target: &Target,
) -> Result<(), Rejection> {
    if principal.governs(&target.robot) {
        Ok(())
    } else {
        decider.decide(ctx, principal, target, Action::Confirm).map(drop)
    }
}

/// May they keep the grant that they have? Everybody who passed it on must still be one who may hold it.
pub(crate) fn may_keep(
    ctx: &Context<'_>,
    decider: &Decider,
    holding: &Holding,
    target: &Target,
) -> Result<Permit, Rejection> {
    if holding.grant.taken.is_some() {
        return may_override(ctx, decider, &holding.principal, target);
    }
    let givers = holding.givers.iter().map(|giver| &giver.principal);
    may_hold_after(ctx, decider, givers, &holding.principal, target)
}

/// May they hold a grant that the others have passed on? All of them must be permitted to hold it.
pub(crate) fn may_hold_after<'a>(
    ctx: &Context<'_>,
    decider: &Decider,
    givers: impl Iterator<Item = &'a Principal>,
    principal: &Principal,
    target: &Target,
) -> Result<Permit, Rejection> {
    let mut permit = may_hold(ctx, decider, principal, target)?;
    for giver in givers {
        let closes = may_hold(ctx, decider, giver, target)?.closes;
        permit.closes = permit.closes.into_iter().chain(closes).min();
    }
    Ok(permit)
}
