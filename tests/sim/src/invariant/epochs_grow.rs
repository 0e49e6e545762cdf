//! Epochs grow (design.md §7.4): every grant of a service has a higher epoch than all before. No message of an older
//! epoch than the newest grant is accepted where a grant is needed.

use super::{Check, Executed, Violation};
use serde::Deserialize;
use std::collections::BTreeMap;

const NAME: &str = "epochs grow";

/// The newest epoch of each service, and whether one holder at a time has it.
#[derive(Default)]
pub struct EpochsGrow {
    newest: BTreeMap<String, (u64, bool)>,
}

#[derive(Deserialize)]
struct Epoch {
    epoch: u64,
    #[serde(default)]
    mode: String,
}

impl EpochsGrow {
    /// A block was executed for the first time.
    ///
    /// # Errors
    /// An epoch came twice, or an old one was used.
    pub fn executed(&mut self, executed: &Executed<'_>) -> Check {
        let height = executed.outcome.header.height;
        for emitted in &executed.outcome.events {
            let event = &emitted.event;
            if event.chaincode != "abac" || !matches!(&*event.name, "granted" | "message") {
                continue;
            }
            let Epoch { epoch, mode } = serde_json::from_slice(&event.payload).unwrap();
            let service = &event.subject;
            let (newest, exclusive) = self.newest.get(service).copied().unwrap_or_default();
            if event.name == "granted" {
                if epoch <= newest {
                    let what = format!("block {height} grants {service} with epoch {epoch}, after {newest}");
                    return Err(Violation::new(NAME, what));
                }
                self.newest.insert(service.clone(), (epoch, mode == "exclusive"));
            } else if exclusive && epoch > 0 && epoch < newest {
                let what = format!("block {height} has a message on {service} with epoch {epoch}, after {newest}");
                return Err(Violation::new(NAME, what));
            }
        }
        Ok(())
    }
}
