//! How far a recording is, for the one who waits in front of it.

use super::summary::{Counts, size};
use crate::output::Format;
use std::io::{self, IsTerminal, Write};
use std::time::{Duration, Instant};

/// Where nobody sees the line change, it is written so often.
const LINE_EVERY: Duration = Duration::from_secs(10);

/// Tells it: on a terminal a line that changes, elsewhere a line now and then, to programs nothing.
pub(super) struct Progress {
    place: Place,
    /// When it was told last, and how many messages there were.
    told: (Instant, u64),
}

enum Place {
    Terminal,
    File,
    Nowhere,
}

impl Progress {
    pub(super) fn new(format: Format) -> Self {
        let place = match format {
            Format::Json | Format::Csv => Place::Nowhere,
            Format::Table if io::stderr().is_terminal() => Place::Terminal,
            Format::Table => Place::File,
        };
        Self { place, told: (Instant::now(), 0) }
    }

    /// Tells how far it is, of so many blocks if that is known.
    pub(super) fn tell(&mut self, counts: &Counts, last: Option<u64>) {
        let (since, before) = (self.told.0.elapsed(), self.told.1);
        let (start, end) = match self.place {
            Place::Terminal if since > Duration::ZERO => ("\r\x1b[K", ""),
            Place::File if since >= LINE_EVERY => ("", "\n"),
            _ => return,
        };
        self.told = (Instant::now(), counts.messages);
        let text = line(counts, last, before, since);
        // Where standard error is closed, nobody wants to know.
        let mut screen = io::stderr();
        let _told = write!(screen, "{start}{text}{end}").and_then(|()| screen.flush());
    }

    /// Takes the line away, so that something else can be written.
    pub(super) fn clear(&self) {
        if matches!(self.place, Place::Terminal) {
            let mut screen = io::stderr();
            let _cleared = write!(screen, "\r\x1b[K").and_then(|()| screen.flush());
        }
    }
}

fn line(counts: &Counts, last: Option<u64>, before: u64, since: Duration) -> String {
    let Counts { messages, events, bytes, height, .. } = counts;
    let rate = messages.saturating_sub(before) as f64 / since.as_secs_f64().max(f64::MIN_POSITIVE);
    let of = last.map(|last| format!(" of {last}")).unwrap_or_default();
    format!("{messages} messages ({rate:.1}/s), {events} events, {}, block {height}{of}", size(*bytes))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_tells_rate_size_and_block() {
        let counts = Counts { messages: 150, events: 3, bytes: 1_250, height: 40, ..Counts::default() };
        let told = line(&counts, Some(80), 50, Duration::from_secs(2));
        assert_eq!(told, "150 messages (50.0/s), 3 events, 1.2 kB, block 40 of 80");
        assert!(line(&counts, None, 150, Duration::from_secs(1)).ends_with("(0.0/s), 3 events, 1.2 kB, block 40"));
    }
}
