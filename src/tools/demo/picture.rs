//! The demo at this moment, drawn on the terminal: publishers, and the messages that the robot hears, as bars of
//! messages a second.

use super::HZ;
use super::graph::Robot;
use super::user::User;
use crate::process::terminal::eprint_line;
use std::collections::VecDeque;
use std::io::IsTerminal;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

/// How often it is drawn anew.
pub(super) const EVERY: Duration = Duration::from_millis(200);
/// Rates are those of the last second.
const WINDOW: Duration = Duration::from_secs(1);
/// Length of a bar at the rate of the experiment, in characters.
const BAR: usize = 24;
/// Moves the cursor up over the picture and clears what is below.
const UP: &str = "\x1b[4A\x1b[J";

/// The same for a single line.
pub const LINE_UP: &str = "\x1b[1A\x1b[J";

/// Is there somebody who sees colours and a moving cursor?
pub fn is_seen() -> bool {
    std::io::stderr().is_terminal() && std::env::var_os("TERM").is_none_or(|term| term != "dumb")
}

/// Are colours wanted? See no-color.org.
pub fn is_coloured() -> bool {
    is_seen() && std::env::var_os("NO_COLOR").is_none_or(|value| value.is_empty())
}

/// How many messages there were in all.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Counts {
    /// Published by Salma and by Farhad.
    published: [usize; 2],
    /// Received by the robot from Salma and from Farhad.
    received: [usize; 2],
}

/// Draws a phase while it runs.
pub(super) struct Picture<'a> {
    robot: &'a Robot,
    /// How much each operator has published.
    published: [Arc<AtomicUsize>; 2],
    /// Counts of the last second and a little more.
    past: VecDeque<(Instant, Counts)>,
    is_drawn: bool,
}

impl<'a> Picture<'a> {
    /// Of what these operators publish and the robot receives from now on.
    pub(super) fn new(robot: &'a Robot, published: [Arc<AtomicUsize>; 2]) -> Self {
        let mut picture = Self { robot, published, past: VecDeque::new(), is_drawn: false };
        let now = picture.counts();
        picture.past.push_back((Instant::now(), now));
        picture
    }

    fn counts(&self) -> Counts {
        Counts {
            published: self.published.each_ref().map(|count| count.load(Ordering::Relaxed)),
            received: [User::Salma, User::Farhad].map(|operator| self.robot.received_from(operator)),
        }
    }

    /// Draws the rates of the last second over those that were drawn before; nothing where nobody sees it.
    pub(super) fn draw(&mut self) {
        let (now, counts) = (Instant::now(), self.counts());
        self.past.push_back((now, counts));
        while self.past.get(1).is_some_and(|(at, _)| now.duration_since(*at) >= WINDOW) {
            self.past.pop_front();
        }
        let Some((since, before)) = self.past.front().copied().filter(|_| is_seen()) else { return };
        let frame = frame(before, counts, now.duration_since(since));
        eprint_line(&format!("{}{frame}", if self.is_drawn { UP } else { "" }));
        self.is_drawn = true;
    }
}

/// Four lines: what happened between two counts. A rate is one of [`EVERY`] at least: a message in the first millisecond is
/// not a thousand a second.
fn frame(before: Counts, now: Counts, between: Duration) -> String {
    let seconds = between.max(EVERY).as_secs_f64();
    let rate = |before: usize, now: usize| now.saturating_sub(before) as f64 / seconds;
    let line = |name: &str, before: usize, now: usize| {
        let hz = rate(before, now);
        let bar = (hz / f64::from(HZ) * BAR as f64).round().clamp(0.0, BAR as f64 * 1.25) as usize;
        format!("         {name:<27}{:<30} {hz:>3.0} Hz", "█".repeat(bar))
    };
    let ([salma, farhad], [salma_before, farhad_before]) = (now.published, before.published);
    let ([from_salma, from_farhad], [from_salma_before, from_farhad_before]) = (now.received, before.received);
    [
        line("Salma publishes", salma_before, salma),
        line("Farhad publishes", farhad_before, farhad),
        line("the robot receives Salma", from_salma_before, from_salma),
        line("the robot receives Farhad", from_farhad_before, from_farhad),
    ]
    .join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bars_are_as_long_as_the_rates_of_the_time_between() {
        let before = Counts { published: [100, 100], received: [90, 0] };
        let now = Counts { published: [150, 125], received: [140, 0] };
        let drawn = frame(before, now, Duration::from_secs(1));
        let bars: Vec<_> = drawn.lines().map(|line| line.matches('█').count()).collect();
        assert_eq!(bars, [BAR, BAR / 2, BAR, 0]);
        let rates: Vec<_> = drawn.lines().filter_map(|line| line.split_whitespace().nth_back(1)).collect();
        assert_eq!(rates, ["50", "25", "50", "0"]);
        assert!(drawn.lines().all(|line| line.chars().count() <= 78), "{drawn}");
        assert_eq!(drawn.lines().count(), 4, "as many lines as the cursor goes up");
    }

    #[test]
    fn the_readme_shows_the_picture_of_the_exclusive_phase() {
        let readme = include_str!("../../../README.md");
        let now = Counts { published: [50, 50], received: [50, 0] };
        for line in frame(Counts::default(), now, Duration::from_secs(1)).lines() {
            assert!(readme.lines().any(|shown| shown == line), "README.md lacks {line:?}");
        }
    }

    #[test]
    fn the_first_message_of_a_phase_is_no_rate_of_hundreds() {
        let now = Counts { published: [1, 1], received: [1, 0] };
        let drawn = frame(Counts::default(), now, Duration::from_micros(1_200));
        let rates: Vec<_> = drawn.lines().filter_map(|line| line.split_whitespace().nth_back(1)).collect();
        assert_eq!(rates, ["5", "5", "5", "0"]);
    }

    #[test]
    fn a_burst_does_not_leave_the_line() {
        let now = Counts { published: [100_000, 0], received: [100_000, 0] };
        let drawn = frame(Counts::default(), now, Duration::from_millis(1));
        assert!(drawn.lines().all(|line| line.matches('█').count() <= 30), "{drawn}");
    }
}
