//! How often messages come, and how old they are.

use crate::answer;
use crate::command::message::COMMAND_TTL;
use ledger::transaction::Transaction;
use ledger_api::v1::Delivery;
use ledger_contract::MessageEvent;
use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;
use tokio::time::Instant;

/// Rates are those of so long.
const WINDOW: Duration = Duration::from_secs(10);
/// Most events of a service that are kept: a thousand a second.
const EVENTS_MAX: usize = 10_000;

/// The events of the last seconds, by service.
#[derive(Default)]
pub(super) struct Rates(BTreeMap<String, VecDeque<Event>>);

struct Event {
    at: Instant,
    messages: u64,
    age_us: u64,
}

/// The rate of a service, messages a second, and the ages of half and of 99 in 100 of its messages, microseconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Rate {
    pub(super) hertz: f64,
    pub(super) p50_us: u64,
    pub(super) p99_us: u64,
}

impl Rates {
    /// Counts the messages of a delivery; `now` is the network's time.
    pub(super) fn count(&mut self, delivery: &Delivery, now: u64) {
        let ttl = u64::try_from(COMMAND_TTL.as_micros()).unwrap_or(u64::MAX);
        for event in &delivery.events {
            let Ok(details) = answer::parse::<MessageEvent>(&event.payload, "an event of messages") else { continue };
            let Ok(transaction) = Transaction::decode(event.transaction.clone()) else { continue };
            // One that is signed for longer is as old as its block.
            let signed = transaction.body().not_after.saturating_sub(ttl).min(delivery.time);
            self.add(&event.subject, Instant::now(), (details.count, now.saturating_sub(signed)));
        }
    }

    fn add(&mut self, service: &str, at: Instant, (messages, age_us): (u64, u64)) {
        let events = self.0.entry(service.to_owned()).or_default();
        events.push_back(Event { at, messages, age_us });
        if events.len() > EVENTS_MAX {
            events.pop_front();
        }
    }

    /// The rates of the last seconds; services without a message have none.
    pub(super) fn now(&mut self, now: Instant) -> BTreeMap<String, Rate> {
        for events in self.0.values_mut() {
            while events.front().is_some_and(|event| now.duration_since(event.at) > WINDOW) {
                events.pop_front();
            }
        }
        self.0.retain(|_, events| !events.is_empty());
        self.0.iter().filter_map(|(service, events)| Some((service.clone(), rate(events, now)?))).collect()
    }
}

fn rate(events: &VecDeque<Event>, now: Instant) -> Option<Rate> {
    let mut ages: Vec<u64> = events.iter().map(|event| event.age_us).collect();
    ages.sort_unstable();
    let part = |percent: usize| ages.get((ages.len() * percent / 100).min(ages.len().saturating_sub(1))).copied();
    let messages: u64 = events.iter().map(|event| event.messages).sum();
    // Where more came than are kept, the window is shorter.
    let window = if events.len() == EVENTS_MAX { now.duration_since(events.front()?.at) } else { WINDOW };
    let hertz = messages as f64 / window.as_secs_f64().max(1e-3);
    Some(Rate { hertz, p50_us: part(50)?, p99_us: part(99)? })
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn rates_are_those_of_the_last_ten_seconds() {
        let (mut rates, begin) = (Rates::default(), Instant::now());
        for n in 0..100 {
            rates.add("T/c", begin + Duration::from_millis(100) * n, (2, u64::from(n)));
        }
        let rate = *rates.now(begin + WINDOW).get("T/c").unwrap();
        assert_eq!(rate, Rate { hertz: 20.0, p50_us: 50, p99_us: 99 });
        assert!(rates.now(begin + 3 * WINDOW).is_empty());
    }

    #[test]
    fn a_flood_is_counted_in_bounded_memory() {
        let (mut rates, begin) = (Rates::default(), Instant::now());
        for n in 0..3 * EVENTS_MAX as u32 {
            rates.add("T/c", begin + Duration::from_micros(100) * n, (1, 1));
        }
        assert_eq!(rates.0.get("T/c").map(VecDeque::len), Some(EVENTS_MAX));
        let hertz = rates.now(begin + Duration::from_secs(3)).get("T/c").unwrap().hertz;
        assert!((9_900.0..10_100.0).contains(&hertz), "{hertz}");
    }
}
