//! How far something is that lasts, for the one who waits in front of it: how much, how fast, and how long it will still take.

use crate::units::span;
use std::io::{self, IsTerminal, Write};
use std::time::{Duration, Instant};

/// On a terminal the line changes so often at most.
const CHANGE_EVERY: Duration = Duration::from_millis(250);
/// Where nobody sees the line change, it is written so often.
const LINE_EVERY: Duration = Duration::from_secs(10);
/// Before that nothing is told: most things are done by then.
const QUIET: Duration = Duration::from_secs(1);

/// Tells it: on a terminal a line that changes, elsewhere a line now and then, to programs nothing.
#[derive(Debug)]
pub struct Progress {
    place: Place,
    begun: Instant,
    /// Where it was when it was first asked, for the time that is left.
    first: Option<u64>,
    /// When it was told last, and the count of then, for the rate.
    told: (Instant, u64),
    /// Is there a line on the terminal?
    is_shown: bool,
}

#[derive(Debug, PartialEq)]
enum Place {
    Terminal,
    File,
    Nowhere,
}

/// How far it is.
#[derive(Clone, Copy, Debug, Default)]
pub struct Step {
    /// The count whose rate is told.
    pub count: u64,
    /// The position on the way.
    pub at: u64,
    /// The end of the way, if it is known.
    pub of: Option<u64>,
}

impl Progress {
    /// Begins now. People are told on standard error, programs are not.
    pub fn new(for_people: bool) -> Self {
        let place = match for_people {
            false => Place::Nowhere,
            true if io::stderr().is_terminal() => Place::Terminal,
            true => Place::File,
        };
        Self { place, begun: Instant::now(), first: None, told: (Instant::now(), 0), is_shown: false }
    }

    /// Tells how far it is, where that is due. `text` gets the rate, a second.
    pub fn tell(&mut self, step: Step, text: impl FnOnce(f64) -> String) {
        let first = *self.first.get_or_insert(step.at);
        let since = self.told.0.elapsed();
        let (start, end) = match self.place {
            _ if self.begun.elapsed() < QUIET => return,
            Place::Terminal if since >= CHANGE_EVERY => ("\r\x1b[K", ""),
            Place::File if since >= LINE_EVERY => ("", "\n"),
            _ => return,
        };
        let rate = step.count.saturating_sub(self.told.1) as f64 / since.as_secs_f64().max(f64::MIN_POSITIVE);
        self.told = (Instant::now(), step.count);
        let left = left(step, first, self.begun.elapsed()).map(|left| format!(", {left} left")).unwrap_or_default();
        // Where standard error is closed, nobody wants to know.
        let mut screen = io::stderr();
        self.is_shown = true;
        let _told = write!(screen, "{start}{}{left}{end}", text(rate)).and_then(|()| screen.flush());
    }

    /// Takes the line away, so that something else can be written.
    pub fn clear(&self) {
        if self.is_shown && self.place == Place::Terminal {
            let mut screen = io::stderr();
            let _cleared = write!(screen, "\r\x1b[K").and_then(|()| screen.flush());
        }
    }
}

/// How long it will still take, as fast as it went so far; none if it does not move or has no end.
fn left(step: Step, first: u64, elapsed: Duration) -> Option<String> {
    let (done, rest) = (step.at.checked_sub(first)?, step.of?.checked_sub(step.at)?);
    let seconds = rest as f64 * elapsed.as_secs_f64() / done as f64;
    (done > 0 && seconds.is_finite()).then(|| span((seconds.min(1e9) as u64).saturating_mul(1_000_000)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_left_takes_as_long_as_what_was() {
        let left = |at, of, first| left(Step { count: 0, at, of }, first, Duration::from_secs(10));
        assert_eq!(left(150, Some(200), 100).as_deref(), Some("10 s"));
        assert_eq!(left(110, Some(200), 100).as_deref(), Some("90 s"));
        assert_eq!(left(200, Some(200), 100).as_deref(), Some("0 µs"));
        assert_eq!([left(100, Some(200), 100), left(150, None, 100), left(250, Some(200), 100)], [None, None, None]);
    }

    #[test]
    fn programs_are_told_nothing_and_what_is_soon_done_neither() {
        for for_people in [false, true] {
            let mut progress = Progress::new(for_people);
            progress.tell(Step::default(), |_| unreachable_text());
        }
    }

    fn unreachable_text() -> String {
        std::process::abort()
    }
}
