//! The settings of a route from the ledger.

use std::time::Duration;

use ledger_base::settings::Section;
use ledger_gate::sample::Sample;

use super::{points::Topics, rogue_publishers::Treatment};
use crate::{
    graph::{
        messages::{builtin, stop::stop_sample},
        names::TopicName,
    },
    ledger::gateway::HEARTBEAT_MS,
    routes::{
        kind::{CommonSettings, DiscoveryTerms},
        pace::read_rate,
        shown::read_holder,
    },
};

/// Shortest `stale_after_ms`: one heartbeat may be late.
const STALE_MS_MIN: u64 = 2 * HEARTBEAT_MS as u64;
const STALE_MS_DEFAULT: u64 = 1_000;
/// How long the ledger may be silent by default.
pub(in crate::routes) const STALE_AFTER: Duration = Duration::from_millis(STALE_MS_DEFAULT);
/// Longest `stale_after_ms`, `command_timeout_ms` and `max_age_ms`.
const WAIT_MS_MAX: u64 = 3_600_000;
/// The setting of how long the ledger may be silent.
pub(in crate::routes) const STALE_KEY: &str = "stale_after_ms";

/// The settings of this kind.
#[derive(Debug, Clone)]
pub(in crate::routes) struct Settings {
    /// Age beyond which a message is dropped; none = the service's. The shorter of both counts.
    pub(in crate::routes) max_age: Option<Duration>,
    /// Silence of the ledger or of its voters after which the robot is stopped.
    pub(in crate::routes) stale_after: Duration,
    /// Silence of a driver after which the robot is stopped; that of the type if it is not set, zero for never.
    pub(in crate::routes) command_timeout: Option<Duration>,
    pub(in crate::routes) rogue_publishers: Treatment,
    /// The stop message instead of the service's or the type's.
    pub(in crate::routes) stop: Option<Sample>,
    /// Where the points of the running task go.
    pub(in crate::routes) points: Topics,
    /// Where it is shown who holds the service.
    pub(in crate::routes) holder: Option<TopicName>,
    /// Most samples of a feed a second; none = any number.
    pub(in crate::routes) max_rate_hz: Option<u32>,
    /// Is a feed read only while somebody listens to it?
    pub(in crate::routes) on_demand: bool,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            max_age: None,
            stale_after: STALE_AFTER,
            command_timeout: None,
            rogue_publishers: Treatment::Warn,
            stop: None,
            points: Topics::default(),
            holder: None,
            max_rate_hz: None,
            on_demand: false,
        }
    }
}

impl Settings {
    /// A discovered route has the defaults, and a feed its highest rate.
    pub(in crate::routes) fn discovered(terms: &DiscoveryTerms) -> Self {
        let max_rate_hz = terms.max_rate_hz.filter(|_| !terms.is_command);
        Self { on_demand: true, max_rate_hz, ..Self::default() }
    }

    /// Reads them.
    pub(in crate::routes) fn read(section: &mut Section<'_, '_>, common: &CommonSettings<'_>) -> Self {
        let (mut max_age_ms, mut timeout_ms) = (None, None);
        section.integer("max_age_ms", 1..=WAIT_MS_MAX, &mut max_age_ms);
        let stale_after = stale_after(section);
        section.integer("command_timeout_ms", 0..=WAIT_MS_MAX, &mut timeout_ms);
        let stop = read_stop(section, common);
        let (points, rogue_publishers) = (Topics::read(section), Treatment::read(section));
        let (holder, max_rate_hz) = (read_holder(section), read_rate(section));
        let max_age = max_age_ms.map(Duration::from_millis);
        let command_timeout = timeout_ms.map(Duration::from_millis);
        let on_demand = false;
        Self { max_age, stale_after, command_timeout, rogue_publishers, stop, points, holder, max_rate_hz, on_demand }
    }
}

/// Reads the stop message: in the words of its type, or as CDR.
fn read_stop(section: &mut Section<'_, '_>, common: &CommonSettings<'_>) -> Option<Sample> {
    const WORDS: &str = "a message of the route's type, as JSON or YAML";
    let (mut words, mut cdr) = (None, None);
    section.parsed("stop", WORDS, &mut words, |text| match common.message {
        Some(message) => builtin::written(message, text).map(Some),
        // The type is the fault.
        None => Ok(None),
    });
    section.parsed("stop_hex", "CDR in hexadecimal digits", &mut cdr, |text| {
        stop_sample(text, common.sample_bytes_max).map(Some)
    });
    if words.is_some() && cdr.is_some() {
        section.conflict(["stop", "stop_hex"], "both".to_owned(), "one of them".to_owned());
    }
    words.or(cdr)
}

/// Reads `stale_after_ms`.
pub(in crate::routes) fn stale_after(section: &mut Section<'_, '_>) -> Duration {
    let mut stale_after_ms = STALE_MS_DEFAULT;
    section.integer(STALE_KEY, STALE_MS_MIN..=WAIT_MS_MAX, &mut stale_after_ms);
    Duration::from_millis(stale_after_ms)
}
