//! Permission: the form of a Cedar policy, and the decision of a set of them.
//!
//! Policies are hostile input. Their size and nesting are limited before anything parses them, and they are validated
//! strictly against the schema. All of Cedar's recursion (parsing, validating, evaluating and dropping) runs on one
//! thread with a stack of fixed size. On a small stack, deep recursion aborts the process. Cedar looks at the stack
//! that is left, so stacks of different sizes would decide differently on different nodes.

pub(crate) mod action;
pub(crate) mod analysis;
mod annotation;
mod asked;
pub(crate) mod by_rule;
pub(crate) mod decider;
pub(crate) mod defaults;
mod diagnose;
pub(crate) mod explain;
mod expression;
mod impossible;
mod index;
pub(crate) mod limits;
mod matching;
mod misfit;
mod names;
mod naming;
mod permit;
pub(crate) mod refusal;
#[cfg(test)]
mod tests;
pub(crate) mod texts;
mod window;
mod words;

use self::annotation::Said;
use self::asked::{Asked, asked};
use self::defaults::SCHEMA;
use self::explain::Explanation;
use self::index::Index;
use self::limits::{CHAIN_MAX, NESTING_MAX};
use self::misfit::Misfit;
pub(crate) use self::permit::Permit;
use cedar_policy::{
    Authorizer, Decision, Policy, PolicyId, PolicySet, Schema, ValidationMode, ValidationResult, ValidationWarning,
    Validator,
};
use ledger_base::hash::Hash;
use ledger_base::mutation::{Mutation, active};
use ledger_base::rejection::{Code, Rejection};
use ledger_base::shared_results::shared;
use ledger_contract::{Attributes, POLICIES_TOLD_MAX, PolicyCheck};
use quick_cache::Weighter;
use quick_cache::unsync::Cache;
use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

/// Stack of the thread that runs Cedar, in bytes. Only what is used of it takes memory. A level of nesting takes up to
/// 16 KiB in a debug build, so the limits above stay far from its end. The point at which Cedar gives up for want of
/// stack would depend on the build and the processor.
const STACK_BYTES: usize = 64 * 1024 * 1024;
const _: () = assert!((CHAIN_MAX + 2 * NESTING_MAX) * 16 * 1024 * 2 < STACK_BYTES);
/// Most parsed policy sets that are kept, and most bytes of their texts.
const PARSED_SETS_MAX: usize = 64;
const PARSED_BYTES_MAX: usize = 4 * 1024 * 1024;
/// Most questions that wait for the thread; more wait for their turn to wait.
const QUEUE_MAX: usize = 64;
/// The fault of Cedar that denies.
const PANICKED: &str = "Cedar panicked on the policies";
/// Most faults of a policy that are reported at once.
const FAULTS_SHOWN_MAX: usize = 3;

/// Texts of policies with their ids, in order of the ids.
pub(crate) type Texts = Vec<(String, String)>;

/// A question to a set of policies.
#[derive(Debug)]
pub(crate) struct Question {
    /// Names the set: a hash over its texts, never a counter. Calls are also simulated and thrown away, and a counter
    /// would then name another set than the one that is executed later.
    pub(crate) version: Hash,
    /// `User`: id, attributes, tags, organisation.
    pub(crate) user: User,
    /// Its name in the schema.
    pub(crate) action: &'static str,
    pub(crate) resource: Resource,
    /// Is it permitted by rule, so that only a `forbid` that names the action denies it?
    pub(crate) by_rule: bool,
    /// Block time, milliseconds.
    pub(crate) time_ms: i64,
}

impl Question {
    /// The word of a policy that matches.
    fn said(&self, policies: &PolicySet, id: &PolicyId) -> Result<Said, String> {
        policies.policy(id).map_or(Ok(Said::Permits(Permit::default())), |policy| self.said_by(policy))
    }

    fn said_by(&self, policy: &Policy) -> Result<Said, String> {
        annotation::said(policy, self.time_ms)
    }

    /// Over all of it, and what is asked of it with so much work.
    fn hash(&self, what: &str, work: usize) -> Hash {
        Hash::of(&[format!("{what} {work} {self:?}").as_bytes()])
    }
}

/// The caller.
#[derive(Debug)]
pub(crate) struct User {
    pub(crate) organisation: String,
    pub(crate) name: String,
    pub(crate) role: &'static str,
    pub(crate) attributes: BTreeMap<String, String>,
}

/// Attributes of text, as in the schema.
pub(crate) type TextAttributes = Vec<(&'static str, String)>;

/// The object of the request: a service, or its robot.
#[derive(Debug)]
pub(crate) struct Resource {
    /// The service with its attributes; none if the request is about the robot.
    pub(crate) service: Option<(String, TextAttributes)>,
    pub(crate) robot: String,
    pub(crate) owner: String,
    pub(crate) trusted: Vec<String>,
    /// The attributes of the robot besides its name, its owner and `trusted`.
    pub(crate) of_robot: TextAttributes,
    /// The owner's own attributes of the robot, and of the service besides them.
    pub(crate) own: (Attributes, Attributes),
}

/// The decision of a set of policies.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Verdict {
    /// A policy permits it and none forbids it.
    Permit(Permit),
    /// No policy permits it.
    NotPermitted {
        /// Do the policies speak of the attribute that the robot requires?
        of_required: bool,
    },
    /// Policies permit it within these windows of time only.
    Closed(Vec<String>),
    /// These policies forbid it.
    Forbidden(Vec<String>),
    /// A policy could not be evaluated. Cedar would skip it, were it a `forbid`; here it denies.
    Fault(String),
}

impl Verdict {
    /// The first policies that forbid it.
    fn forbidding(&self) -> Vec<String> {
        match self {
            Self::Forbidden(ids) => ids.iter().take(POLICIES_TOLD_MAX).cloned().collect(),
            _ => Vec::new(),
        }
    }
}

/// A verdict, and whether it holds whatever the time is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Answer {
    pub(crate) verdict: Verdict,
    pub(crate) timeless: bool,
}

enum Job {
    Check(String, SyncSender<Result<(), Vec<String>>>),
    /// The faults with their places, or the meaning of each policy.
    Diagnose(String, SyncSender<PolicyCheck>),
    /// With the texts of the set, if they were asked for.
    /// Which policies of a text apply to one of the questions.
    Match(Vec<Question>, String, SyncSender<Vec<bool>>),
    Decide(Box<Question>, Option<Texts>, SyncSender<Decided>),
    /// By these texts, with the reasons.
    Explain(Box<Question>, Option<Texts>, usize, SyncSender<Explained>),
}

/// A decision with its reasons, or the question back.
type Explained = Result<(Verdict, Explanation), Box<Question>>;

/// An answer, or the question back, because the texts of the set are needed first.
type Decided = Result<Answer, Box<Question>>;

/// The thread that runs Cedar. It ends with its last handle.
pub(crate) struct Engine {
    jobs: SyncSender<Job>,
}

impl Engine {
    /// Starts the thread.
    ///
    /// # Errors
    /// [`Code::Internal`] if the operating system gives no thread, or the built-in schema is broken.
    pub(crate) fn start() -> Result<Self, Rejection> {
        let internal = |fault: String| Rejection::new(Code::Internal, "policies cannot be evaluated").found(fault);
        let (schema, _) = Schema::from_cedarschema_str(SCHEMA).map_err(|fault| internal(fault.to_string()))?;
        let validator = Validator::new(schema);
        let (jobs, queue) = sync_channel(QUEUE_MAX);
        std::thread::Builder::new()
            .name("policies".to_owned())
            .stack_size(STACK_BYTES)
            .spawn(move || serve(&queue, &validator))
            .map_err(|fault| internal(fault.to_string()))?;
        Ok(Self { jobs })
    }

    /// Is this text acceptable as a policy?
    ///
    /// # Errors
    /// [`Code::PolicyInvalid`] with the first faults.
    pub(crate) fn check(&self, text: &str) -> Result<(), Rejection> {
        limits::check(text)?;
        let key = |text: &&str| Hash::of(&[b"check of a policy", text.as_bytes()]);
        let faults = shared(text, key, |text| {
            let (reply, answer) = sync_channel(1);
            let job = Job::Check(text.to_owned(), reply);
            self.jobs.send(job).ok().and_then(|()| answer.recv().ok()).ok_or(())
        });
        let Err(mut faults) = faults.unwrap_or_else(|()| Err(vec!["the policy thread is gone".to_owned()])) else {
            return Ok(());
        };
        // Cedar finds faults in no particular order; the text becomes part of a verdict.
        faults.sort();
        faults.dedup();
        let more = faults.len().saturating_sub(FAULTS_SHOWN_MAX);
        faults.truncate(FAULTS_SHOWN_MAX);
        if more > 0 {
            faults.push(format!("{more} more"));
        }
        Err(invalid("the policy is not acceptable", faults.join("; "), "Cedar policies that match the schema"))
    }

    /// The faults of this text as a policy, with their places, or the meaning of its policies.
    ///
    /// # Errors
    /// [`Code::Internal`] if they cannot be found.
    pub(crate) fn diagnose(&self, text: &str) -> Result<PolicyCheck, Rejection> {
        let (reply, answer) = sync_channel(1);
        let asked = self.jobs.send(Job::Diagnose(text.to_owned(), reply)).ok();
        asked.and_then(|()| answer.recv().ok()).ok_or_else(|| {
            Rejection::new(Code::Internal, "the policy cannot be analysed")
                .found("no answer of the policy thread")
                .wanted("a result of the analysis")
        })
    }

    /// Does each policy of a text, in its order, apply to one of the questions? Nothing if that cannot be found out.
    pub(crate) fn matching(&self, questions: Vec<Question>, text: &str) -> Vec<bool> {
        let (reply, answer) = sync_channel(1);
        let asked = self.jobs.send(Job::Match(questions, text.to_owned(), reply)).ok();
        asked.and_then(|()| answer.recv().ok()).unwrap_or_default()
    }

    /// What do these policies decide? A fault of the machinery denies. `texts` gives the policies, and is asked only if
    /// the set is not known: reading many takes longer than the decision.
    ///
    /// # Errors
    /// The content of `texts`.
    pub(crate) fn decide(
        &self,
        question: Question,
        texts: impl FnOnce() -> Result<Texts, Rejection>,
    ) -> Result<Answer, Rejection> {
        let key = |question: &Question| question.hash("decision", 0);
        shared(question, key, |question| {
            let decided = match self.ask(Box::new(question), None) {
                Some(Err(question)) => self.ask(question, Some(texts()?)),
                decided => decided,
            };
            Ok(decided.and_then(Result::ok).unwrap_or_else(|| fault("the policy thread is gone".to_owned())))
        })
    }

    /// What do these policies decide, and why? As [`Engine::decide`], with so much work for the reasons.
    ///
    /// # Errors
    /// The content of `texts`.
    pub(crate) fn explain(
        &self,
        question: Question,
        work: usize,
        texts: impl FnOnce() -> Result<Texts, Rejection>,
    ) -> Result<(Verdict, Explanation), Rejection> {
        let ask = |question, texts| -> Option<Explained> {
            let (reply, answer) = sync_channel(1);
            self.jobs.send(Job::Explain(question, texts, work, reply)).ok()?;
            answer.recv().ok()
        };
        let key = |question: &Question| question.hash("explanation", work);
        shared(question, key, |question| {
            let explained = match ask(Box::new(question), None) {
                Some(Err(question)) => ask(question, Some(texts()?)),
                explained => explained,
            };
            let gone = || (Verdict::Fault("the policy thread is gone".to_owned()), Explanation::default());
            Ok(explained.and_then(Result::ok).unwrap_or_else(gone))
        })
    }

    fn ask(&self, question: Box<Question>, texts: Option<Texts>) -> Option<Decided> {
        let (reply, answer) = sync_channel(1);
        self.jobs.send(Job::Decide(question, texts, reply)).ok()?;
        answer.recv().ok()
    }
}

fn fault(text: String) -> Answer {
    Answer { verdict: Verdict::Fault(text), timeless: false }
}

fn invalid(message: &str, found: String, wanted: &str) -> Rejection {
    Rejection::new(Code::PolicyInvalid, message)
        .found(found)
        .wanted(wanted)
        .next("see the built-in policy: ledgerctl policy list")
}

/// A parsed set. It never leaves the thread: dropping it recurses as well.
struct Parsed {
    policies: Result<Index, String>,
    timeless: bool,
    /// Do the texts speak of the attribute that the robot requires?
    of_required: bool,
    /// Length of the texts.
    bytes: usize,
}

fn serve(queue: &Receiver<Job>, validator: &Validator) {
    let mut parsed = Cache::with_weighter(PARSED_SETS_MAX, PARSED_BYTES_MAX as u64, ByText);
    while let Ok(job) = queue.recv() {
        // A caller that has given up waiting is no fault of ours.
        match job {
            Job::Check(text, reply) => {
                let fault = |_| Err(vec!["Cedar panicked on it".to_owned()]);
                let _ = reply.send(catch_unwind(|| validate(validator, &text)).unwrap_or_else(fault));
            }
            Job::Diagnose(text, reply) => {
                // Without an answer the caller hears that there is none.
                if let Ok(checked) = catch_unwind(|| diagnose::diagnose(validator, &text)) {
                    let _ = reply.send(checked);
                }
            }
            Job::Match(questions, text, reply) => {
                if let Ok(matched) = catch_unwind(AssertUnwindSafe(|| matching::matching(&text, &questions))) {
                    let _ = reply.send(matched);
                }
            }
            Job::Explain(question, texts, work, reply) => {
                let explained = catch_unwind(AssertUnwindSafe(|| {
                    with_set(&mut parsed, &question, texts, |set| explained(set, &question, work))
                }));
                let fault = |_| Some((Verdict::Fault(PANICKED.to_owned()), Explanation::default()));
                let _ = reply.send(explained.unwrap_or_else(fault).ok_or(question));
            }
            Job::Decide(question, texts, reply) => {
                let decided = catch_unwind(AssertUnwindSafe(|| {
                    with_set(&mut parsed, &question, texts, |set| decide(set, &question))
                }));
                let fault = |_| Some(fault(PANICKED.to_owned()));
                let _ = reply.send(decided.unwrap_or_else(fault).ok_or(question));
            }
        }
    }
}

/// Does something with the set of a question, parsed now or before; nothing if the texts are needed first.
fn with_set<T>(
    parsed: &mut Cache<Hash, Parsed, ByText>,
    question: &Question,
    texts: Option<Texts>,
    body: impl FnOnce(&Parsed) -> T,
) -> Option<T> {
    let Some(texts) = texts else { return parsed.get(&question.version).map(body) };
    let set = parse_all(&texts);
    let done = body(&set);
    parsed.insert(question.version, set);
    Some(done)
}

/// A set weighs as much as its texts, at least its share of the room, and at most half of it: every set can be kept.
struct ByText;

impl Weighter<Hash, Parsed> for ByText {
    fn weight(&self, _version: &Hash, set: &Parsed) -> u64 {
        set.bytes.clamp(PARSED_BYTES_MAX / PARSED_SETS_MAX, PARSED_BYTES_MAX / 2) as u64
    }
}

fn validate(validator: &Validator, text: &str) -> Result<(), Vec<String>> {
    let policies: PolicySet = text
        .parse()
        .map_err(|fault: cedar_policy::ParseErrors| fault.iter().map(|fault| fault.to_string()).collect::<Vec<_>>())?;
    if policies.num_of_templates() > 0 {
        return Err(vec!["a template with ?principal or ?resource, which is never instantiated".to_owned()]);
    }
    if policies.is_empty() {
        return Err(vec!["no policy in the text".to_owned()]);
    }
    annotation::check(&policies)?;
    misfits(&policies).map_err(|faults| faults.into_iter().map(|fault| fault.message).collect::<Vec<_>>())?;
    let result = validator.validate(&policies, ValidationMode::Strict);
    let errors = result.validation_errors().map(ToString::to_string);
    let faults: Vec<String> = errors.chain(impossible_policies(&result).map(ToString::to_string)).collect();
    if faults.is_empty() { Ok(()) } else { Err(faults) }
}

/// The faults that Cedar accepts.
fn misfits(policies: &PolicySet) -> Result<(), Vec<Misfit>> {
    naming::check(policies)?;
    impossible::check(policies)
}

/// The policies that can apply to no request.
fn impossible_policies(result: &ValidationResult) -> impl Iterator<Item = &ValidationWarning> {
    result.validation_warnings().filter(|warning| matches!(warning, ValidationWarning::ImpossiblePolicy(_)))
}

fn parse_all(texts: &[(String, String)]) -> Parsed {
    let timeless = !texts.iter().any(|(_, text)| text.contains("context") || annotation::may_have_window(text));
    let bytes = texts.iter().map(|(_, text)| text.len()).sum();
    let of_required = texts.iter().any(|(_, text)| text.contains("requiredAttribute"));
    Parsed { policies: index_all(texts), timeless, of_required, bytes }
}

fn index_all(texts: &[(String, String)]) -> Result<Index, String> {
    let mut all = Index::default();
    for (id, text) in texts {
        let set: PolicySet = text.parse().map_err(|fault| format!("policy {id}: {fault}"))?;
        let only = set.num_of_policies() == 1;
        for policy in set.policies() {
            let name = if only { id.clone() } else { format!("{id}.{}", policy.id()) };
            all.add(policy.new_id(PolicyId::new(name))).map_err(|fault| format!("policy {id}: {fault}"))?;
        }
    }
    Ok(all)
}

fn decide(set: &Parsed, question: &Question) -> Answer {
    let timeless = set.timeless;
    let verdict = match &set.policies {
        Ok(policies) => match evaluate(policies, question).unwrap_or_else(Verdict::Fault) {
            Verdict::NotPermitted { .. } => Verdict::NotPermitted { of_required: set.of_required },
            verdict => verdict,
        },
        Err(fault) => Verdict::Fault(fault.clone()),
    };
    Answer { verdict, timeless }
}

/// A decision with its reasons. Without reasons it is still the decision.
fn explained(set: &Parsed, question: &Question, work: usize) -> (Verdict, Explanation) {
    let reasons = set.policies.as_ref().ok().and_then(|policies| explain::explain(policies, question, work).ok());
    let explanation = Explanation { timeless: set.timeless, ..reasons.unwrap_or_default() };
    (decide(set, question).verdict, explanation)
}

fn evaluate(policies: &Index, question: &Question) -> Result<Verdict, String> {
    let Asked { request, entities, principals, resources } = &asked(question)?;
    // Each set by itself, put together as Cedar would: what one forbids no other permits.
    let (mut faults, mut forbidding, mut closed, mut permitted) = (Vec::new(), Vec::new(), Vec::new(), None);
    for set in policies.candidates(question, principals, resources) {
        let response = Authorizer::new().is_authorized(request, set, entities);
        faults.extend(response.diagnostics().errors().map(ToString::to_string));
        match response.decision() {
            Decision::Allow => {
                for id in response.diagnostics().reason() {
                    match question.said(set, id)? {
                        Said::Permits(more) => {
                            permitted = [Some(more), permitted].into_iter().flatten().reduce(Permit::or)
                        }
                        Said::Closed(window) => closed.push(window),
                    }
                }
            }
            Decision::Deny => forbidding.extend(response.diagnostics().reason().map(ToString::to_string)),
        }
    }
    if !faults.is_empty() && !active(Mutation::AcceptAnErringForbid) {
        faults.sort();
        faults.truncate(FAULTS_SHOWN_MAX);
        return Ok(Verdict::Fault(faults.join("; ")));
    }
    forbidding.sort();
    Ok(match permitted {
        _ if !forbidding.is_empty() => Verdict::Forbidden(forbidding),
        Some(permit) => Verdict::Permit(permit),
        None if question.by_rule => Verdict::Permit(Permit::default()),
        None if !closed.is_empty() => {
            closed.sort();
            Verdict::Closed(closed)
        }
        None => Verdict::NotPermitted { of_required: true },
    })
}

fn display(fault: impl std::fmt::Display) -> String {
    fault.to_string()
}
