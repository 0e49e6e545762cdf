//! Stop messages. Each is said three times, unless somebody drives on meanwhile: a reader that does not insist on every message
//! may miss one. A bridge may come back to a robot that still follows what it heard last. So where the service was used before,
//! the bridge says the stop to everybody who listens, until somebody drives. It says it for some seconds to a new listener. In
//! DDS a writer knows of a reader before the reader knows of the writer: what comes meanwhile is lost.

use std::time::{Duration, Instant};

use ledger_contract::is_called;
use ledger_gate::{sample::Sample, service::Service};
use tokio::time::sleep_until;

use crate::{
    graph::{messages::stop::stop_message, names::TypeName},
    routes::ends::Outlet,
};

/// How often a stop message is said again.
const AGAIN: u32 = 2;
/// How often it is said again to a new listener: within three seconds.
const AGAIN_TO_NEW: u32 = 6;
/// Time until it is said again; doubles each time.
const AGAIN_AFTER: Duration = Duration::from_millis(50);

/// `command_timeout_ms` of types with a stop message of their own.
const COMMAND_TIMEOUT_DEFAULT: Duration = Duration::from_millis(500);

/// The silence of a driver after which the robot is stopped, with this setting. Types with a stop message of their own ask for
/// velocities, which robots follow until they hear something else.
pub(in crate::routes) fn command_timeout(setting: Option<Duration>, message: &TypeName) -> Option<Duration> {
    let unless = || stop_message(message).map(|_| COMMAND_TIMEOUT_DEFAULT);
    setting.or_else(unless).filter(|timeout| !timeout.is_zero())
}

/// The stop message of a route, and how often it is to be said again.
pub(super) struct StopMessages {
    message: Option<Sample>,
    again: u32,
    /// Time after `said` until it is said again.
    pause: Duration,
    said: Instant,
    /// How many heard it since the bridge came; none if the robot cannot be moving, or somebody drives.
    listeners: Option<usize>,
    /// Have the voters not said yet how the service stands?
    is_new: bool,
}

impl StopMessages {
    pub(super) fn new(message: Option<Sample>, service: &Service) -> Self {
        if message.is_none() && service.is_command() && !is_called(&service.type_name) {
            let Service { service, type_name: message, .. } = service;
            tracing::warn!(service, message, "no stop message is known for this type: set stop_hex");
        }
        let (pause, said) = (AGAIN_AFTER, Instant::now());
        let mut new = Self { message, again: 0, pause, said, listeners: None, is_new: true };
        new.may_move(service);
        new
    }

    /// Where somebody held the service, or nobody needs to, the robot may have been moving when the bridge came.
    fn may_move(&mut self, service: &Service) {
        if self.is_new && self.is_known() && (service.epoch > 0 || !service.needs_grant()) {
            self.listeners.get_or_insert(0);
        }
    }

    /// Is there a stop message?
    pub(super) fn is_known(&self) -> bool {
        self.message.is_some()
    }

    /// Takes how the service stands, and its stop message.
    pub(super) fn learn(&mut self, message: Option<Sample>, service: &Service) {
        self.message = message;
        self.may_move(service);
        self.is_new = false;
    }

    /// Somebody drives: no stop is said any more.
    pub(super) fn driven(&mut self) {
        (self.again, self.listeners, self.is_new) = (0, None, false);
    }

    /// Says the stop message, and again a little later.
    pub(super) fn say(&mut self, outlet: &Outlet, service: &str) {
        (self.again, self.pause) = (self.again.max(AGAIN), AGAIN_AFTER);
        self.write(outlet, service);
    }

    /// Waits until the stop message is to be said again, or to somebody new: see [`StopMessages::say_again`]. A listener in shared
    /// memory is noticed at the next sign of life of the ledger.
    pub(super) fn due(&mut self, outlet: &Outlet) -> impl Future<Output = ()> + use<> {
        let now = outlet.listeners();
        // One who leaves and comes again is somebody new.
        self.listeners = self.listeners.map(|known| known.min(now));
        let is_new = self.listeners.is_some_and(|known| known < now);
        let due = if is_new { Some(self.said) } else { (self.again > 0).then(|| self.said + self.pause) };
        let (matched, undriven) = (outlet.matched().clone(), self.listeners.is_some());
        let count = matched.now().matched;
        async move {
            match due {
                Some(due) => sleep_until(due.into()).await,
                None if undriven && matched.at_least(count + 1).await => {}
                None => std::future::pending().await,
            }
        }
    }

    /// Says the stop message again. True if it is for somebody new.
    pub(super) fn say_again(&mut self, outlet: &Outlet, service: &str) -> bool {
        let now = outlet.listeners();
        let is_new = self.listeners.is_some_and(|known| known < now);
        if is_new {
            (self.listeners, self.again, self.pause) = (Some(now), AGAIN_TO_NEW, AGAIN_AFTER);
        } else {
            (self.again, self.pause) = (self.again.saturating_sub(1), self.pause * 2);
        }
        self.write(outlet, service);
        is_new
    }

    /// Says what is still to be said: the bridge ends.
    pub(super) async fn finish(&mut self, outlet: &Outlet, service: &str) {
        self.pause = AGAIN_AFTER;
        for _ in 0..self.again.min(AGAIN) {
            sleep_until((self.said + self.pause).into()).await;
            self.say_again(outlet, service);
        }
    }

    fn write(&mut self, outlet: &Outlet, service: &str) {
        self.said = Instant::now();
        let Some(message) = &self.message else { return };
        if let Err(error) = outlet.write(message) {
            tracing::error!(service, %error, "THE STOP MESSAGE WAS NOT PUBLISHED");
        }
    }
}
