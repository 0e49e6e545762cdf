//! Who may: asks the owner's policies, remembers the answers, and explains refusals.

use crate::arguments::{Arguments, shown};
use crate::conflict;
use crate::grant::{self, Holding, Principal, mode_name};
use crate::nearest::did_you_mean;
use crate::policies;
use crate::policy::{Answer, Engine, Question, Resource, User, Verdict};
use crate::publish;
use crate::records::Records;
use crate::service::{self, Offered, Target, direction_name};
use crate::store;
use bytes::Bytes;
use ledger::Context;
use ledger_contract::Direction;
use ledger_hash::Hash;
use ledger_identity::{Identity, Role};
use ledger_rejection::{Code, Rejection};
use ledger_storage::result::Event;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

/// Most decisions that are remembered; when they are more, all are forgotten.
const DECISIONS_MAX: usize = 16 * 1024;
/// The name of the event of what was published.
const MESSAGE: &str = "message";

/// What somebody wants to do with a service; each is an action of the schema.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Action {
    Acquire,
    Publish,
    Subscribe,
}

/// Answer of `authorize`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Authorization {
    /// May the caller do it now?
    pub allowed: bool,
    /// The stable code, e.g. `LGR-3001`; `LGR-0000` if allowed.
    pub code: String,
    /// The name of the code, e.g. `MISSING_ATTRIBUTE`.
    pub name: String,
    /// Why not, in words; empty if allowed.
    pub reason: String,
    /// The epoch of the caller's own grant; 0 if there is none.
    pub epoch: u64,
    /// The smallest sequence number that `set` accepts from the caller.
    pub next_seq: u64,
}

/// Answer of `GetSubmittingClientIdentity`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Caller {
    /// `Org1/Salma`.
    pub id: String,
    /// The organisation whose CA vouches for the caller.
    pub organisation: String,
    /// The name in the certificate.
    pub name: String,
    /// The role in the certificate.
    pub role: Role,
    /// The attributes in the certificate.
    pub attributes: BTreeMap<String, String>,
    /// The certificate's serial number, hexadecimal.
    pub serial: String,
    /// When the certificate expires (microseconds since the UNIX epoch).
    pub not_after: u64,
}

/// All that a decision depends on besides the time. Policies and robots go by hashes of their contents, so an
/// answer stays true for ever, and one learned in a simulated call is true in an executed one.
#[derive(PartialEq, Eq, PartialOrd, Ord)]
struct Key {
    fingerprint: Hash,
    principal: String,
    policies: Hash,
    robot: Hash,
    service: String,
    action: Action,
}

/// Asks policies. What it remembers saves time and never changes an answer.
pub(crate) struct Decider {
    engine: Engine,
    decisions: Mutex<BTreeMap<Key, Verdict>>,
    robots: Records<Offered>,
    grants: Records<Holding>,
}

impl Action {
    const ALL: [Self; 3] = [Self::Acquire, Self::Publish, Self::Subscribe];

    /// As policies name it.
    const fn name(self) -> &'static str {
        match self {
            Self::Acquire => "acquire",
            Self::Publish => "publish",
            Self::Subscribe => "subscribe",
        }
    }
}

impl Decider {
    /// # Errors
    /// As [`Engine::start`].
    pub(crate) fn new() -> Result<Self, Rejection> {
        let (decisions, robots, grants) = Default::default();
        Ok(Self { engine: Engine::start()?, decisions, robots, grants })
    }

    /// Is this text acceptable as a policy?
    pub(crate) fn check(&self, text: &str) -> Result<(), Rejection> {
        self.engine.check(text)
    }

    /// The service of an id, as [`service::resolve`] finds it.
    pub(crate) fn target(&self, ctx: &Context<'_>, id: &str) -> Result<Arc<Target>, Rejection> {
        let (robot, topic) = service::split(id);
        let offered = self.robots.read(ctx, &store::robot_key(robot), Offered::parse)?;
        match offered.as_ref().and_then(|offered| offered.find(topic)) {
            Some(target) => Ok(Arc::clone(target)),
            // It says what is wrong.
            None => service::resolve(ctx, id).map(Arc::new),
        }
    }

    /// The live grant that was acquired with this very certificate.
    fn held(
        &self,
        ctx: &Context<'_>,
        target: &Target,
        submitter: &Identity,
    ) -> Result<Option<Arc<Holding>>, Rejection> {
        let held = self.grants.read(ctx, &store::grant_key(&target.id, &submitter.id()), store::parse)?;
        let entitles = |held: &Arc<Holding>| {
            held.is_live(ctx.block_time()) && held.principal.fingerprint.0 == submitter.fingerprint
        };
        Ok(held.filter(entitles))
    }

    /// May this principal do that, says the owner of the robot?
    ///
    /// # Errors
    /// Why not: [`Code::MissingAttribute`], [`Code::DeniedByPolicy`] or [`Code::PolicyError`].
    pub(crate) fn decide(
        &self,
        ctx: &Context<'_>,
        principal: &Principal,
        target: &Target,
        action: Action,
    ) -> Result<(), Rejection> {
        let owner = &target.robot.organisation;
        let version = policies::version(ctx, owner)?;
        let key = Key {
            fingerprint: principal.fingerprint,
            principal: principal.id(),
            policies: version,
            robot: target.robot.version,
            service: target.id.clone(),
            action,
        };
        let known = self.decisions.lock().unwrap_or_else(PoisonError::into_inner).get(&key).cloned();
        let verdict = match known {
            Some(verdict) => verdict,
            None => {
                let answer = self.ask(ctx, principal, target, action, version)?;
                if answer.timeless {
                    self.remember(key, answer.verdict.clone());
                }
                answer.verdict
            }
        };
        match verdict {
            Verdict::Permit => Ok(()),
            denial => Err(explain(principal, target, action, denial)),
        }
    }

    fn ask(
        &self,
        ctx: &Context<'_>,
        principal: &Principal,
        target: &Target,
        action: Action,
        version: Hash,
    ) -> Result<Answer, Rejection> {
        let (robot, service) = (&target.robot, &target.service);
        let (attribute, value) = robot.required();
        let question = Question {
            version,
            user: User {
                organisation: principal.organisation.clone(),
                name: principal.name.clone(),
                role: principal.role.as_str(),
                attributes: principal.attributes.clone(),
            },
            action: action.name(),
            service: Resource {
                id: target.id.clone(),
                robot: robot.name.clone(),
                owner: robot.organisation.clone(),
                texts: vec![
                    ("topic", service.topic.clone()),
                    ("type", service.type_name.clone()),
                    ("mode", mode_name(service.mode).to_owned()),
                    ("direction", direction_name(service.direction).to_owned()),
                    ("requiredAttribute", attribute.to_owned()),
                    ("requiredValue", value.to_owned()),
                ],
                trusted: robot.trusted.clone(),
            },
            time_ms: i64::try_from(ctx.block_time() / 1000).unwrap_or(i64::MAX),
        };
        self.engine.decide(question, || policies::in_force(ctx, &robot.organisation))
    }

    fn remember(&self, key: Key, verdict: Verdict) {
        let mut decisions = self.decisions.lock().unwrap_or_else(PoisonError::into_inner);
        if decisions.len() >= DECISIONS_MAX {
            decisions.clear();
        }
        decisions.insert(key, verdict);
    }
}

/// May they hold a grant? It is the right to acquire and to publish.
pub(crate) fn may_hold(
    ctx: &Context<'_>,
    decider: &Decider,
    principal: &Principal,
    target: &Target,
) -> Result<(), Rejection> {
    decider.decide(ctx, principal, target, Action::Acquire)?;
    decider.decide(ctx, principal, target, Action::Publish)
}

/// May they publish now? With an epoch, that epoch must be the one of their grant; epoch 0 asks the policies alone,
/// where the service's mode allows it. Returns the grant that entitles them, if it is one that does.
///
/// The usual case, a holder who publishes, reads two values of the state and asks no policy.
///
/// # Errors
/// [`Code::StaleEpoch`], [`Code::NotHolder`], or what [`Decider::decide`] says.
pub(crate) fn may_publish(
    ctx: &Context<'_>,
    decider: &Decider,
    submitter: &Identity,
    target: &Target,
    epoch: Option<u64>,
) -> Result<Option<Arc<Holding>>, Rejection> {
    let by_policy =
        !conflict::rule(target.service.mode).publishing_needs_grant() && epoch.is_none_or(|epoch| epoch == 0);
    if !by_policy
        && let Some(own) = decider.held(ctx, target, submitter)?
        && epoch.is_none_or(|epoch| epoch == own.grant.epoch)
    {
        return Ok(Some(own));
    }
    let principal = &Principal::of(submitter);
    if by_policy {
        decider.decide(ctx, principal, target, Action::Publish)?;
        return Ok(None);
    }
    let newest = grant::newest_epoch(ctx, &target.id)?;
    let refused = match grant::own(ctx, principal, target) {
        Ok(own) if epoch.is_none_or(|epoch| epoch == own.grant.epoch) => return Ok(Some(Arc::new(own))),
        Ok(own) => stale(target, epoch, own.grant.epoch),
        // Who has lost the grant to a newer one hears that; who never had one hears what is missing.
        Err(_) if epoch.is_some_and(|epoch| epoch > 0 && epoch < newest) => stale(target, epoch, newest),
        Err(not_holder) => decider.decide(ctx, principal, target, Action::Publish).err().unwrap_or(not_holder),
    };
    Err(refused)
}

fn stale(target: &Target, epoch: Option<u64>, wanted: u64) -> Rejection {
    Rejection::new(Code::StaleEpoch, format!("this is not the epoch in which {} is held", target.id))
        .found(format!("epoch {}", epoch.unwrap_or(0)))
        .wanted(format!("epoch {wanted}, held by its holder"))
        .next(format!("ledgerctl acquire {}", target.id))
}

/// `authorize SERVICE [ACTION]`: would it be allowed now? Decided by the same code as `set` and `acquire`.
pub(crate) fn authorize(ctx: &Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("authorize SERVICE [acquire|publish|subscribe]", args, 1, 2)?;
    let target = decider.target(ctx, args.text(0, "SERVICE")?)?;
    let name = if args.has(1) { args.text(1, "ACTION")? } else { Action::Publish.name() };
    let action = Action::ALL.into_iter().find(|action| action.name() == name).ok_or_else(|| {
        let near = did_you_mean(name, Action::ALL.map(Action::name), "");
        args.bad(1, "ACTION", shown(name), "acquire, publish or subscribe").next(near)
    })?;
    let submitter = ctx.submitter()?;
    let principal = Principal::of(submitter);
    let outcome = match action {
        Action::Acquire => grant::may_acquire(ctx, decider, &principal, &target).map(drop),
        Action::Publish => may_publish(ctx, decider, submitter, &target, None).map(drop),
        Action::Subscribe => decider.decide(ctx, &principal, &target, action),
    };
    let epoch = grant::own(ctx, &principal, &target).map_or(0, |own| own.grant.epoch);
    let code = outcome.as_ref().err().map_or(Code::Ok, |rejection| rejection.code);
    store::json(&Authorization {
        allowed: outcome.is_ok(),
        code: code.to_string(),
        name: code.name().to_owned(),
        reason: outcome.err().map(|rejection| rejection.message).unwrap_or_default(),
        epoch,
        next_seq: publish::next_sequence(ctx, &target, epoch, &principal.id())?,
    })
}

/// `GetSubmittingClientIdentity`
pub(crate) fn caller(ctx: &Context<'_>, args: &[Bytes]) -> Result<Bytes, Rejection> {
    Arguments::new("GetSubmittingClientIdentity", args, 0, 0)?;
    let submitter = ctx.submitter()?;
    store::json(&Caller {
        id: submitter.id(),
        organisation: submitter.organisation.clone(),
        name: submitter.name.clone(),
        role: submitter.role,
        attributes: submitter.attributes.clone(),
        serial: hex::encode(&submitter.serial),
        not_after: submitter.not_after,
    })
}

/// May the submitter see this event? Messages need the right to subscribe; what else happens, every member of the
/// network may know.
pub(crate) fn may_read(ctx: &Context<'_>, decider: &Decider, event: &Event) -> Result<(), Rejection> {
    let submitter = ctx.submitter()?;
    if event.name != MESSAGE {
        return Ok(());
    }
    let principal = Principal::of(submitter);
    let target = decider.target(ctx, &event.subject)?;
    decider.decide(ctx, &principal, &target, Action::Subscribe)
}

/// May the submitter follow these events? Who asks for the messages of services needs the right to subscribe to each.
///
/// A service that does not exist is refused, unless the events of its robot are asked for as well: they tell when it comes.
pub(crate) fn may_follow(
    ctx: &Context<'_>,
    decider: &Decider,
    subjects: &[String],
    names: &[String],
) -> Result<(), Rejection> {
    if !names.iter().any(|name| name == MESSAGE) {
        return Ok(());
    }
    let principal = Principal::of(ctx.submitter()?);
    let (messages_only, waits) = (names.len() == 1, names.iter().any(|name| name == "robot"));
    for subject in subjects.iter().filter(|subject| messages_only || !service::split(subject).1.is_empty()) {
        match decider.target(ctx, subject) {
            Ok(target) if target.id == *subject => decider.decide(ctx, &principal, &target, Action::Subscribe)?,
            Ok(target) => {
                return Err(Rejection::new(
                    Code::UnknownService,
                    format!("{subject} is a robot and sends no messages"),
                )
                .found(shown(subject))
                .wanted(format!("a service, {}", target.id))
                .next(format!("subscribe to {}", target.id)));
            }
            Err(unknown) if waits && matches!(unknown.code, Code::UnknownRobot | Code::UnknownService) => {}
            Err(unknown) => return Err(unknown),
        }
    }
    Ok(())
}

/// Why policies deny: what somebody can do something about comes first.
fn explain(principal: &Principal, target: &Target, action: Action, verdict: Verdict) -> Rejection {
    let (robot, who) = (&target.robot, principal.id());
    let owner = &robot.organisation;
    let (attribute, value) = robot.required();
    let verb = match action {
        Action::Acquire => "acquire",
        Action::Publish => "publish on",
        Action::Subscribe => "subscribe to",
    };
    let refused = format!("{who} may not {verb} {}", target.id);
    let ask_owner = format!("ask an admin of {owner}");
    match verdict {
        Verdict::Fault(fault) => {
            return Rejection::new(Code::PolicyError, format!("{refused}: a policy of {owner} cannot be evaluated"))
                .found(fault)
                .wanted("policies that evaluate without errors")
                .next(format!("{ask_owner} to correct it: ledgerctl query abac policies"));
        }
        Verdict::Forbidden(ids) => {
            return Rejection::new(Code::DeniedByPolicy, format!("{refused}: a policy of {owner} forbids it"))
                .found(format!("forbidden by {}", ids.join(", ")))
                .wanted("no policy that forbids it")
                .next(format!("{ask_owner}, or read it: ledgerctl query abac policies"));
        }
        Verdict::Permit | Verdict::NotPermitted => {}
    }
    if target.service.direction == Direction::Feed && action != Action::Subscribe {
        return Rejection::new(Code::DeniedByPolicy, format!("{refused}: it is a feed of the robot"))
            .found(format!("role {} of {}", principal.role, principal.organisation))
            .wanted(format!(
                "a call that the policies of {owner} permit; by default those of its robots, nodes and admins"
            ))
            .next(format!("subscribe to it: ledgerctl echo {}", target.id));
    }
    if !robot.trusted.contains(&principal.organisation) {
        return Rejection::new(Code::DeniedByPolicy, format!("{refused}: {owner} does not trust its organisation"))
            .found(format!("organisation {}", principal.organisation))
            .wanted(format!("one of {}", robot.trusted.join(", ")))
            .next(format!("{ask_owner} to add {} to the robot's trusted organisations", principal.organisation));
    }
    if principal.attributes.get(attribute).map(String::as_str) != Some(value) {
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
    Rejection::new(Code::DeniedByPolicy, format!("{refused}: no policy of {owner} permits it"))
        .found(format!("role {}, attribute {attribute}={value}", principal.role))
        .wanted("a policy that permits it")
        .next(format!("{ask_owner}, or read the policies: ledgerctl query abac policies"))
}
