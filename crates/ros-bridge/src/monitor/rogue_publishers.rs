//! Rogue publishers are reported to the ledger: so the owner's people see on any node, also later, that somebody published on
//! the robot's own topic.
//!
//! The ledger takes one report in a minute for each service. A rogue publisher that came in between is not
//! forgotten: its report comes when the minute is over, and that it has left after another one.

use std::{
    collections::BTreeMap,
    sync::Arc,
    time::{Duration, Instant},
};

use bytes::Bytes;
use futures::{FutureExt, StreamExt, future::BoxFuture, stream::FuturesUnordered};
use ledger_base::rejection::{Class, Code, Rejection};
use ledger_contract::ServiceState;
use ledger_gate::ABAC;

use crate::{
    ledger::gateway::{Gateway, ask},
    log::{LogLimiter, one_line},
    routes::table::OpenRoute,
};

/// Between two reports about one service: what the ledger asks for, and some more for clocks.
const PAUSE: Duration = Duration::from_secs(61);
/// Before a report is tried again that no node took.
const AGAIN: Duration = Duration::from_secs(5);
/// Before a report is tried again that the ledger refused.
const REFUSED_PAUSE: Duration = Duration::from_secs(600);
/// Discovery finds those who are there within this time. Then the ledger is asked for reports of an earlier run.
const DISCOVERED_WITHIN: Duration = Duration::from_secs(10);

/// The side services of all routes that deliver commands.
pub(crate) struct RoguePublisherReports {
    gateway: Arc<dyn Gateway>,
    /// By service.
    services: BTreeMap<String, Reports>,
    calls: FuturesUnordered<BoxFuture<'static, (String, Outcome)>>,
    log_limiter: LogLimiter,
}

/// The side door of one service: what to say of it, and when. Without IO.
#[derive(Debug)]
struct Reports {
    /// The number of publishers that the ledger knows; none = it was not asked yet.
    told: Option<usize>,
    /// Most publishers at once since the last report.
    seen: usize,
    /// Nobody is asked what the ledger knows before: discovery takes its time.
    discovered: Instant,
    /// Nothing is said before.
    next: Instant,
    /// The call that is on its way.
    asks: Option<Duty>,
}

/// The thing to do about the publishers beside one service.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Duty {
    /// Ask the ledger what it knows.
    Ask,
    /// Report so many publishers.
    Report(usize),
}

/// The end of a call.
#[derive(Debug)]
enum Outcome {
    /// The ledger knows so many publishers.
    Known(usize),
    /// It has taken a report of so many.
    Told(usize),
    Refused(Rejection),
}

impl Reports {
    fn new(now: Instant) -> Self {
        Self { told: None, seen: 0, discovered: now + DISCOVERED_WITHIN, next: now, asks: None }
    }

    /// So many publish beside the bridge now.
    fn look(&mut self, beside: usize, now: Instant) -> Option<Duty> {
        self.seen = self.seen.max(beside);
        if self.asks.is_some() || now < self.next {
            return None;
        }
        let duty = match self.told {
            None if self.seen > 0 => Duty::Report(self.seen),
            None if now < self.discovered => return None,
            None => Duty::Ask,
            // It was open for a while, and is closed again.
            Some(told) if beside == 0 && self.seen > told => Duty::Report(self.seen),
            Some(told) if beside != told => Duty::Report(beside),
            Some(_) => return None,
        };
        self.asks = Some(duty);
        self.seen = 0;
        Some(duty)
    }

    /// A call has ended.
    fn ended(&mut self, outcome: &Outcome, now: Instant) {
        let asked = self.asks.take();
        match outcome {
            Outcome::Known(publishers) => self.told = Some(*publishers),
            Outcome::Told(publishers) => (self.told, self.next) = (Some(*publishers), now + PAUSE),
            Outcome::Refused(refused) => {
                self.next = now + pause_after(refused);
                if let Some(Duty::Report(publishers)) = asked {
                    self.seen = self.seen.max(publishers);
                }
            }
        }
    }
}

fn pause_after(refused: &Rejection) -> Duration {
    match refused.code {
        // Somebody else has reported it, or this bridge before its restart.
        Code::LimitExceeded => PAUSE,
        code if code.class() == Class::Unreachable => AGAIN,
        _ => REFUSED_PAUSE,
    }
}

impl RoguePublisherReports {
    pub(crate) fn new(gateway: Arc<dyn Gateway>) -> Self {
        let (services, calls) = (BTreeMap::new(), FuturesUnordered::new());
        Self { gateway, services, calls, log_limiter: LogLimiter::default() }
    }

    /// Looks at a route.
    pub(crate) fn look(&mut self, open: &OpenRoute, now: Instant) {
        if !open.is_command() || open.slot.route.kind.takes_in() {
            return;
        }
        let (service, beside) = (&open.slot.route.service, open.slot.counters.lock().live.beside);
        let reports = self.services.entry(service.clone()).or_insert_with(|| Reports::new(now));
        let Some(duty) = reports.look(beside, now) else { return };
        let (gateway, service, topic) = (Arc::clone(&self.gateway), service.clone(), open.topic().as_str().to_owned());
        self.calls.push(
            async move {
                let outcome = match duty {
                    Duty::Ask => known(&*gateway, &service).await,
                    Duty::Report(publishers) => report(&*gateway, &service, topic, publishers).await,
                };
                (service, outcome.unwrap_or_else(Outcome::Refused))
            }
            .boxed(),
        );
    }

    /// Takes the end of a call; waits for ever if none is on its way.
    pub(crate) async fn step(&mut self) {
        if self.calls.is_empty() {
            return std::future::pending().await;
        }
        let Some((service, outcome)) = self.calls.next().await else { return };
        let now = Instant::now();
        match &outcome {
            Outcome::Told(publishers) => {
                tracing::info!(service, publishers, "the ledger was told that {publishers} publish beside this bridge");
            }
            Outcome::Refused(refused) if pause_after(refused) == REFUSED_PAUSE => {
                if self.log_limiter.admit(refused.code.name(), now).is_some() {
                    let (code, reason, next) = (refused.code.name(), one_line(refused), refused.advice());
                    tracing::warn!(
                        service,
                        code,
                        reason,
                        next,
                        "the ledger takes no report of a side door from this bridge"
                    );
                }
            }
            Outcome::Known(_) | Outcome::Refused(_) => {}
        }
        if let Some(reports) = self.services.get_mut(&service) {
            reports.ended(&outcome, now);
        }
    }
}

async fn known(gateway: &dyn Gateway, service: &str) -> Result<Outcome, Rejection> {
    let (state, _): (ServiceState, _) = ask(gateway, 0, ABAC, "service", &[service]).await?;
    let publishers = state.side_door.map_or(0, |known| usize::try_from(known.publishers).unwrap_or(usize::MAX));
    Ok(Outcome::Known(publishers))
}

async fn report(gateway: &dyn Gateway, service: &str, topic: String, publishers: usize) -> Result<Outcome, Rejection> {
    let args = [service.to_owned(), topic, publishers.to_string()].map(Bytes::from);
    gateway.invoke("report_side_door", args.into()).await?;
    Ok(Outcome::Told(publishers))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(code: Code) -> Outcome {
        Outcome::Refused(Rejection::new(code, "no"))
    }

    /// Reports of which the ledger knows so many publishers, and nothing was said lately.
    fn known(publishers: usize, now: Instant) -> Reports {
        Reports { told: Some(publishers), ..Reports::new(now) }
    }

    #[test]
    fn a_side_door_is_reported_at_once_when_it_changes_a_minute_later_and_when_it_is_closed() {
        let start = Instant::now();
        let mut reports = known(0, start);
        assert_eq!(reports.look(0, start), None);
        assert_eq!(reports.look(1, start), Some(Duty::Report(1)));
        assert_eq!(reports.look(2, start), None, "one call at a time");
        reports.ended(&Outcome::Told(1), start);
        assert_eq!(reports.look(2, start + Duration::from_secs(60)), None);
        assert_eq!(reports.look(2, start + PAUSE), Some(Duty::Report(2)));
        reports.ended(&Outcome::Told(2), start + PAUSE);
        assert_eq!(reports.look(2, start + 20 * PAUSE), None, "as the ledger knows it");
        assert_eq!(reports.look(0, start + 20 * PAUSE), Some(Duty::Report(0)));
    }

    #[test]
    fn who_was_there_for_less_than_a_minute_is_reported_too() {
        let start = Instant::now();
        let mut reports = known(1, start);
        assert_eq!(reports.look(0, start), Some(Duty::Report(0)));
        reports.ended(&Outcome::Told(0), start);
        let soon = start + Duration::from_secs(10);
        assert_eq!((reports.look(3, soon), reports.look(0, soon)), (None, None));
        assert_eq!(reports.look(0, start + PAUSE), Some(Duty::Report(3)));
        reports.ended(&Outcome::Told(3), start + PAUSE);
        assert_eq!(reports.look(0, start + 2 * PAUSE), Some(Duty::Report(0)));
    }

    #[test]
    fn a_bridge_that_comes_back_closes_the_door_that_it_has_reported_before() {
        let start = Instant::now();
        let (mut reports, later) = (Reports::new(start), start + DISCOVERED_WITHIN);
        assert_eq!(reports.look(0, start), None, "somebody may be there who is not discovered yet");
        assert_eq!(reports.look(0, later), Some(Duty::Ask));
        reports.ended(&Outcome::Known(2), later);
        assert_eq!(reports.look(0, later), Some(Duty::Report(0)));
        assert_eq!(Reports::new(start).look(1, start), Some(Duty::Report(1)));
    }

    #[test]
    fn a_report_that_was_not_taken_is_tried_again_after_a_time_that_fits_the_reason() {
        let start = Instant::now();
        for (code, pause) in [
            (Code::Unreachable, AGAIN),
            (Code::LimitExceeded, PAUSE),
            (Code::NotOwner, REFUSED_PAUSE),
            (Code::UnknownFunction, REFUSED_PAUSE),
        ] {
            let mut reports = known(0, start);
            assert_eq!(reports.look(1, start), Some(Duty::Report(1)));
            reports.ended(&refused(code), start);
            assert_eq!(reports.look(1, start + pause - Duration::from_millis(1)), None, "{code}");
            assert_eq!(reports.look(0, start + pause), Some(Duty::Report(1)), "{code}: also who has left meanwhile");
        }
    }
}
