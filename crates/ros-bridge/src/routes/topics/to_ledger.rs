//! A topic to the ledger: a user's commands, or a robot's feed.

use std::{sync::Arc, time::Duration};

use futures::{FutureExt, future::BoxFuture};
use ledger_base::rejection::Rejection;

use crate::{
    graph::{endpoint::Role, loop_filter::LoopFilter, messages::length::LengthCheck, names::Interface},
    routes::{
        ends::Inlet,
        kind::{Kind, NearbyEndpoint, Opening, Plan, RouteTask},
        pace::RATE_KEY,
        shown::{HOLDER_KEY, HolderDisplay, HolderTopic},
        silence::{self, Cause, Facts, Silence, fault, pause},
        submission::{BATCH_KEY, LATCH_KEYS, LEFT_OUT, Settings, TOO_OLD, ToLedger},
    },
};

/// A user's commands, or a robot's feed.
pub(crate) static KIND: Kind = Kind {
    name: "to_ledger",
    carries: Interface::Message,
    right: "publish",
    other_end: Role::Publisher,
    keys: &[BATCH_KEY, RATE_KEY, LATCH_KEYS[0], LATCH_KEYS[1], HOLDER_KEY],
    read: |section, _| Arc::new(Settings::read(section)),
    discovered: Some(|terms| Arc::new(Settings::discovered(terms))),
    silence,
    nearby,
};

impl Plan for Settings {
    fn open<'a>(&'a self, opening: Opening<'a>) -> BoxFuture<'a, Result<RouteTask, Rejection>> {
        open(self, opening).boxed()
    }
}

async fn open(settings: &Settings, opening: Opening<'_>) -> Result<RouteTask, Rejection> {
    let Opening { route, gateway, context, local, service, topic, mark, query, counters, qos, shutdown } = opening;
    let max_age = Duration::from_millis(service.max_age_ms);
    let filter = Arc::new(LoopFilter::new(mark, &route.service, max_age, Arc::clone(local.delivered())));
    let input = local.input(topic, &route.message, qos, route.limits(), Arc::clone(&filter)).await?;
    let in_memory = input.in_memory();
    counters.opened(input.matched(), Some(filter));
    counters.lock().live.needs_grant = service.needs_grant() && service.is_command();
    let (inlet, check) = (Inlet::Topic(Box::new(input)), LengthCheck::of(&route.message));
    let opened = ToLedger::open(gateway, &route.service, inlet, settings, counters).await?;
    let opened = opened.of_topic(context.network, &service, check, settings);
    let running = match &settings.holder {
        Some(shown) => {
            let holder = HolderTopic::open(Some(shown), [topic].into_iter(), local, mark).await?;
            let display = HolderDisplay::new(holder, opened.gateway(), (query, &service), opened.begins_at());
            display.beside(opened.run(shutdown)).boxed()
        }
        None => opened.run(shutdown).boxed(),
    };
    Ok(RouteTask { in_memory, running })
}

/// The words for a cause of silence.
fn silence(facts: &Facts<'_>, cause: Cause<'_>) -> Silence {
    // It was dropped here: the ledger has not seen it.
    if let Cause::Refused { name: TOO_OLD | LEFT_OUT, line, .. } = cause {
        return fault("refused", line.to_owned());
    }
    let topic = facts.topic;
    let alone = if facts.other_end.bridges > 0 {
        let reason = format!("only a bridge publishes on {topic}, and what came from the ledger is not taken in");
        fault("only_bridges", reason)
    } else {
        pause("no_publisher", format!("nobody publishes on {topic}"))
    };
    let nothing = format!("the publisher on {topic} has sent nothing yet");
    silence::of_sending(facts, cause, (alone, "the ledger refuses", nothing))
}

/// The warning about another that takes samples in.
fn nearby(NearbyEndpoint { service, topic, is_same_service, .. }: &NearbyEndpoint<'_>) -> Option<String> {
    let warning =
        || format!("another bridge takes {topic} to {service} too: each sample is submitted twice; stop one of both");
    is_same_service.then(warning)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::routes::{counters::Live, silence::OtherEnd};

    #[test]
    fn what_was_dropped_here_is_not_said_to_be_refused_by_the_ledger() {
        let (live, other_end) = (Live::default(), OtherEnd::default());
        let facts = Facts { service: "T/cmd_vel", topic: "/cmd_vel", other_end, live: &live };
        let told = |name| silence(&facts, Cause::Refused { name, line: "why", is_held: true }).reason;
        assert_eq!([TOO_OLD, LEFT_OUT, "OVERLOADED"].map(told), ["why", "why", "the ledger refuses: why"]);
    }
}
