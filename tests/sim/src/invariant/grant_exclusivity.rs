//! Grant exclusivity (design.md §7.4): at every height at most as many holders as the service's mode allows, and at most as many
//! readers as its owner says.
//!
//! Told by the events, which is how the robots' bridges know, and by the numbers that owners chose.

use super::{Check, Executed, Violation, is_of};
use crate::client::READERS;
use ledger::Outcome;
use ledger::transaction::Transaction;
use ledger_base::rejection::Code;
use serde::Deserialize;
use std::collections::{BTreeMap, BTreeSet};

const NAME: &str = "grant exclusivity";

/// The holders of services.
#[derive(Default)]
pub struct GrantExclusivity {
    holders: BTreeMap<String, BTreeSet<(String, u64)>>,
    /// How many hold a service, or read it, where its owner says so.
    places: BTreeMap<String, usize>,
}

/// The settings that are read of a service.
#[derive(Deserialize)]
struct Configured {
    sharing: Limits,
}

#[derive(Deserialize)]
struct Limits {
    publishers: Option<usize>,
    subscribers: Option<usize>,
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
        let mut next = 0;
        for (at, name, Granted { service, holder, epoch, mode }) in grants(executed.outcome) {
            // A change of settings comes before what it ends.
            while at.is_some_and(|at| next <= at as usize) {
                let succeeded = executed.outcome.results.get(next).is_some_and(|result| result.code() == Code::Ok);
                let transaction = executed.transactions.get(next).and_then(Option::as_ref);
                transaction.filter(|_| succeeded).into_iter().for_each(|transaction| self.configured(transaction));
                next += 1;
            }
            let holders = self.holders.entry(service.clone()).or_default();
            match name {
                "granted" => {
                    holders.insert((holder, epoch));
                    let most = match &*mode {
                        "exclusive" => 1,
                        "limited" => self.places.get(&service).copied().unwrap_or(usize::MAX),
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
        for (at, transaction) in executed.transactions.iter().enumerate().skip(next) {
            let succeeded = executed.outcome.results.get(at).is_some_and(|result| result.code() == Code::Ok);
            transaction.iter().filter(|_| succeeded).for_each(|transaction| self.configured(transaction));
        }
        Ok(())
    }

    fn configured(&mut self, transaction: &Transaction) {
        let body = transaction.body();
        match (&*body.chaincode, &*body.function, body.args.as_slice()) {
            ("abac", "replace", robots) => self.places.retain(|service, _| !is_of(service, robots)),
            ("abac", "configure", [service, settings]) => {
                let Configured { sharing } = serde_json::from_slice(settings).unwrap();
                let service = String::from_utf8_lossy(service).into_owned();
                let both = [(service.clone(), sharing.publishers), (service + READERS, sharing.subscribers)];
                for (id, most) in both {
                    self.places.remove(&id);
                    self.places.extend(most.map(|most| (id, most)));
                }
            }
            _ => {}
        }
    }

    /// The holder of a service, with the epoch.
    pub fn holders(&self, service: &str) -> Option<&BTreeSet<(String, u64)>> {
        self.holders.get(service)
    }
}

/// The events about grants.
fn grants(outcome: &Outcome) -> impl Iterator<Item = (Option<u32>, &str, Granted)> {
    outcome.events.iter().filter_map(|emitted| {
        let event = &emitted.event;
        let about_grants = event.chaincode == "abac" && matches!(&*event.name, "granted" | "renewed" | "released");
        let grant = about_grants.then(|| serde_json::from_slice(&event.payload).unwrap())?;
        Some((emitted.index, &*event.name, grant))
    })
}
