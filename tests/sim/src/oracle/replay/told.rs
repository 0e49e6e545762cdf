//! Holders and lines as the events of the blocks tell them, which is all that robots and operators hear.

use super::{Model, NAME};
use crate::client::SERVICES;
use crate::invariant::Violation;
use ledger::Outcome;
use serde::Deserialize;
use std::collections::{BTreeMap, BTreeSet};

/// Holders with their epochs, and those who wait.
#[derive(Default)]
pub(super) struct Standing {
    holders: BTreeMap<String, BTreeSet<(String, u64)>>,
    lines: BTreeMap<String, BTreeSet<String>>,
}

/// The fields that are read of these events.
#[derive(Deserialize)]
struct Told {
    holder: Option<String>,
    contender: Option<String>,
    epoch: Option<u64>,
    reason: Option<String>,
}

/// The service of the first turn at the start of a block: somebody was granted it, or was not permitted any more.
pub(super) fn first_turn(outcome: &Outcome) -> Option<&str> {
    let mut own = outcome.events.iter().take_while(|emitted| emitted.index.is_none()).map(|emitted| &emitted.event);
    let turn = own.find(|event| {
        let reason = || serde_json::from_slice::<Told>(&event.payload).unwrap().reason;
        let by_policy = || reason().is_some_and(|reason| matches!(&*reason, "policy" | "expired"));
        event.chaincode == "abac" && (event.name == "granted" || event.name == "left" && by_policy())
    });
    turn.map(|event| &*event.subject)
}

impl Standing {
    /// A block was executed.
    pub(super) fn follow(&mut self, outcome: &Outcome) {
        let known = |name: &str| matches!(name, "granted" | "released" | "queued" | "left");
        let events = outcome.events.iter().map(|emitted| &emitted.event);
        for event in events.filter(|event| event.chaincode == "abac" && known(&event.name)) {
            let Told { holder, contender, epoch, .. } = serde_json::from_slice(&event.payload).unwrap();
            let who = holder.or(contender).unwrap_or_default();
            let holders = self.holders.entry(event.subject.clone()).or_default();
            let line = self.lines.entry(event.subject.clone()).or_default();
            match &*event.name {
                "granted" => {
                    line.remove(&who);
                    holders.insert((who, epoch.unwrap_or_default()));
                }
                "released" => drop(holders.remove(&(who, epoch.unwrap_or_default()))),
                "queued" => drop(line.insert(who)),
                _ => drop(line.remove(&who)),
            }
        }
    }

    /// Does the model say the same after this block?
    pub(super) fn check(&self, model: &Model, height: u64) -> Result<(), Violation> {
        for service in SERVICES {
            let holders: BTreeSet<_> =
                model.stored(service).iter().map(|grant| (grant.holder.clone(), grant.epoch)).collect();
            let line: BTreeSet<String> = model.line(service).iter().map(|waiter| waiter.who.clone()).collect();
            let told = (self.holders.get(service).cloned(), self.lines.get(service).cloned());
            let told = (told.0.unwrap_or_default(), told.1.unwrap_or_default());
            if told != (holders.clone(), line.clone()) {
                let what = format!(
                    "{service} after block {height}: holders and line {told:?}, the model says {holders:?} {line:?}"
                );
                return Err(Violation::new(NAME, what));
            }
        }
        Ok(())
    }
}
