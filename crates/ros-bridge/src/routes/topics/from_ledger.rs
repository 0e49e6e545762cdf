//! A topic from the ledger: commands on the robot's side, or a feed on the user's.

use std::sync::Arc;

use futures::{FutureExt, future::BoxFuture};
use ledger_base::rejection::{Code, Rejection};
use ledger_gate::gate::Settings as GateSettings;

use crate::{
    graph::{endpoint::Role, names::Interface},
    routes::{
        delivery::{FromLedger, Outputs, POINT_KEYS, ROGUE_PUBLISHERS_KEY, STALE_KEY, Settings, command_timeout},
        ends::Outlet,
        kind::{Kind, NearbyEndpoint, Opening, Plan, RouteTask},
        pace::RATE_KEY,
        shown::{HOLDER_KEY, HolderTopic},
        silence::{Cause, Facts, Silence, fault, pause},
    },
};

/// Commands on the robot's side, or a feed on the user's: through the gate to the local graph.
pub(crate) static KIND: Kind = Kind {
    name: "from_ledger",
    carries: Interface::Message,
    right: "subscribe",
    other_end: Role::Subscriber,
    keys: &[
        "max_age_ms",
        STALE_KEY,
        "command_timeout_ms",
        ROGUE_PUBLISHERS_KEY,
        "stop",
        "stop_hex",
        POINT_KEYS[0],
        POINT_KEYS[1],
        HOLDER_KEY,
        RATE_KEY,
    ],
    read: |section, common| Arc::new(Settings::read(section, common)),
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
    let Opening { route, context, local, service, topic, mark, counters, qos, shutdown, .. } = &opening;
    if let Some(hz) = settings.max_rate_hz.filter(|_| service.is_command()) {
        return Err(Rejection::new(Code::BadConfiguration, "commands are not thinned out on their way to a robot")
            .found(format!("{RATE_KEY} = {hz} for the commands of {}", route.service))
            .wanted(format!("{RATE_KEY} for feeds, or on the side of the users who send the commands"))
            .next(format!("remove {RATE_KEY} here; a grant with limits bounds how often its holder may send")));
    }
    let gate = GateSettings {
        network: context.network,
        sample_bytes_max: route.sample_bytes_max,
        max_age: settings.max_age,
        stale_after: settings.stale_after,
        command_timeout: command_timeout(settings.command_timeout, &route.message),
    };
    let outputs = async {
        let mut qos = qos.clone();
        let first = *qos.borrow_and_update();
        let outlet = local.output(topic, &route.message, &first, *mark).await?;
        counters.opened(outlet.matched(), None);
        let points = settings.points.open(local, topic, *mark).await?;
        let taken = settings.points.names().chain([*topic]);
        let holder = HolderTopic::open(settings.holder.as_ref(), taken, local, *mark).await?;
        Ok(Outputs { outlet: Outlet::Topic(Box::new(outlet)), qos, points, holder })
    };
    let both = ((*route).clone(), settings.clone());
    let opened = FromLedger::open(&opening, both, gate, service.clone(), counters.clone(), outputs).await?;
    Ok(RouteTask { in_memory: opened.in_memory(), running: opened.run(shutdown.clone()).boxed() })
}

/// The words for a cause of silence.
fn silence(facts: &Facts<'_>, cause: Cause<'_>) -> Silence {
    let Facts { service, topic, .. } = facts;
    match cause {
        Cause::Alone => pause("no_subscriber", format!("nobody subscribes to {topic}")),
        Cause::Refused { line, .. } => fault("gate", format!("the gate lets nothing pass: {line}")),
        Cause::NotHeld => pause("no_holder", format!("nobody holds {service}")),
        Cause::NothingCame => pause("no_message", "nothing has come from the ledger yet".to_owned()),
    }
}

/// The warning about another that publishes.
fn nearby(NearbyEndpoint { service, topic, is_same_service, is_command }: &NearbyEndpoint<'_>) -> Option<String> {
    if *is_same_service {
        let what = "each message arrives twice; stop one of both";
        return Some(format!("another bridge delivers {service} on {topic} too: {what}"));
    }
    is_command.then(|| format!("a publisher beside this bridge on {topic}: its messages go around the ledger"))
}
