//! Holders, lines and tasks as the events of the blocks tell them, which is all that robots and operators hear.

use super::super::model::{Model, State};
use super::NAME;
use crate::client::{READERS, SERVICES};
use crate::confidential::SERVICE;
use crate::invariant::Violation;
use ledger::Outcome;
use serde::Deserialize;
use std::collections::{BTreeMap, BTreeSet};

/// How many of a line the event `line` names.
const TOLD_MAX: usize = 16;

/// Holders with their epochs, those who wait, and tasks.
#[derive(Default)]
pub(super) struct Standing {
    holders: BTreeMap<String, BTreeSet<(String, u64)>>,
    lines: BTreeMap<String, BTreeSet<String>>,
    /// How many places of each line are taken, and by whom the first of them; as it was told last.
    places: BTreeMap<String, (u64, Vec<String>)>,
    /// Service, submitter, state, reached points and all.
    tasks: BTreeMap<u64, (String, String, State, u64, u64)>,
}

/// The fields that are read of these events.
#[derive(Deserialize)]
struct Told {
    holder: Option<String>,
    contender: Option<String>,
    epoch: Option<u64>,
    #[serde(default)]
    waiting: u64,
    #[serde(default)]
    next: Vec<String>,
}

/// The fields that are read of a task.
#[derive(Deserialize)]
struct OfTask {
    id: u64,
    submitter: String,
    state: State,
    reached: u64,
    total: u64,
}

impl Standing {
    /// A block was executed.
    pub(super) fn follow(&mut self, outcome: &Outcome) {
        let known = |name: &str| matches!(name, "granted" | "released" | "queued" | "left" | "line");
        let events = outcome.events.iter().map(|emitted| &emitted.event).filter(|event| event.chaincode == "abac");
        for event in events {
            let subject = || event.subject.clone();
            if event.name == "task" {
                let OfTask { id, submitter, state, reached, total } = serde_json::from_slice(&event.payload).unwrap();
                self.tasks.insert(id, (subject(), submitter, state, reached, total));
            }
            if !known(&event.name) {
                continue;
            }
            let Told { holder, contender, epoch, waiting, next } = serde_json::from_slice(&event.payload).unwrap();
            let who = holder.or(contender).unwrap_or_default();
            let holders = self.holders.entry(subject()).or_default();
            let line = self.lines.entry(subject()).or_default();
            match &*event.name {
                "granted" => {
                    // The grant of a task leaves the place that its submitter has for itself.
                    if !is_for_a_task(&event.payload) {
                        line.remove(&who);
                    }
                    holders.insert((who, epoch.unwrap_or_default()));
                }
                "released" => drop(holders.remove(&(who, epoch.unwrap_or_default()))),
                "queued" => drop(line.insert(who)),
                "left" => drop(line.remove(&who)),
                _ => drop(self.places.insert(subject(), (waiting, next))),
            }
        }
    }

    /// Does the model say the same after this block?
    pub(super) fn check(&mut self, model: &Model, outcome: &Outcome) -> Result<(), Violation> {
        let height = outcome.header.height;
        let wrong = |what: String| Violation::new(NAME, format!("after block {height}: {what}"));
        for service in SERVICES
            .into_iter()
            .chain([SERVICE])
            .flat_map(|service| [service.to_owned(), format!("{service}{READERS}")])
        {
            let holders: BTreeSet<_> =
                model.stored(&service).iter().map(|grant| (grant.holder.clone(), grant.epoch)).collect();
            let own = model.line(&service).iter().filter(|waiter| waiter.task.is_none());
            let line: BTreeSet<String> = own.map(|waiter| waiter.who.clone()).collect();
            let told = (self.holders.get(&service).cloned(), self.lines.get(&service).cloned());
            let told = (told.0.unwrap_or_default(), told.1.unwrap_or_default());
            if told != (holders.clone(), line.clone()) {
                let what = format!("{service}: holders and line {told:?}, the model says {holders:?} {line:?}");
                return Err(wrong(what));
            }
            if model.find(&service).is_err() {
                // The next block sends away whoever waits for places that are gone, and tells of no line.
                self.places.remove(&service);
            }
            self.check_order(model, &service, outcome).map_err(wrong)?;
        }
        let mut wanted = (1..).zip(model.tasks());
        let differs = wanted.find(|(id, task)| {
            let (service, submitter) = (task.service.clone(), task.submitter.clone());
            self.tasks.get(id) != Some(&(service, submitter, task.state, task.reached, task.total))
        });
        if let Some((id, task)) = differs {
            return Err(wrong(format!("task {id} {:?}, the model says {task:?}", self.tasks.get(&id))));
        }
        Ok(())
    }

    /// The line as it was told last is that of the model. A change of settings may change its order and tells nothing.
    fn check_order(&self, model: &Model, service: &str, outcome: &Outcome) -> Result<(), String> {
        let line = model.line(service);
        let (waiting, next) = self.places.get(service).cloned().unwrap_or_default();
        let Ok((_, found)) = model.find(service) else { return Ok(()) };
        if waiting != line.len() as u64 {
            return Err(format!("{waiting} wait for {service}, the model says {line:?}"));
        }
        let robot = service.split('/').next().unwrap_or_default();
        let events = outcome.events.iter().map(|emitted| &emitted.event);
        let changed = events.clone().any(|event| event.name == "robot" && event.subject == robot);
        let is_told = events.clone().any(|event| event.name == "line" && event.subject == service);
        let order = found.order(line, outcome.header.time);
        let wanted: Vec<&String> = order.iter().take(TOLD_MAX).map(|at| &line[*at].who).collect();
        if is_told && !changed && !next.iter().eq(wanted.iter().copied()) {
            return Err(format!("the line of {service} is {next:?}, the model says {wanted:?}"));
        }
        Ok(())
    }
}

fn is_for_a_task(granted: &[u8]) -> bool {
    #[derive(Deserialize)]
    struct Granted {
        task: Option<u64>,
    }
    serde_json::from_slice(granted).is_ok_and(|Granted { task }| task.is_some())
}
