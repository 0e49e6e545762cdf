//! The holders of the service on a local topic, as JSON in a `std_msgs/msg/String`, for programs without a ledger client; and
//! their names, for the diagnostics.
//!
//! The topic shows what the voters have signed.

use std::collections::BTreeSet;

use ledger_api::v1::Delivery;
use ledger_base::rejection::{Code, Rejection};
use ledger_base::settings::Section;
use ledger_contract::Grant;
use ledger_gate::{
    service::{Released, read as read_event},
    standing::Standing,
};
use serde_json::{Value, json};

use super::latched::LatchedTopic;
use crate::graph::{local::LocalGraph, mark::Mark, names::TopicName};

/// The setting of the topic.
pub(crate) const KEY: &str = "holder_topic";
const TYPE: &str = "std_msgs/msg/String";

/// Reads the setting under [`KEY`].
pub(crate) fn read(section: &mut Section<'_, '_>) -> Option<TopicName> {
    let mut topic = None;
    section.parsed(KEY, "a ROS 2 topic name", &mut topic, |text| TopicName::parse(text).map(Some));
    topic
}

/// The topic, and what it shows.
pub(crate) struct HolderTopic {
    topic: Option<LatchedTopic>,
    shown: Option<Value>,
}

impl HolderTopic {
    /// Offers the topic. `taken` are the other topics of the route.
    pub(crate) async fn open<'a>(
        topic: Option<&TopicName>,
        taken: impl Iterator<Item = &'a TopicName>,
        local: &LocalGraph,
        mark: Mark,
    ) -> Result<Self, Rejection> {
        for other in taken {
            if Some(other) == topic {
                return Err(Rejection::new(Code::BadConfiguration, "two kinds of messages cannot share a topic")
                    .found(format!("{KEY} = \"{}\", which the route uses already", other.as_str()))
                    .wanted("a topic of its own for the holder")
                    .next(format!("{KEY} = \"{}/holder\"", other.as_str())));
            }
        }
        Ok(Self { topic: LatchedTopic::open(topic, TYPE, local, mark).await?, shown: None })
    }

    /// Shows who holds the service by an answer of the voters, if that is new.
    pub(crate) fn show(&mut self, service: &str, standing: &Standing) {
        let Some(topic) = &self.topic else { return };
        let now = state(service, &standing.grants, standing.stopped);
        if self.shown.as_ref() == Some(&now) {
            return;
        }
        match topic.write(&json!({ "data": now.to_string() })) {
            Ok(()) => self.shown = Some(now),
            // It is tried again with the next answer.
            Err(fault) => tracing::warn!(service, reason = fault, "the holder of the service was not published"),
        }
    }
}

/// The names of the holders of a service.
#[derive(Debug, Default)]
pub(crate) struct HolderNames(BTreeSet<String>);

impl HolderNames {
    /// Those of a service among these grants.
    pub(crate) fn of(service: &str, grants: &[Grant]) -> Self {
        Self(grants.iter().filter(|grant| grant.service == service).map(|grant| grant.holder.clone()).collect())
    }

    /// Takes note of grants of the service that have begun or ended, as a node tells of them. An identity has one at a time.
    pub(crate) fn hear(&mut self, delivery: &Delivery) {
        for event in &delivery.events {
            match event.name.as_str() {
                "granted" | "renewed" => {
                    self.0.extend(read_event::<Grant>(&event.payload).map(|grant| grant.holder));
                }
                "released" => {
                    if let Some(released) = read_event::<Released>(&event.payload) {
                        self.0.remove(&released.holder);
                    }
                }
                _ => {}
            }
        }
    }

    /// The names, with commas between; empty if there are none.
    pub(crate) fn names(&self) -> String {
        self.0.iter().map(String::as_str).collect::<Vec<_>>().join(", ")
    }
}

fn state(service: &str, grants: &[Grant], stopped: bool) -> Value {
    let held = grants.iter().filter(|grant| grant.service == service);
    let holders: Vec<Value> = held
        .map(|grant| json!({ "holder": grant.holder, "epoch": grant.epoch, "acquired_at": grant.acquired_at, "task": grant.task }))
        .collect();
    json!({ "service": service, "stopped": stopped, "holders": holders })
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytes::Bytes;
    use ledger_api::v1::EventRecord;
    use ledger_gate::fixture::grant;

    fn told(name: &str, payload: &Value) -> Delivery {
        let payload = Bytes::from(payload.to_string());
        let event = EventRecord { name: name.to_owned(), payload, ..EventRecord::default() };
        Delivery { events: vec![event], ..Delivery::default() }
    }

    #[test]
    fn the_names_of_the_holders_follow_the_grants_that_begin_and_end() {
        let (salma, farhad) = (grant("Org1/Salma", 3), grant("Org1/Farhad", 4));
        let other = Grant { service: "T/arm".to_owned(), ..grant("Org1/Lara", 9) };
        let mut holders = HolderNames::of(&salma.service, &[salma.clone(), other]);
        assert_eq!(holders.names(), "Org1/Salma");
        holders.hear(&told("granted", &json!(farhad)));
        holders.hear(&told("renewed", &json!(salma)));
        assert_eq!(holders.names(), "Org1/Farhad, Org1/Salma");
        for Grant { service, holder, epoch, .. } in [&salma, &farhad] {
            let released = json!({ "service": service, "holder": holder, "epoch": epoch, "reason": "released" });
            holders.hear(&told("released", &released));
        }
        assert_eq!(holders.names(), "");
    }

    #[test]
    fn the_holders_of_this_service_are_shown_and_whether_the_robot_is_stopped() {
        let other = Grant { service: "T/arm".to_owned(), ..grant("Org1/Farhad", 9) };
        let own = grant("Org1/Salma", 3);
        let shown = state(&own.service, &[own.clone(), other], true);
        let holder = json!({ "holder": "Org1/Salma", "epoch": 3, "acquired_at": own.acquired_at, "task": null });
        assert_eq!(shown, json!({ "service": own.service, "stopped": true, "holders": [holder] }));
    }

    #[test]
    fn a_renewal_shows_nothing_new() {
        let before = grant("Org1/Salma", 3);
        let renewed = Grant { expires: before.expires + 1, next_seq: 9, ..before.clone() };
        let shown = |grant| state("T/cmd_vel", &[grant], false);
        assert_eq!(shown(before), shown(renewed));
    }
}
