//! Grant exclusivity (design.md §7.4): at every height at most as many holders as the service's mode allows.
//!
//! Told by the events, which is how the robots' bridges know.

use super::{Check, Executed, Violation};
use crate::client::PUBLISHERS;
use ledger::Outcome;
use serde::Deserialize;
use std::collections::{BTreeMap, BTreeSet};

const NAME: &str = "grant exclusivity";

/// The holders of services.
#[derive(Default)]
pub struct GrantExclusivity {
    holders: BTreeMap<String, BTreeSet<(String, u64)>>,
}

#[derive(Deserialize)]
struct Granted {
    service: String,
    holder: String,
    epoch: u64,
    #[serde(default)]
    mode: String,
}

impl GrantExclusivity {
    /// A block was executed for the first time.
    ///
    /// # Errors
    /// A service for one has two holders, or a grant ended that nobody had.
    pub fn executed(&mut self, executed: &Executed<'_>) -> Check {
        let height = executed.outcome.header.height;
        for (name, Granted { service, holder, epoch, mode }) in grants(executed.outcome) {
            let holders = self.holders.entry(service.clone()).or_default();
            match name {
                "granted" => {
                    holders.insert((holder, epoch));
                    let most = match &*mode {
                        "exclusive" => 1,
                        "limited" => PUBLISHERS,
                        _ => usize::MAX,
                    };
                    if holders.len() > most {
                        return Err(Violation::new(NAME, format!("at height {height} {service} has {holders:?}")));
                    }
                }
                "renewed" if holders.contains(&(holder.clone(), epoch)) => {}
                "released" if holders.remove(&(holder.clone(), epoch)) => {}
                _ => {
                    let what =
                        format!("at height {height} {service} {name} for {holder}, epoch {epoch}: no such grant");
                    return Err(Violation::new(NAME, what));
                }
            }
        }
        Ok(())
    }

    /// The holder of a service, with the epoch.
    pub fn holders(&self, service: &str) -> Option<&BTreeSet<(String, u64)>> {
        self.holders.get(service)
    }
}

/// The events about grants.
fn grants(outcome: &Outcome) -> impl Iterator<Item = (&str, Granted)> {
    outcome.events.iter().filter_map(|emitted| {
        let event = &emitted.event;
        let about_grants = event.chaincode == "abac" && matches!(&*event.name, "granted" | "renewed" | "released");
        let grant = about_grants.then(|| serde_json::from_slice(&event.payload).unwrap())?;
        Some((&*event.name, grant))
    })
}
