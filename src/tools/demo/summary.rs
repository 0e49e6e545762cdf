//! The findings of the demo: a table for people, a line of JSON for programs, and whether all of it held.

use super::HZ;
use super::measure::{Percentiles, Phase};
use ledger_base::rejection::{Code, Rejection};
use serde::{Deserialize, Serialize, Serializer};
use std::collections::BTreeMap;
use std::fmt::Write;

/// Share of the published rate that must arrive: a busy machine may lose its beat, not its messages.
const ARRIVED_MIN: f64 = 0.9;

/// The result of the experiment.
#[derive(Clone, Debug, Default, Serialize)]
pub(super) struct Summary {
    /// Both publish, Salma holds the robot.
    pub controlled: Phase,
    /// Both publish, and both may.
    pub open: Phase,
    /// From a user's bridge taking a sample to its verdict.
    pub commit_ms: Percentiles,
    /// From the operator's publication to the robot's reception.
    pub ros_to_ros_ms: Percentiles,
    /// Refusals by code.
    #[serde(serialize_with = "by_code")]
    pub refusals: BTreeMap<Code, u64>,
    /// Blocks at the end.
    pub height: u64,
    /// Do both nodes have the same state?
    pub digest_equal: bool,
    /// Did the robot get a stop message when its holder let go?
    pub stopped: bool,
    /// Did the next holder's messages arrive?
    pub handed_over: bool,
    /// The last line of each bridge, for whoever looks for the cause of a failure.
    #[serde(skip)]
    pub counted: Vec<String>,
}

/// The summary that a bridge prints when it ends.
#[derive(Clone, Debug, Deserialize)]
pub struct BridgeReport {
    routes: Vec<RouteReport>,
}

#[derive(Clone, Debug, Deserialize)]
struct RouteReport {
    direction: String,
    refused: BTreeMap<String, u64>,
    committed: u64,
    commit_us: Micros,
}

#[derive(Clone, Copy, Debug, Deserialize)]
struct Micros {
    p50: u64,
    p95: u64,
    p99: u64,
    max: u64,
}

impl BridgeReport {
    /// Reads the last line that a bridge printed.
    pub fn read(printed: &str) -> Result<Self, Rejection> {
        let line = printed.lines().last().unwrap_or_default();
        serde_json::from_str(line).map_err(|error| {
            Rejection::new(Code::Internal, format!("a bridge's report cannot be read: {error}")).found(line.to_owned())
        })
    }
}

impl BridgeReport {
    /// The messages that the ledger refused, by code.
    pub fn refused(&self) -> BTreeMap<String, u64> {
        let mut refused = BTreeMap::new();
        for route in self.routes.iter().filter(|route| route.direction == "to_ledger") {
            for (code, count) in &route.refused {
                *refused.entry(code.clone()).or_default() += count;
            }
        }
        refused
    }
}

impl Summary {
    /// Counts a refusal that the demo itself was given.
    pub(super) fn refused(&mut self, rejection: &Rejection) {
        *self.refusals.entry(rejection.code).or_default() += 1;
    }

    /// Adds what a bridge saw. Commit latency is the one of the bridge that committed most: Salma's.
    pub(super) fn add(&mut self, report: BridgeReport) {
        let mut most = 0;
        for route in report.routes.into_iter().filter(|route| route.direction == "to_ledger") {
            for (code, count) in route.refused {
                let code = Code::ALL.iter().find(|known| known.name() == code).copied().unwrap_or(Code::Internal);
                *self.refusals.entry(code).or_default() += count;
            }
            if route.committed > most && self.commit_ms.max == 0.0 {
                most = route.committed;
                let ms = |micros: u64| micros as f64 / 1000.0;
                let Micros { p50, p95, p99, max } = route.commit_us;
                self.commit_ms = Percentiles { p50: ms(p50), p95: ms(p95), p99: ms(p99), max: ms(max) };
            }
        }
    }

    /// Everything that must have held, with what was found instead.
    fn faults(&self) -> Vec<String> {
        let enough = f64::from(HZ) * ARRIVED_MIN;
        let mut faults = Vec::new();
        let mut must = |held: bool, what: String| {
            if !held {
                faults.push(what);
            }
        };
        let Phase { salma_hz, intruder_messages, .. } = self.controlled;
        must(
            salma_hz >= enough,
            format!("controlled: {salma_hz:.1} Hz of Salma reached the robot, wanted at least {enough}"),
        );
        must(
            intruder_messages == 0,
            format!("controlled: {intruder_messages} messages of Farhad reached the robot, wanted none"),
        );
        for (who, hz) in [("Salma", self.open.salma_hz), ("Farhad", self.open.farhad_hz)] {
            must(hz >= enough, format!("open: {hz:.1} Hz of {who} reached the robot, wanted at least {enough}"));
        }
        must(self.stopped, "the robot got no stop message when Salma released it".into());
        must(self.handed_over, "no message of Farhad arrived after he acquired the robot".into());
        must(self.digest_equal, "the nodes do not have the same state".into());
        must(self.refusals.contains_key(&Code::NotHolder), "no message of the intruder was rejected".into());
        faults
    }

    /// Fails with everything that did not hold.
    pub(super) fn check(&self) -> Result<(), Rejection> {
        match self.faults() {
            faults if faults.is_empty() => Ok(()),
            faults => Err(Rejection::new(Code::Internal, "the experiment failed")
                .found(faults.join("; "))
                .next(format!("see the counters of the bridges: {}", self.counted.join(" ")))),
        }
    }

    /// The table for people.
    pub(super) fn table(&self) -> String {
        let mut text = String::from("\n                          Salma      Farhad     robot receives\n");
        for (name, phase) in [("exclusive (Salma holds)", self.controlled), ("open (both may)", self.open)] {
            let Phase { robot_hz, salma_hz, farhad_hz, .. } = phase;
            let _infallible =
                writeln!(text, "  {name:<24}{salma_hz:>5.1} Hz   {farhad_hz:>5.1} Hz   {robot_hz:>6.1} Hz");
        }
        text.push_str("\n  latency in ms             p50      p95      p99      max\n");
        for (name, latency) in [("commit", self.commit_ms), ("ROS to ROS", self.ros_to_ros_ms)] {
            let Percentiles { p50, p95, p99, max } = latency;
            let _infallible = writeln!(text, "  {name:<20}{p50:>9.2}{p95:>9.2}{p99:>9.2}{max:>9.2}");
        }
        text.push_str("\n  rejections\n");
        for (code, count) in &self.refusals {
            let _infallible = writeln!(text, "  {code} {:<17}{count:>8}", code.name());
        }
        let yes = |held: bool| if held { "yes" } else { "NO" };
        let _infallible = write!(
            text,
            "\n  blocks                  {:>8}\n  state equal on both nodes    {}\n  stop message on release      {}\n  Farhad drives after that     {}",
            self.height,
            yes(self.digest_equal),
            yes(self.stopped),
            yes(self.handed_over)
        );
        text
    }

    /// The line for programs.
    pub(super) fn json(&self) -> Result<String, Rejection> {
        #[derive(Serialize)]
        struct Line<'a> {
            ok: bool,
            version: &'static str,
            #[serde(flatten)]
            summary: &'a Summary,
        }
        serde_json::to_string(&Line { ok: self.faults().is_empty(), version: env!("CARGO_PKG_VERSION"), summary: self })
            .map_err(|error| Rejection::new(Code::Internal, error.to_string()))
    }
}

/// Codes as `LGR-3005`.
fn by_code<S: Serializer>(refusals: &BTreeMap<Code, u64>, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_map(refusals.iter().map(|(code, count)| (code.to_string(), count)))
}

/// The line for programs when the experiment could not be played to its end.
pub fn failure(rejection: &Rejection) -> String {
    let error = serde_json::json!({"code": rejection.code.to_string(), "message": rejection.message});
    serde_json::json!({"ok": false, "version": env!("CARGO_PKG_VERSION"), "error": error}).to_string()
}
