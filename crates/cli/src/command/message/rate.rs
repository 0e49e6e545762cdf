//! `hz`, `bw`: rate and bandwidth of the messages of a service, as `ros2 topic hz` and `ros2 topic bw` report them.

use super::echo::HEARTBEAT_MS;
use super::payloads;
use super::place::Place;
use crate::answer;
use crate::argument::number;
use crate::argument::span::Milliseconds;
use crate::failure::Failure;
use crate::global::Global;
use crate::output::{Facts, Output};
use crate::session::{ABAC, Session};
use crate::time::span;
use crate::words::Words;
use bytes::Bytes;
use ledger::transaction::Transaction;
use ledger_api::v1::Delivery;
use ledger_api::{EventStream, Subscription};
use ledger_base::rejection::Rejection;
use ledger_contract::{MessageEvent, ServiceState};
use serde::Serialize;
use std::collections::VecDeque;
use std::io::{self, Write};
use std::time::Duration;
use tokio::time::{Instant, MissedTickBehavior, interval_at};

/// Most messages of a window.
const WINDOW_MAX: u64 = 100_000;
/// The words of the command line where the chaincode has other names.
const HZ: Words = Words { arguments: &[], help: "ledgerctl hz" };
const BW: Words = Words { arguments: &[], help: "ledgerctl bw" };

/// Print the rate of the messages of a service, until Ctrl-C.
///
/// As `ros2 topic hz`: the rate, and the shortest, mean and longest interval between messages with the standard
/// deviation, over the last messages. The times are those of arrival here. `ledgerctl top` shows all services.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Example:
  ledgerctl hz Turtlebot4/cmd_vel
  ledgerctl hz Turtlebot4/cmd_vel --window 100 --count 1 -o json")]
pub(crate) struct Hz {
    #[command(flatten)]
    measured: Measured,
}

/// Print the bandwidth of the messages of a service, until Ctrl-C.
///
/// As `ros2 topic bw`: bytes per second, and the smallest, mean and largest message, over the last messages. Signatures
/// and certificates are not counted. Messages of a confidential service are counted in their encrypted size.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Example:
  ledgerctl bw Turtlebot4/cmd_vel
  ledgerctl bw Turtlebot4/cmd_vel --every 10s --count 1 -o json")]
pub(crate) struct Bw {
    #[command(flatten)]
    measured: Measured,
}

#[derive(Debug, clap::Args)]
struct Measured {
    /// The service; the robot alone if it offers exactly one
    #[arg(value_name = "ROBOT/TOPIC")]
    service: String,
    /// Compute the figures from the last N messages
    #[arg(long, value_name = "N", default_value_t = 10_000, value_parser = clap::value_parser!(u64).range(2..=WINDOW_MAX))]
    window: u64,
    /// Time between two reports
    #[arg(long, value_name = "TIME", default_value = "1s")]
    every: Milliseconds,
    /// End after N reports
    #[arg(long, value_name = "N", value_parser = number::count)]
    count: Option<u64>,
}

impl Hz {
    pub(crate) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        self.measured.run(global, output, (&HZ, arrivals), Window::rate).await
    }
}

impl Bw {
    pub(crate) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        self.measured.run(global, output, (&BW, sizes), Window::bandwidth).await
    }
}

/// The bytes of each message of a delivery, in order.
type Read = fn(&Delivery, &Session) -> Result<Vec<u64>, Rejection>;

impl Measured {
    async fn run<F: Facts>(
        self,
        global: &Global,
        output: &mut Output,
        (words, read): (&Words, Read),
        report: impl Fn(&Window) -> F,
    ) -> Result<(), Failure> {
        let session = Session::open(global).await?;
        let response = session.ask(ABAC, "service", vec![Bytes::from(self.service.clone())]).await;
        let service: ServiceState = answer::parse(&response.map_err(|refused| words.told(refused))?, "a service")?;
        let place = Place::take(&session, &service, output).await?;
        let done = tokio::select! {
            done = self.follow(&session, &service.service, output, read, report) => done,
            lost = place.keep() => Err(lost.into()),
            _ = tokio::signal::ctrl_c() => Ok(()),
        };
        place.give_back().await;
        done
    }

    async fn follow<F: Facts>(
        &self,
        session: &Session,
        service: &str,
        output: &mut Output,
        read: Read,
        report: impl Fn(&Window) -> F,
    ) -> Result<(), Failure> {
        let mut stream: EventStream = session.client.subscribe(Subscription {
            chaincode: ABAC.to_owned(),
            subjects: vec![service.to_owned()],
            names: vec!["message".to_owned()],
            heartbeat: HEARTBEAT_MS,
            ..Subscription::default()
        });
        stream.open().await?;
        output.note(&format!("waiting for messages of {service}"));
        let every = Duration::from_millis(self.every.0);
        let mut reports = interval_at(Instant::now() + every, every);
        reports.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let mut window = Window::new(service, usize::try_from(self.window).unwrap_or(usize::MAX));
        let mut left = self.count.unwrap_or(u64::MAX);
        loop {
            tokio::select! {
                delivery = stream.next() => {
                    let now = Instant::now();
                    read(&delivery?, session)?.into_iter().for_each(|bytes| window.add(now, bytes));
                }
                _ = reports.tick() => {
                    window.time = session.client.now();
                    output.show(&report(&window))?;
                    window.new = 0;
                    left -= 1;
                    if left == 0 {
                        return Ok(());
                    }
                }
            }
        }
    }
}

/// One entry for each message; its bytes are not looked at.
fn arrivals(delivery: &Delivery, _: &Session) -> Result<Vec<u64>, Rejection> {
    let mut messages = Vec::new();
    for event in &delivery.events {
        let details: MessageEvent = answer::parse(&event.payload, "an event of messages")?;
        let count = usize::try_from(details.count.min(WINDOW_MAX)).unwrap_or_default();
        messages.extend(std::iter::repeat_n(0, count));
    }
    Ok(messages)
}

/// The bytes of each message, by the transactions that published them.
fn sizes(delivery: &Delivery, session: &Session) -> Result<Vec<u64>, Rejection> {
    let mut sizes = Vec::new();
    for event in &delivery.events {
        let details: MessageEvent = answer::parse(&event.payload, "an event of messages")?;
        let transaction = Transaction::decode(event.transaction.clone())?;
        let network = &session.context().network;
        let payloads = payloads(transaction.body(), network, &event.subject, &details)?;
        sizes.extend(payloads.iter().map(|payload| payload.len() as u64));
    }
    Ok(sizes)
}

/// The last messages of a service: the arrival and the bytes of each.
struct Window {
    service: String,
    max: usize,
    messages: VecDeque<(Instant, u64)>,
    /// Messages since the last report.
    new: u64,
    /// The network's time of the report, microseconds.
    time: u64,
}

impl Window {
    fn new(service: &str, max: usize) -> Self {
        Self { service: service.to_owned(), max, messages: VecDeque::new(), new: 0, time: 0 }
    }

    fn add(&mut self, at: Instant, bytes: u64) {
        if self.messages.len() == self.max {
            self.messages.pop_front();
        }
        self.messages.push_back((at, bytes));
        self.new = self.new.saturating_add(1);
    }

    /// The time from the first message to the last one, in seconds; none if that is no time.
    fn seconds(&self) -> Option<f64> {
        let ((first, _), (last, _)) = (self.messages.front()?, self.messages.back()?);
        Some(last.duration_since(*first).as_secs_f64()).filter(|seconds| *seconds > 0.0)
    }

    fn rate(&self) -> Rate {
        let arrivals = self.messages.iter().map(|(at, _)| at);
        let intervals: Vec<f64> = arrivals
            .clone()
            .zip(arrivals.skip(1))
            .map(|(one, next)| next.duration_since(*one).as_secs_f64() * 1e6)
            .collect();
        let spread = Spread::of(&intervals);
        let intervals = self.seconds().zip(spread).map(|(seconds, spread)| Intervals {
            rate_hz: thousandths(intervals.len() as f64 / seconds),
            interval_min_us: spread.min as u64,
            interval_mean_us: spread.mean as u64,
            interval_max_us: spread.max as u64,
            interval_deviation_us: spread.deviation as u64,
        });
        Rate { head: self.head(), intervals }
    }

    fn bandwidth(&self) -> Bandwidth {
        let sizes: Vec<f64> = self.messages.iter().map(|(_, bytes)| *bytes as f64).collect();
        // The first message begins the time in which the others came.
        let total: f64 = sizes.iter().skip(1).sum();
        let sizes = self.seconds().zip(Spread::of(&sizes)).map(|(seconds, spread)| Sizes {
            bytes_per_s: thousandths(total / seconds),
            size_min_bytes: spread.min as u64,
            size_mean_bytes: spread.mean as u64,
            size_max_bytes: spread.max as u64,
        });
        Bandwidth { head: self.head(), sizes }
    }

    fn head(&self) -> Head {
        Head { service: self.service.clone(), time: self.time, new: self.new, messages: self.messages.len() }
    }
}

/// Rounded, because more digits say nothing.
fn thousandths(value: f64) -> f64 {
    (value * 1000.0).round() / 1000.0
}

/// How far values lie apart.
struct Spread {
    min: f64,
    mean: f64,
    max: f64,
    deviation: f64,
}

impl Spread {
    fn of(values: &[f64]) -> Option<Self> {
        let (min, max) = (values.iter().copied().reduce(f64::min)?, values.iter().copied().reduce(f64::max)?);
        let count = values.len() as f64;
        let mean = values.iter().sum::<f64>() / count;
        let variance = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / count;
        Some(Self { min, mean, max, deviation: variance.sqrt() })
    }
}

/// The messages of a report.
#[derive(Serialize)]
struct Head {
    service: String,
    time: u64,
    /// Since the last report.
    new: u64,
    /// Messages of the window.
    messages: usize,
}

impl Head {
    /// Says that there is nothing to report.
    fn without_figures(&self, out: &mut dyn Write) -> io::Result<()> {
        match self.messages {
            0 => writeln!(out, "no messages"),
            _ if self.new == 0 => writeln!(out, "no new messages"),
            _ => writeln!(out, "one message"),
        }
    }
}

#[derive(Serialize)]
struct Rate {
    #[serde(flatten)]
    head: Head,
    #[serde(flatten)]
    intervals: Option<Intervals>,
}

#[derive(Serialize)]
struct Intervals {
    rate_hz: f64,
    interval_min_us: u64,
    interval_mean_us: u64,
    interval_max_us: u64,
    interval_deviation_us: u64,
}

impl Facts for Rate {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let Some(figures) = self.intervals.as_ref().filter(|_| self.head.new > 0) else {
            return self.head.without_figures(out);
        };
        writeln!(
            out,
            "average rate {:.1} Hz; intervals from {} to {}, standard deviation {}; {} messages",
            figures.rate_hz,
            span(figures.interval_min_us),
            span(figures.interval_max_us),
            span(figures.interval_deviation_us),
            self.head.messages,
        )
    }
}

#[derive(Serialize)]
struct Bandwidth {
    #[serde(flatten)]
    head: Head,
    #[serde(flatten)]
    sizes: Option<Sizes>,
}

#[derive(Serialize)]
struct Sizes {
    bytes_per_s: f64,
    size_min_bytes: u64,
    size_mean_bytes: u64,
    size_max_bytes: u64,
}

impl Facts for Bandwidth {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let Some(figures) = self.sizes.as_ref().filter(|_| self.head.new > 0) else {
            return self.head.without_figures(out);
        };
        writeln!(
            out,
            "{:.0} bytes/s; messages from {} to {} bytes, mean {}; {} messages",
            figures.bytes_per_s,
            figures.size_min_bytes,
            figures.size_max_bytes,
            figures.size_mean_bytes,
            self.head.messages,
        )
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    fn window(max: usize, at_ms: &[u64], bytes: u64) -> Window {
        let (mut window, begin) = (Window::new("T/c", max), Instant::now());
        for ms in at_ms {
            window.add(begin + Duration::from_millis(*ms), bytes);
        }
        window
    }

    fn text(facts: &impl Facts) -> String {
        let mut out = Vec::new();
        facts.text(&mut out).unwrap();
        String::from_utf8(out).unwrap()
    }

    #[test]
    fn a_rate_is_that_of_the_intervals_between_messages() {
        let window = window(100, &[0, 40, 100, 150, 200], 0);
        let rate = window.rate();
        let figures = rate.intervals.as_ref().unwrap();
        assert!((figures.rate_hz - 20.0).abs() < 0.001, "{}", figures.rate_hz);
        let spread = (figures.interval_min_us, figures.interval_mean_us, figures.interval_max_us);
        assert_eq!(spread, (40_000, 50_000, 60_000));
        assert_eq!(figures.interval_deviation_us, 7_071);
        assert!(text(&rate).starts_with("average rate 20.0 Hz; intervals from 40 ms to 60 ms"), "{}", text(&rate));
    }

    #[test]
    fn a_bandwidth_counts_the_bytes_that_came_after_the_first_message() {
        let window = window(100, &[0, 500, 1000], 52);
        let bandwidth = window.bandwidth();
        assert!((bandwidth.sizes.as_ref().unwrap().bytes_per_s - 104.0).abs() < 0.001);
        assert_eq!(text(&bandwidth), "104 bytes/s; messages from 52 to 52 bytes, mean 52; 3 messages\n");
    }

    #[test]
    fn a_window_keeps_the_last_messages_alone() {
        let window = window(3, &[0, 1000, 2000, 2100, 2200], 1);
        assert_eq!((window.messages.len(), window.new), (3, 5));
        assert!((window.rate().intervals.unwrap().rate_hz - 10.0).abs() < 0.001);
    }

    #[test]
    fn silence_is_reported_without_figures() {
        let mut window = window(9, &[], 0);
        assert_eq!(text(&window.rate()), "no messages\n");
        window.add(Instant::now(), 1);
        assert_eq!(text(&window.bandwidth()), "one message\n");
        window.new = 0;
        assert_eq!(text(&window.rate()), "no new messages\n");
        assert!(!serde_json::to_string(&window.rate()).unwrap().contains("rate_hz"));
    }
}
