//! Nobody in line is overtaken (docs/conflict.md, "The line"). A holder that is granted a service goes before all who wait for
//! it: with a higher priority, or an equal one and an earlier arrival. Those whom policies permit no more leave before that. Where waiting
//! raises priorities, the oracle judges alone.
//!
//! Told by the events, and by the settings that owners chose.

use super::{Check, Executed, Violation};
use crate::people::People;
use ledger::transaction::Transaction;
use ledger_rejection::Code;
use ledger_storage::result::Event;
use serde::Deserialize;
use serde_json::{Map, Value};
use std::collections::BTreeMap;
use std::sync::Arc;

const NAME: &str = "nobody is overtaken";

/// The lines, and the settings of services.
pub struct NobodyIsOvertaken {
    people: Arc<People>,
    /// Contenders with their priorities, in order of arrival.
    lines: BTreeMap<String, Vec<(String, i64)>>,
    /// The settings, where there are some.
    settings: BTreeMap<String, Map<String, Value>>,
    /// The calls of those who wait to be confirmed, by service and contender.
    asking: BTreeMap<(String, String), Transaction>,
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
        Self { people, lines: BTreeMap::new(), settings: BTreeMap::new(), asking: BTreeMap::new() }
    }

    /// A block was executed for the first time.
    ///
    /// # Errors
    /// A grant went to somebody whom others precede.
    pub fn executed(&mut self, executed: &Executed<'_>) -> Check {
        let height = executed.outcome.header.height;
        let mut events = executed.outcome.events.iter().peekable();
        while let Some(emitted) = events.next_if(|emitted| emitted.index.is_none()) {
            self.told(&emitted.event, None, height)?;
        }
        for (at, transaction) in (0..).zip(executed.transactions) {
            let succeeded = executed.outcome.results.get(at as usize).is_some_and(|result| result.code() == Code::Ok);
            let transaction = transaction.as_ref().filter(|_| succeeded);
            transaction.iter().for_each(|transaction| self.configured(transaction));
            // One that has the service already and comes with another certificate goes on.
            let mut released = None;
            while let Some(emitted) = events.next_if(|emitted| emitted.index == Some(at)) {
                let event = &emitted.event;
                match (&*event.chaincode, &*event.name) {
                    ("abac", "released") => released = told(event).holder,
                    ("abac", "granted") if told(event).holder == released => {}
                    _ => self.told(event, transaction, height)?,
                }
            }
        }
        Ok(())
    }

    fn told(&mut self, event: &Event, transaction: Option<&Transaction>, height: u64) -> Check {
        if event.chaincode != "abac" || !matches!(&*event.name, "queued" | "left" | "granted" | "pending") {
            return Ok(());
        }
        let Told { holder, contender, priority, mode } = told(event);
        let (service, who) = (&event.subject, holder.or(contender).unwrap_or_default());
        if event.name == "pending" {
            self.asking.extend(transaction.map(|call| ((service.clone(), who), call.clone())));
            return Ok(());
        }
        if event.name == "granted" && mode != "open" {
            self.judge(service, &who, transaction, height)?;
        }
        let line = self.lines.entry(service.clone()).or_default();
        match &*event.name {
            "queued" if line.iter().any(|(waits, _)| *waits == who) => {}
            "queued" => line.push((who, priority)),
            _ => line.retain(|(waits, _)| *waits != who),
        }
        Ok(())
    }

    /// Does this one precede all who wait?
    fn judge(&self, service: &str, who: &str, transaction: Option<&Transaction>, height: u64) -> Check {
        // These go to one that its holder chose, or to one that is above every rule.
        let chosen = |function: &str| matches!(function, "take" | "delegate" | "handover" | "recall");
        let taken = transaction.is_some_and(|transaction| chosen(&transaction.body().function));
        let ages = self.settings.get(service).is_some_and(|settings| settings.contains_key("aging_ms"));
        let line = self.lines.get(service).map_or(&[][..], Vec::as_slice);
        if taken || ages || line.is_empty() {
            return Ok(());
        }
        let known = line.iter().position(|(waits, _)| waits == who);
        let (at, priority) = match (known, transaction) {
            (Some(at), _) => (at, line.get(at).map_or(0, |(_, priority)| *priority)),
            (None, Some(transaction)) => {
                // One that others have confirmed comes with the wishes of its own call.
                let asked = self.asking.get(&(service.to_owned(), who.to_owned()));
                let asked = asked.filter(|_| transaction.body().function == "confirm").unwrap_or(transaction);
                (line.len(), self.priority(service, asked))
            }
            (None, None) => {
                return Err(Violation::new(
                    NAME,
                    format!("block {height} grants {service} to {who}, who did not wait"),
                ));
            }
        };
        let first = line
            .iter()
            .enumerate()
            .find(|(other, (_, higher))| *other != at && (*higher > priority || *higher == priority && *other < at));
        match first {
            None => Ok(()),
            Some((_, (waits, higher))) => {
                let what = format!(
                    "block {height} grants {service} to {who} with priority {priority}, and {waits} waits with {higher}"
                );
                Err(Violation::new(NAME, what))
            }
        }
    }

    /// The priority of one that comes.
    fn priority(&self, service: &str, transaction: &Transaction) -> i64 {
        let source = self.settings.get(service).and_then(|settings| settings.get("priority")?.as_str());
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
            ("abac", "replace", _) => self.settings.clear(),
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
