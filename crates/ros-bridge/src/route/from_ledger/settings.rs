//! The settings of a route from the ledger.

use std::{sync::Arc, time::Duration};

use futures::{FutureExt, future::BoxFuture};
use ledger_base::rejection::{Code, Rejection};
use ledger_base::settings::Section;
use ledger_gate::{gate::Settings as GateSettings, sample::Sample, service::Service};
use tokio::sync::watch;

use super::{
    super::{
        Stop,
        calls::{Hand, REPLY_BYTES},
        holder::{self, Holder},
        kind::{Given, Opened, Opening, Plan, Terms},
        pace::{RATE_KEY, read_rate},
        points::Topics,
        side_door::Treatment,
        stopping::command_timeout,
    },
    FromLedger,
};
use crate::{
    config::{HEARTBEAT_MS, RouteConfig, stop_sample},
    count::Counters,
    names::TopicName,
    typed,
};

/// Shortest `stale_after_ms`: one heartbeat may be late.
const STALE_MS_MIN: u64 = 2 * HEARTBEAT_MS as u64;
const STALE_MS_DEFAULT: u64 = 1_000;
/// How long the ledger may be silent by default.
pub(in crate::route) const STALE_AFTER: Duration = Duration::from_millis(STALE_MS_DEFAULT);
/// Longest `stale_after_ms`, `command_timeout_ms` and `max_age_ms`.
const WAIT_MS_MAX: u64 = 3_600_000;
/// The setting of how long the ledger may be silent.
pub(in crate::route) const STALE_KEY: &str = "stale_after_ms";

/// The settings of this kind.
#[derive(Debug, Clone)]
pub(super) struct Settings {
    /// Age beyond which a message is dropped; none = the service's. The shorter of both counts.
    pub(super) max_age: Option<Duration>,
    /// Silence of the ledger or of its voters after which the robot is stopped.
    pub(super) stale_after: Duration,
    /// Silence of a driver after which the robot is stopped; that of the type if it is not set, zero for never.
    pub(super) command_timeout: Option<Duration>,
    pub(super) side_door: Treatment,
    /// The stop message instead of the service's or the type's.
    pub(super) stop: Option<Sample>,
    /// Where the points of the running task go.
    pub(super) points: Topics,
    /// Where it is shown who holds the service.
    pub(super) holder: Option<TopicName>,
    /// Most samples of a feed a second; none = any number.
    pub(super) max_rate_hz: Option<u32>,
    /// Is a feed read only while somebody listens to it?
    pub(super) on_demand: bool,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            max_age: None,
            stale_after: STALE_AFTER,
            command_timeout: None,
            side_door: Treatment::Warn,
            stop: None,
            points: Topics::default(),
            holder: None,
            max_rate_hz: None,
            on_demand: false,
        }
    }
}

/// A discovered route has the defaults, and a feed its highest rate.
pub(super) fn discovered(terms: &Terms) -> Arc<dyn Plan> {
    let max_rate_hz = terms.max_rate_hz.filter(|_| !terms.is_command);
    Arc::new(Settings { on_demand: true, max_rate_hz, ..Settings::default() })
}

pub(super) fn read(section: &mut Section<'_, '_>, given: &Given<'_>) -> Arc<dyn Plan> {
    let (mut max_age_ms, mut timeout_ms) = (None, None);
    section.integer("max_age_ms", 1..=WAIT_MS_MAX, &mut max_age_ms);
    let stale_after = stale_after(section);
    section.integer("command_timeout_ms", 0..=WAIT_MS_MAX, &mut timeout_ms);
    let stop = read_stop(section, given);
    let (points, side_door) = (Topics::read(section), Treatment::read(section));
    let (holder, max_rate_hz) = (holder::read(section), read_rate(section));
    let max_age = max_age_ms.map(Duration::from_millis);
    let command_timeout = timeout_ms.map(Duration::from_millis);
    let on_demand = false;
    Arc::new(Settings {
        max_age,
        stale_after,
        command_timeout,
        side_door,
        stop,
        points,
        holder,
        max_rate_hz,
        on_demand,
    })
}

/// Reads the stop message: in the words of its type, or as CDR.
fn read_stop(section: &mut Section<'_, '_>, given: &Given<'_>) -> Option<Sample> {
    const WORDS: &str = "a message of the route's type, as JSON or YAML";
    let (mut words, mut cdr) = (None, None);
    section.parsed("stop", WORDS, &mut words, |text| match given.message {
        Some(message) => typed::written(message, text).map(Some),
        // The type is the fault.
        None => Ok(None),
    });
    section.parsed("stop_hex", "CDR in hexadecimal digits", &mut cdr, |text| {
        stop_sample(text, given.sample_bytes_max).map(Some)
    });
    if words.is_some() && cdr.is_some() {
        section.conflict(["stop", "stop_hex"], "both".to_owned(), "one of them".to_owned());
    }
    words.or(cdr)
}

impl Plan for Settings {
    fn open<'a>(&'a self, opening: Opening<'a>) -> BoxFuture<'a, Result<Opened, Rejection>> {
        self.join(opening).boxed()
    }
}

/// Opens the half of a route of calls that comes from the ledger: what passes the gate is handed over.
pub(in crate::route) async fn half(
    opening: &Opening<'_>,
    service: Service,
    hand: Hand,
    counters: Counters,
) -> Result<impl FnOnce(Stop) -> BoxFuture<'static, ()> + use<>, Rejection> {
    let Opening { route, gateway, context, local, mark, asker, .. } = opening;
    let usual = Settings::default();
    let settings = Settings { stale_after: hand.stale_after().unwrap_or(usual.stale_after), ..usual };
    let gate = GateSettings {
        network: context.network,
        sample_bytes_max: route.sample_bytes_max.saturating_add(REPLY_BYTES),
        max_age: settings.max_age,
        stale_after: settings.stale_after,
        command_timeout: None,
    };
    let route = RouteConfig { service: service.service.clone(), ..(*route).clone() };
    // Nobody follows anybody.
    let (_none, qos) = watch::channel(route.qos);
    let outlet = async {
        let outlet = local.outlet_for_calls(hand, *mark);
        let points = settings.points.open(local, opening.topic, *mark).await?;
        let holder = Holder::open(None, std::iter::empty(), local, *mark).await?;
        Ok(((outlet, qos), (points, holder), counters))
    };
    let both = (Arc::clone(gateway), Arc::clone(asker), *context);
    let opened = FromLedger::open(both, (route, settings.clone()), gate, service, outlet).await?;
    Ok(move |stop| opened.run(stop).boxed())
}

/// Reads `stale_after_ms`.
pub(in crate::route) fn stale_after(section: &mut Section<'_, '_>) -> Duration {
    let mut stale_after_ms = STALE_MS_DEFAULT;
    section.integer(STALE_KEY, STALE_MS_MIN..=WAIT_MS_MAX, &mut stale_after_ms);
    Duration::from_millis(stale_after_ms)
}

impl Settings {
    async fn join(&self, opening: Opening<'_>) -> Result<Opened, Rejection> {
        let Opening { route, gateway, context, local, service, topic, mark, asker, counters, mut qos, stop } = opening;
        if let Some(hz) = self.max_rate_hz.filter(|_| service.is_command()) {
            return Err(Rejection::new(Code::BadConfiguration, "commands are not thinned out on their way to a robot")
                .found(format!("{RATE_KEY} = {hz} for the commands of {}", route.service))
                .wanted(format!("{RATE_KEY} for feeds, or on the side of the users who send the commands"))
                .next(format!("remove {RATE_KEY} here; a grant with limits bounds how often its holder may send")));
        }
        let gate = GateSettings {
            network: context.network,
            sample_bytes_max: route.sample_bytes_max,
            max_age: self.max_age,
            stale_after: self.stale_after,
            command_timeout: command_timeout(self.command_timeout, &route.message),
        };
        let outlet = async {
            let first = *qos.borrow_and_update();
            let outlet = local.outlet(topic, &route.message, &first, mark).await?;
            counters.opened(outlet.matched(), None);
            let points = self.points.open(local, topic, mark).await?;
            let taken = self.points.names().chain([topic]);
            let holder = Holder::open(self.holder.as_ref(), taken, local, mark).await?;
            Ok(((outlet, qos), (points, holder), counters))
        };
        let opened =
            FromLedger::open((gateway, asker, context), (route.clone(), self.clone()), gate, service, outlet).await?;
        let in_memory = opened.outlet.in_memory();
        Ok(Opened { in_memory, running: opened.run(stop).boxed() })
    }
}
