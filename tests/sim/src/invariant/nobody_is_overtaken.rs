//! Nobody in line is overtaken (docs/conflict.md, "Queue"). A holder that is granted a service goes before all who wait for
//! it: with a higher priority, or an equal one and an earlier arrival. Those whom policies permit no more leave before that. Where waiting
//! raises priorities, the oracle judges alone. Tasks wait like contenders. A holder of the service is passed over, also by the one who
//! takes its place.
//!
//! Told by the events, and by the settings that owners chose.

use super::{Check, Executed, Violation, is_of};
use crate::client::READERS;
use crate::people::People;
use ledger::transaction::Transaction;
use ledger_base::rejection::Code;
use ledger_storage::result::Event;
use serde::Deserialize;
use serde_json::{Map, Value};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

const NAME: &str = "nobody is overtaken";

/// The lines, and the settings of services.
pub struct NobodyIsOvertaken {
    people: Arc<People>,
    /// In order of arrival.
    lines: BTreeMap<String, Vec<Waits>>,
    /// Those who hold services: they are passed over in line.
    holders: BTreeMap<String, BTreeSet<(String, u64)>>,
    /// Services and their holders whose place the next grant takes.
    replaced: BTreeSet<(String, String)>,
    /// Open tasks that wait and are in no line yet: they join it with the next block.
    joining: BTreeMap<u64, (String, Waits)>,
    /// Priorities of tasks.
    tasks: BTreeMap<u64, i64>,
    /// The settings, where there are some.
    settings: BTreeMap<String, Map<String, Value>>,
    /// The calls of those who wait to be confirmed, by service and contender.
    asking: BTreeMap<(String, String), Transaction>,
}

/// A place in line.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Waits {
    who: String,
    task: Option<u64>,
    priority: i64,
}

/// The fields that are read of events.
#[derive(Deserialize)]
struct Told {
    holder: Option<String>,
    contender: Option<String>,
    #[serde(default)]
    priority: i64,
    #[serde(default)]
    mode: String,
    #[serde(default)]
    epoch: u64,
    task: Option<u64>,
    by: Option<String>,
}

/// The fields that are read of a task.
#[derive(Deserialize)]
struct OfTask {
    id: u64,
    submitter: String,
    state: String,
    #[serde(default)]
    reason: String,
}

#[derive(Deserialize)]
struct Configured {
    sharing: Map<String, Value>,
}

#[derive(Deserialize)]
struct Wishes {
    priority: Option<i64>,
}

impl NobodyIsOvertaken {
    /// For these people.
    pub fn new(people: Arc<People>) -> Self {
        Self {
            people,
            lines: BTreeMap::new(),
            holders: BTreeMap::new(),
            replaced: BTreeSet::new(),
            joining: BTreeMap::new(),
            tasks: BTreeMap::new(),
            settings: BTreeMap::new(),
            asking: BTreeMap::new(),
        }
    }

    /// A block was executed for the first time.
    ///
    /// # Errors
    /// A grant went to somebody whom others precede.
    pub fn executed(&mut self, executed: &Executed<'_>) -> Check {
        let height = executed.outcome.header.height;
        for (_, (service, waits)) in std::mem::take(&mut self.joining) {
            self.lines.entry(service).or_default().push(waits);
        }
        let mut events = executed.outcome.events.iter().filter(|emitted| emitted.event.chaincode == "abac").peekable();
        while let Some(emitted) = events.next_if(|emitted| emitted.index.is_none()) {
            self.told(&emitted.event, None, None, height)?;
        }
        for (at, transaction) in (0..).zip(executed.transactions) {
            let succeeded = executed.outcome.results.get(at as usize).is_some_and(|result| result.code() == Code::Ok);
            let transaction = transaction.as_ref().filter(|_| succeeded);
            transaction.iter().for_each(|transaction| self.configured(transaction));
            // One that has the service already and comes with another certificate goes on.
            let mut released = None;
            while let Some(emitted) = events.next_if(|emitted| emitted.index == Some(at)) {
                self.told(&emitted.event, transaction, released.as_deref(), height)?;
                if emitted.event.name == "released" {
                    released = told(&emitted.event).holder;
                }
            }
        }
        Ok(())
    }

    fn told(&mut self, event: &Event, call: Option<&Transaction>, released: Option<&str>, height: u64) -> Check {
        if event.name == "task" {
            self.told_of_a_task(event, call);
            return Ok(());
        }
        if !matches!(&*event.name, "queued" | "left" | "granted" | "released" | "pending") {
            return Ok(());
        }
        let Told { holder, contender, priority, mode, epoch, task, by } = told(event);
        let (service, who) = (&event.subject, holder.or(contender).unwrap_or_default());
        if event.name == "pending" {
            self.asking.extend(call.map(|call| ((service.clone(), who), call.clone())));
            return Ok(());
        }
        let goes_on = released == Some(&*who);
        if event.name == "granted" && mode != "open" && !goes_on && !self.is_for_everybody(service, &mode) {
            self.judge(service, &who, (task, call), height)?;
        }
        let (line, holders) = (self.lines.entry(service.clone()), self.holders.entry(service.clone()).or_default());
        let line = line.or_default();
        let is_place = |waits: &Waits| waits.who == who && waits.task == task;
        match &*event.name {
            "queued" if line.iter().any(is_place) => {}
            "queued" => line.push(Waits { who, task, priority }),
            "granted" => {
                line.retain(|waits| !is_place(waits));
                holders.insert((who, epoch));
                self.replaced.retain(|(of, _)| of != service);
            }
            "released" => {
                holders.remove(&(who.clone(), epoch));
                self.replaced.extend(by.map(|_| (service.clone(), who)));
            }
            _ => line.retain(|waits| !is_place(waits)),
        }
        Ok(())
    }

    /// A task is told of, not its place in line. One that was interrupted joins the line with the next block.
    fn told_of_a_task(&mut self, event: &Event, call: Option<&Transaction>) {
        let OfTask { id, submitter, state, reason } = serde_json::from_slice(&event.payload).unwrap();
        let service = event.subject.clone();
        // The call that submits a task emits its first event. The same call may interrupt another task.
        if let Some(submit) = call.filter(|call| call.body().function == "submit" && !self.tasks.contains_key(&id)) {
            let priority = self.priority(&service, submit);
            self.tasks.insert(id, priority);
        }
        let priority = self.tasks.get(&id).copied().unwrap_or(0);
        let waits = Waits { who: submitter, task: Some(id), priority };
        match &*state {
            "waiting" if reason.is_empty() => self.lines.entry(service).or_default().push(waits),
            "waiting" => drop(self.joining.insert(id, (service, waits))),
            "scheduled" | "running" => {}
            _ => {
                self.joining.remove(&id);
                self.lines.entry(service).or_default().retain(|other| other.task != Some(id));
            }
        }
    }

    /// Where only readers are limited, everybody may hold the service, whoever waits.
    fn is_for_everybody(&self, service: &str, mode: &str) -> bool {
        let limited = self.settings.get(service).is_some_and(|settings| settings.contains_key("publishers"));
        mode == "limited" && !limited && !service.ends_with(READERS)
    }

    /// The settings of a service, also of the places of its readers.
    fn settings(&self, service: &str) -> Option<&Map<String, Value>> {
        self.settings.get(service.strip_suffix(READERS).unwrap_or(service))
    }

    /// Does this one precede all who wait?
    fn judge(&self, service: &str, who: &str, (task, call): (Option<u64>, Option<&Transaction>), height: u64) -> Check {
        // These go to one that its holder chose, or to one that is above every rule.
        let chosen = |function: &str| matches!(function, "take" | "delegate" | "handover" | "recall");
        let taken = call.is_some_and(|call| chosen(&call.body().function));
        let ages = self.settings(service).is_some_and(|settings| settings.contains_key("aging_ms"));
        let holds = |waits: &&Waits| {
            self.holders.get(service).is_some_and(|holders| holders.iter().any(|(holder, _)| *holder == waits.who))
                || self.replaced.contains(&(service.to_owned(), waits.who.clone()))
        };
        let line: Vec<&Waits> = self.lines.get(service).into_iter().flatten().filter(|waits| !holds(waits)).collect();
        if taken || ages || line.is_empty() {
            return Ok(());
        }
        let known = line.iter().position(|waits| waits.who == who && waits.task == task);
        let (at, priority) = match (known, call) {
            (Some(at), _) => (at, line.get(at).map_or(0, |waits| waits.priority)),
            (None, Some(call)) => {
                // One that others have confirmed comes with the wishes of its own call.
                let asked = self.asking.get(&(service.to_owned(), who.to_owned()));
                let asked = asked.filter(|_| call.body().function == "confirm").unwrap_or(call);
                (line.len(), self.priority(service, asked))
            }
            (None, None) => {
                return Err(Violation::new(
                    NAME,
                    format!("block {height} grants {service} to {who}, who did not wait"),
                ));
            }
        };
        let precedes = |(other, waits): &(usize, &&Waits)| {
            *other != at && (waits.priority > priority || waits.priority == priority && *other < at)
        };
        match line.iter().enumerate().find(precedes) {
            None => Ok(()),
            Some((_, waits)) => {
                let what =
                    format!("block {height} grants {service} to {who} with priority {priority}, and {waits:?} waits");
                Err(Violation::new(NAME, what))
            }
        }
    }

    /// The priority of one that comes.
    fn priority(&self, service: &str, transaction: &Transaction) -> i64 {
        let source = self.settings(service).and_then(|settings| settings.get("priority")?.as_str());
        let people = Arc::clone(&self.people);
        let creator = people.by_fingerprint(&transaction.creator());
        let own = match source.and_then(|source| source.split_once(':')) {
            Some(("fixed", number)) => number.parse().ok(),
            // Every organisation that may use a robot is trusted.
            Some((_, name)) => creator.and_then(|creator| creator.identity.attributes.get(name)?.parse().ok()),
            None => None,
        };
        let body = transaction.body();
        let wishes = body
            .args
            .get(usize::from(body.function != "acquire_all"))
            .and_then(|text| serde_json::from_slice::<Wishes>(text).ok());
        let (own, wanted) = (own.unwrap_or(0), wishes.and_then(|wishes| wishes.priority));
        wanted.map_or(own, |wanted| own.min(wanted))
    }

    fn configured(&mut self, transaction: &Transaction) {
        let body = transaction.body();
        match (&*body.chaincode, &*body.function, body.args.as_slice()) {
            ("abac", "replace", robots) => self.settings.retain(|service, _| !is_of(service, robots)),
            ("abac", "configure", [service, settings]) => {
                let Configured { sharing } = serde_json::from_slice(settings).unwrap();
                self.settings.insert(String::from_utf8_lossy(service).into_owned(), sharing);
            }
            _ => {}
        }
    }
}

fn told(event: &Event) -> Told {
    serde_json::from_slice(&event.payload).unwrap()
}
