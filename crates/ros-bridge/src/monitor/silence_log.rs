//! Tells why a route is silent: once, when that lasts; and when it carries messages again.

use std::time::{Duration, Instant};

use crate::routes::{silence::Silence, table::OpenRoute};

/// A reason must last so long to be told.
const SETTLE: Duration = Duration::from_secs(2);
/// Between two lines about a route.
const PAUSE: Duration = Duration::from_secs(5);

/// The last line about a route.
#[derive(Debug, Default)]
pub(crate) struct Teller {
    told: Option<&'static str>,
    /// The present reason, and since when.
    present: Option<(&'static str, Instant)>,
    last: Option<Instant>,
}

/// The line to write.
#[derive(Debug, PartialEq, Eq)]
enum Line<'a> {
    Silent(&'a Silence),
    Carries,
}

impl Teller {
    /// Looks at a route, and tells what is worth it.
    pub(crate) fn look(&mut self, open: &OpenRoute, silence: Option<&Silence>, passed: Option<Instant>, now: Instant) {
        let (service, direction) = (&open.slot.route.service, open.slot.route.kind.name);
        match self.line(silence, passed, now) {
            Some(Line::Silent(Silence { name, reason, is_fault: true })) => {
                tracing::warn!(service, direction, why = name, "the route is silent: {reason}");
            }
            Some(Line::Silent(Silence { name, reason, is_fault: false })) => {
                tracing::info!(service, direction, why = name, "the route is silent: {reason}");
            }
            Some(Line::Carries) => tracing::info!(service, direction, "the route carries messages"),
            None => {}
        }
    }

    fn line<'a>(&mut self, silence: Option<&'a Silence>, passed: Option<Instant>, now: Instant) -> Option<Line<'a>> {
        let Some(silence) = silence else {
            self.present = None;
            let told_at = self.last.filter(|_| self.told.is_some())?;
            let carries = passed.is_some_and(|passed| passed > told_at);
            if carries {
                (self.told, self.last) = (None, Some(now));
            }
            return carries.then_some(Line::Carries);
        };
        let since = match self.present {
            Some((name, since)) if name == silence.name => since,
            _ => now,
        };
        self.present = Some((silence.name, since));
        let is_settled = now.saturating_duration_since(since) >= SETTLE;
        let is_rested = self.last.is_none_or(|last| now.saturating_duration_since(last) >= PAUSE);
        if self.told == Some(silence.name) || !is_settled || !is_rested {
            return None;
        }
        (self.told, self.last) = (Some(silence.name), Some(now));
        Some(Line::Silent(silence))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn silent(name: &'static str) -> Silence {
        Silence { name, reason: String::new(), is_fault: false }
    }

    fn told(line: Option<Line<'_>>) -> &'static str {
        match line {
            Some(Line::Silent(silence)) => silence.name,
            Some(Line::Carries) => "carries",
            None => "",
        }
    }

    #[test]
    fn a_reason_that_lasts_is_told_once_and_its_end_too() {
        let (mut teller, start) = (Teller::default(), Instant::now());
        let at = |seconds| start + Duration::from_secs(seconds);
        assert_eq!(told(teller.line(Some(&silent("no_grant")), None, at(0))), "");
        assert_eq!(told(teller.line(Some(&silent("no_grant")), None, at(2))), "no_grant");
        for second in 3..100 {
            assert_eq!(told(teller.line(Some(&silent("no_grant")), None, at(second))), "");
        }
        assert_eq!(told(teller.line(None, Some(at(100)), at(100))), "carries");
        assert_eq!(told(teller.line(None, Some(at(101)), at(101))), "");
    }

    #[test]
    fn what_changes_every_moment_is_not_told_every_moment() {
        let (mut teller, start) = (Teller::default(), Instant::now());
        let lines = (0..600u64).filter(|number| {
            let name = if number % 6 < 3 { "no_grant" } else { "no_publisher" };
            teller.line(Some(&silent(name)), None, start + Duration::from_secs(*number)).is_some()
        });
        assert!(lines.count() <= 121, "at most one in five seconds");
    }
}
