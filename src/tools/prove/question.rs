//! The two questions, as what a solver can answer: no request is permitted, or what one set permits another permits, too.

use super::facts::{self, Robot, quoted};
use super::solver::Cvc5;
use super::words::{self, Found};
use cedar_policy::{Effect, EntityId, EntityTypeName, EntityUid, Policy, PolicyId, PolicySet, RequestEnv, Schema};
use cedar_policy_symcc::err::Error;
use cedar_policy_symcc::solver::LocalSolver;
use cedar_policy_symcc::{CedarSymCompiler, CompiledPolicy, CompiledPolicySet, Env};
use ledger_abac::{Analysis, SCHEMA, terms};
use ledger_base::nearest::did_you_mean;
use ledger_base::rejection::{Code, Rejection};
use std::collections::BTreeSet;
use std::str::FromStr;

/// Every action of the schema.
const ALL: [&str; 7] = ["acquire", "publish", "subscribe", "override", "confirm", "stop", "resume"];
/// The actions on a whole robot.
const OF_ROBOTS: [&str; 2] = ["stop", "resume"];
/// The action that some may do by rule.
const BY_RULE: &str = "stop";

/// Actions to prove something about.
#[derive(Clone, Debug, Default)]
pub(super) struct Actions {
    names: Vec<&'static str>,
    /// On services that users publish on.
    of_commands: bool,
}

/// Reads an action, or `drive`.
pub(super) fn actions(text: &str) -> Result<Actions, String> {
    if text == "drive" {
        return Ok(Actions { names: vec!["acquire", "publish"], of_commands: true });
    }
    let known = ALL.into_iter().find(|action| *action == text);
    known.map(|action| Actions { names: vec![action], of_commands: false }).ok_or_else(|| {
        let known = || ["drive"].into_iter().chain(ALL);
        let wanted = known().collect::<Vec<_>>().join(", ");
        format!("wanted one of {wanted}; {}", did_you_mean(text, known(), "drive is acquire and publish"))
    })
}

/// The people who cannot do it.
pub(super) enum Who {
    /// Those without an attribute, `NAME` or `NAME=VALUE`.
    Without(String),
    /// Those of an organisation.
    Of(String),
}

/// A question about policies.
pub(super) enum Question {
    /// Can nobody of these do one of the actions?
    Nobody { who: Who, actions: Actions, facts: Robot },
    /// Do they permit at most what these permit?
    AtMost(Analysis),
}

/// The answer.
pub(super) struct Answer {
    pub(super) text: String,
    pub(super) is_proved: bool,
}

impl Who {
    fn condition(&self) -> String {
        match self {
            Self::Of(organisation) => format!("principal.organisation == {}", quoted(organisation)),
            Self::Without(attribute) => match attribute.split_once('=') {
                None => format!("!(principal.hasTag({}))", quoted(attribute)),
                Some((name, value)) => {
                    let (name, value) = (quoted(name), quoted(value));
                    format!("!(principal.hasTag({name}) && principal.getTag({name}) == {value})")
                }
            },
        }
    }

    fn words(&self) -> String {
        match self {
            Self::Of(organisation) => format!("no one of {organisation}"),
            Self::Without(attribute) => format!("no one without the attribute {attribute}"),
        }
    }
}

/// Answers a question about these policies.
///
/// # Errors
/// A solver that fails or does not know.
pub(super) fn prove(solver: &Cvc5, policies: &Analysis, question: &Question) -> Result<Answer, Rejection> {
    let internal = |found: String| Rejection::new(Code::Internal, "the proof failed").found(found);
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
    let runtime = runtime.map_err(|error| internal(error.to_string()))?;
    let (schema, _) = Schema::from_cedarschema_str(SCHEMA).map_err(|error| internal(error.to_string()))?;
    runtime.block_on(async {
        let compiler = CedarSymCompiler::new(solver.start()?).map_err(|error| undecided(&error))?;
        let mut prover = Prover { schema, compiler };
        match question {
            Question::Nobody { who, actions, facts } => prover.nobody(policies, who, actions, facts).await,
            Question::AtMost(old) => prover.at_most(policies, old).await,
        }
    })
}

struct Prover {
    schema: Schema,
    compiler: CedarSymCompiler<LocalSolver>,
}

impl Prover {
    async fn nobody(
        &mut self,
        policies: &Analysis,
        who: &Who,
        actions: &Actions,
        robot: &Robot,
    ) -> Result<Answer, Rejection> {
        for action in &actions.names {
            let mut facts = facts::expressions(robot, is_of_service(action), policies.all());
            facts.push(who.condition());
            facts.extend(actions.of_commands.then(|| "resource.direction == \"command\"".to_owned()));
            let set = set(policies.deciding(action), &facts)?;
            let compiled = self.compile(&set, action)?;
            let checked = self.compiler.check_always_denies_with_counterexample_opt(&compiled).await;
            if let Some(example) = checked.map_err(|error| undecided(&error))? {
                let found = found(&set, action, &example);
                let text = format!("not proved: there is a counterexample\n{}", words::request(&found));
                return Ok(Answer { text, is_proved: false });
            }
        }
        let what = if actions.of_commands { "drive" } else { actions.names.first().unwrap_or(&"use") };
        let object = robot.robot.as_deref().unwrap_or("any robot");
        let by_rule = match actions.names.first() {
            Some(&BY_RULE) => {
                "\nby rule, the robot itself, holders of its command services and admins of its owner always may"
            }
            Some(&("override" | "confirm" | "resume")) => "\nby rule, admins of its owner always may",
            _ => "",
        };
        Ok(Answer { text: format!("proved: {} can {what} {object}{by_rule}", who.words()), is_proved: true })
    }

    async fn at_most(&mut self, new: &Analysis, old: &Analysis) -> Result<Answer, Rejection> {
        for action in ALL {
            let facts = facts::expressions(&Robot::ANY, is_of_service(action), new.all().chain(old.all()));
            self.check_errors(old, action).await?;
            // A limit, a window of time and a priority are compared as they are written: an old permit covers new ones if it says
            // the same as they, or nothing.
            let permits = || new.deciding(action).filter(|policy| policy.effect() == Effect::Permit);
            let all_terms: BTreeSet<String> = permits().map(terms).collect();
            for said in &all_terms {
                let new_set = set(of_terms(new, action, |other| other == said), &facts)?;
                let old_set = set(of_terms(old, action, |other| other.is_empty() || other == said), &facts)?;
                if let Some(example) = self.check_implies(&new_set, &old_set, action).await? {
                    return Ok(more(&found(&new_set, action, &example), said));
                }
            }
        }
        let facts = facts::expressions(&Robot::ANY, false, new.all().chain(old.all()));
        let everybody = parsed("by-rule", "permit(principal, action, resource);")?;
        let by_rule = |policies: &Analysis| set(policies.against_rule(BY_RULE).chain([&everybody]), &facts);
        let (new_set, old_set) = (by_rule(new)?, by_rule(old)?);
        if let Some(example) = self.check_implies(&new_set, &old_set, BY_RULE).await? {
            return Ok(more(&found(&new_set, BY_RULE, &example), ""));
        }
        Ok(Answer {
            text: "proved: the new policies permit at most what the old ones permit".to_owned(),
            is_proved: true,
        })
    }

    /// An old policy that fails to evaluate denies on the ledger, and permits here.
    async fn check_errors(&mut self, old: &Analysis, action: &str) -> Result<(), Rejection> {
        for policy in old.deciding(action) {
            let compiled = CompiledPolicy::compile(policy, &environment(action)?, &self.schema);
            let compiled = compiled.map_err(|error| undecided(&error))?;
            let never_fails = self.compiler.check_never_errors_opt(&compiled).await;
            if !never_fails.map_err(|error| undecided(&error))? {
                return Err(Rejection::new(Code::PolicyInvalid, "policies that can fail to evaluate cannot be proved")
                    .found(format!("{}, which can fail, such as by numbers that are too large", policy.id()))
                    .wanted("conditions that always have a value")
                    .next("compare numbers without addition or multiplication"));
            }
        }
        Ok(())
    }

    async fn check_implies(
        &mut self,
        new: &PolicySet,
        old: &PolicySet,
        action: &str,
    ) -> Result<Option<Env>, Rejection> {
        let (new, old) = (self.compile(new, action)?, self.compile(old, action)?);
        let checked = self.compiler.check_implies_with_counterexample_opt(&new, &old).await;
        checked.map_err(|error| undecided(&error))
    }

    fn compile(&self, set: &PolicySet, action: &str) -> Result<CompiledPolicySet, Rejection> {
        CompiledPolicySet::compile(set, &environment(action)?, &self.schema).map_err(|error| undecided(&error))
    }
}

/// The deciding permits whose terms fit, and all that forbids.
fn of_terms<'a>(policies: &'a Analysis, action: &str, fits: impl Fn(&str) -> bool) -> impl Iterator<Item = &'a Policy> {
    policies.deciding(action).filter(move |policy| policy.effect() == Effect::Forbid || fits(&terms(policy)))
}

fn more(found: &Found, said: &str) -> Answer {
    let request = words::request(found);
    let terms =
        if said.is_empty() { String::new() } else { format!("\nwith {said}; limits are compared as they are written") };
    let text = format!("not proved: the new policies permit a request that the old ones do not\n{request}{terms}");
    Answer { text, is_proved: false }
}

fn is_of_service(action: &str) -> bool {
    !OF_ROBOTS.contains(&action)
}

/// The policies, which permit only where all facts hold.
fn set<'a>(policies: impl Iterator<Item = &'a Policy>, facts: &[String]) -> Result<PolicySet, Rejection> {
    let mut set = PolicySet::new();
    for policy in policies {
        set.add(policy.clone()).map_err(|error| unreadable(&error))?;
    }
    let all = facts.iter().map(|fact| format!("({fact})")).collect::<Vec<_>>().join(" && ");
    let text = format!("forbid(principal, action, resource) unless {{ {all} }};");
    set.add(parsed("facts", &text)?).map_err(|error| unreadable(&error))?;
    Ok(set)
}

fn parsed(id: &str, text: &str) -> Result<Policy, Rejection> {
    Policy::parse(Some(PolicyId::new(id)), text).map_err(|error| unreadable(&error))
}

/// The kinds of principal and resource of an action.
fn environment(action: &str) -> Result<RequestEnv, Rejection> {
    let kind = |name: &str| EntityTypeName::from_str(name).map_err(|error| unreadable(&error));
    let resource = if is_of_service(action) { "Service" } else { "Robot" };
    let action = EntityUid::from_type_name_and_id(kind("Action")?, EntityId::new(action));
    Ok(RequestEnv::new(kind("User")?, action, kind(resource)?))
}

fn found(set: &PolicySet, action: &str, example: &Env) -> Found {
    Found::of(set, action, &example.request, &example.entities)
}

fn unreadable(error: &impl std::fmt::Display) -> Rejection {
    Rejection::new(Code::Internal, "the question cannot be expressed").found(error.to_string())
}

/// The refusal of a question that the solver did not decide.
fn undecided(error: &Error) -> Rejection {
    match error {
        Error::SolverUnknown => Rejection::new(Code::LimitExceeded, "the solver reached its time limit")
            .found("60 s without an answer")
            .wanted("policies that can be decided in a minute")
            .next("name the robot and its known properties, or prove the files one by one"),
        error => Rejection::new(Code::Internal, "the proof failed").found(error.to_string()),
    }
}
