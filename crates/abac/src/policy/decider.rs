//! Permission: asks the owner's policies and remembers the answers.

use super::defaults::Defaults;
use super::limits::{self, STEPS_MAX};
use super::texts::{self, Version};
use super::{Answer, Engine, Question, Resource, User, Verdict, refusal};
use crate::records::Records;
use crate::records::principal::Principal;
use crate::records::service::Target;
use ledger::Context;
use ledger_hash::Hash;
use ledger_rejection::Rejection;
use quick_cache::unsync::Cache;
use std::hash::Hasher;
use std::sync::{Mutex, PoisonError};

/// Most decisions that are remembered.
const DECISIONS_MAX: usize = 16 * 1024;

/// A use of a service; each is an action of the schema.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Action {
    Acquire,
    Publish,
    Subscribe,
}

/// All that a decision depends on besides the time. Policies and robots go by hashes of their contents, so an
/// answer stays true for ever, and one learned in a simulated call is true in an executed one.
#[derive(PartialEq, Eq)]
struct Key {
    fingerprint: Hash,
    principal: String,
    policies: Hash,
    robot: Hash,
    service: String,
    action: Action,
}

/// Keys that are equal have equal parts; these are enough to tell most others apart, and quick to hash.
impl std::hash::Hash for Key {
    fn hash<H: Hasher>(&self, state: &mut H) {
        for hash in [&self.fingerprint, &self.robot] {
            state.write(hash.0.first_chunk::<8>().unwrap_or(&[0; 8]));
        }
        state.write(self.service.as_bytes());
        state.write_u8(self.action as u8);
    }
}

impl Key {
    /// Names the question in a block, whose time it is asked at.
    fn question(&self) -> Hash {
        let Self { fingerprint, principal, policies, robot, service, action } = self;
        let text = [principal.as_str(), service, action.name()].join("\0");
        Hash::of(&[&fingerprint.0, &policies.0, &robot.0, text.as_bytes()])
    }
}

/// Asks policies. The memory saves time and never changes an answer.
pub(crate) struct Decider {
    engine: Engine,
    decisions: Mutex<Cache<Key, Verdict>>,
    /// The objects of the questions, parsed before.
    pub(crate) records: Records,
}

impl Action {
    pub(crate) const ALL: [Self; 3] = [Self::Acquire, Self::Publish, Self::Subscribe];

    /// As policies name it.
    pub(crate) const fn name(self) -> &'static str {
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
        Ok(Self {
            engine: Engine::start()?,
            decisions: Mutex::new(Cache::new(DECISIONS_MAX)),
            records: Records::default(),
        })
    }

    /// Is this text acceptable as a policy?
    pub(crate) fn check(&self, ctx: &Context<'_>, text: &str) -> Result<(), Rejection> {
        if texts::bounded(ctx) {
            limits::steps(text)?;
        }
        self.engine.check(Defaults::of(ctx.rules()).schema, text)
    }

    /// May this principal do that, says the owner of the robot?
    ///
    /// # Errors
    /// Why not: [`ledger_rejection::Code::MissingAttribute`], [`ledger_rejection::Code::DeniedByPolicy`] or [`ledger_rejection::Code::PolicyError`].
    pub(crate) fn decide(
        &self,
        ctx: &Context<'_>,
        principal: &Principal,
        target: &Target,
        action: Action,
    ) -> Result<(), Rejection> {
        let owner = &target.robot.organisation;
        let Version { hash, steps } = texts::version(ctx, owner)?;
        // A set from before steps were counted may be larger than it may be now: then it decides otherwise.
        let doubted = steps.is_none() && texts::bounded(ctx);
        let version = if doubted { Hash::of(&[b"doubted\0", &hash.0]) } else { hash };
        let key = Key {
            fingerprint: principal.fingerprint,
            principal: principal.id(),
            policies: version,
            robot: target.robot.version,
            service: target.id.clone(),
            action,
        };
        ctx.charge_steps(owner, steps.unwrap_or(STEPS_MAX), || key.question());
        let known = self.decisions.lock().unwrap_or_else(PoisonError::into_inner).get(&key).cloned();
        let verdict = match known {
            Some(verdict) => verdict,
            None => {
                let answer = self.ask(ctx, principal, target, action, (version, doubted))?;
                if answer.timeless {
                    self.remember(key, answer.verdict.clone());
                }
                answer.verdict
            }
        };
        match verdict {
            Verdict::Permit => Ok(()),
            denial => Err(refusal::explain(principal, target, action, denial)),
        }
    }

    fn ask(
        &self,
        ctx: &Context<'_>,
        principal: &Principal,
        target: &Target,
        action: Action,
        (version, doubted): (Hash, bool),
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
                    ("mode", service.mode.to_string()),
                    ("direction", service.direction.to_string()),
                    ("requiredAttribute", attribute.to_owned()),
                    ("requiredValue", value.to_owned()),
                ],
                trusted: robot.trusted.clone(),
            },
            time_ms: i64::try_from(ctx.block_time() / 1000).unwrap_or(i64::MAX),
            doubted,
        };
        self.engine.decide(question, || ctx.remembered(|| texts::in_force(ctx, &robot.organisation)))
    }

    fn remember(&self, key: Key, verdict: Verdict) {
        self.decisions.lock().unwrap_or_else(PoisonError::into_inner).insert(key, verdict);
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
