//! A stop lasts (docs/conflict.md, "Emergency stop"). From the block that stops a robot to the one that resumes it, nobody holds one
//! of its command services. Nobody is granted one or publishes on one. Every node knows that, also when it has just started.
//!
//! All services of the simulated robots are command services. A reader goes on.

use super::{Check, Executed, Violation};
use crate::client::READERS;
use serde::Deserialize;
use std::collections::{BTreeMap, BTreeSet};

const NAME: &str = "a stop lasts";

/// The robots that are stopped, and who holds what.
#[derive(Default)]
pub struct StopsLast {
    /// After each height at which they changed.
    stopped: BTreeMap<u64, BTreeSet<String>>,
    holders: BTreeMap<String, BTreeSet<(String, u64)>>,
}

#[derive(Deserialize)]
struct Granted {
    holder: String,
    epoch: u64,
}

impl StopsLast {
    /// A block was executed for the first time.
    ///
    /// # Errors
    /// Somebody holds, is granted or uses what is stopped.
    pub fn executed(&mut self, executed: &Executed<'_>) -> Check {
        let height = executed.outcome.header.height;
        let before = self.stopped_at(height);
        let mut stopped = before.clone();
        let events = executed.outcome.events.iter().map(|emitted| &emitted.event);
        for event in events.filter(|event| event.chaincode == "abac" && !event.subject.ends_with(READERS)) {
            let (service, robot) = (&event.subject, event.subject.split('/').next().unwrap_or_default());
            match &*event.name {
                "stopped" => drop(stopped.insert(robot.to_owned())),
                "resumed" => drop(stopped.remove(robot)),
                "granted" | "message" if stopped.contains(robot) => {
                    let what = format!("at height {height} {service} is {} although {robot} is stopped", event.name);
                    return Err(Violation::new(NAME, what));
                }
                "granted" | "released" => {
                    let Granted { holder, epoch } = serde_json::from_slice(&event.payload).unwrap();
                    let holders = self.holders.entry(service.clone()).or_default();
                    holders.remove(&(holder.clone(), epoch));
                    if event.name == "granted" {
                        holders.insert((holder, epoch));
                    }
                }
                _ => {}
            }
        }
        let is_stopped = |service: &str| service.split('/').next().is_some_and(|robot| stopped.contains(robot));
        let held = self.holders.iter().find(|(service, holders)| is_stopped(service) && !holders.is_empty());
        if let Some((service, holders)) = held {
            let what = format!("after height {height} {holders:?} hold {service}, which is stopped");
            return Err(Violation::new(NAME, what));
        }
        if stopped != before {
            self.stopped.insert(height, stopped);
        }
        Ok(())
    }

    /// A node has opened its state at a height, which says that these robots are stopped.
    ///
    /// # Errors
    /// Others are.
    pub fn opened(&self, node: u64, height: u64, found: &BTreeSet<String>) -> Check {
        let wanted = self.stopped_at(height);
        if *found == wanted {
            return Ok(());
        }
        let what = format!("node {node} starts at height {height} with {found:?} stopped, wanted {wanted:?}");
        Err(Violation::new(NAME, what))
    }

    fn stopped_at(&self, height: u64) -> BTreeSet<String> {
        self.stopped.range(..=height).next_back().map(|(_, robots)| robots.clone()).unwrap_or_default()
    }
}
