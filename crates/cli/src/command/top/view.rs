//! The text on the screen.

use super::question::Question;
use super::rates::Rate;
use crate::command::network::status::Overview;
use crate::output::printable;
use crate::time;
use ledger_api::Context;
use ledger_base::rejection::Rejection;
use ledger_contract::{RobotAsset, ServiceState, Stopped};
use std::collections::BTreeMap;

/// Turns a line around, and back: the chosen one.
const CHOSEN: (&str, &str) = ("\x1b[7m", "\x1b[0m");
/// The keys.
const KEYS: &str = "up, down select   s stop the robot   u resume it   r release your grant   q quit";

/// The network as it is known, and the chosen service.
pub(super) struct View {
    network: String,
    robots: Vec<RobotAsset>,
    overview: Option<Overview>,
    /// The network's time of the last look, microseconds since the UNIX epoch.
    now: u64,
    chosen: usize,
    /// The outcome of the last key.
    pub(super) told: String,
    /// The question that is open.
    pub(super) question: Option<Question>,
    /// Why the last look failed.
    failed: Option<String>,
}

impl View {
    /// Nothing is known yet.
    pub(super) fn of(context: &Context) -> Self {
        Self {
            network: context.label.clone(),
            robots: Vec::new(),
            overview: None,
            now: 0,
            chosen: 0,
            told: String::new(),
            question: None,
            failed: None,
        }
    }

    /// Takes a look over; after one that failed the last one stays.
    pub(super) fn saw(&mut self, seen: Result<(Vec<RobotAsset>, Overview), Rejection>, now: u64) {
        self.now = now;
        match seen {
            Ok((robots, overview)) => {
                let chosen = self.service();
                (self.robots, self.overview, self.failed) = (robots, Some(overview), None);
                // The same service stays chosen, wherever it stands now.
                let at = self.services().position(|(_, service)| Some(&service.service) == chosen.as_ref());
                self.chosen = at.unwrap_or(self.chosen).min(self.services().count().saturating_sub(1));
            }
            Err(refused) => self.failed = Some(format!("{} [{}]", refused.message, refused.code)),
        }
    }

    /// Chooses the next service, or the one before.
    pub(super) fn choose(&mut self, by: isize) {
        let last = self.services().count().saturating_sub(1);
        self.chosen = self.chosen.saturating_add_signed(by).min(last);
        self.told.clear();
    }

    fn services(&self) -> impl Iterator<Item = (&RobotAsset, &ServiceState)> {
        self.robots.iter().flat_map(|robot| robot.services.iter().map(move |service| (robot, service)))
    }

    /// The chosen service.
    pub(super) fn service(&self) -> Option<String> {
        self.services().nth(self.chosen).map(|(_, service)| service.service.clone())
    }

    /// The robot of the chosen service.
    pub(super) fn robot(&self) -> Option<String> {
        self.services().nth(self.chosen).map(|(robot, _)| robot.name.clone())
    }

    /// Asks why the robot of the chosen service is resumed.
    pub(super) fn ask_to_resume(&mut self) {
        let robot = self.services().nth(self.chosen).map(|(robot, _)| robot);
        match robot {
            Some(robot) if robot.stopped.is_some() => self.question = Some(Question::about(robot.name.clone())),
            Some(robot) => self.told = format!("{} is not stopped", robot.name),
            None => self.told = "no service is selected".to_owned(),
        }
    }

    /// The lines of a screen with so many columns and rows.
    pub(super) fn lines(&self, rates: &BTreeMap<String, Rate>, (columns, rows): (usize, usize)) -> Vec<String> {
        let nodes = self.nodes(columns);
        let told = self.question.as_ref().map_or_else(|| self.told.clone(), Question::line);
        let foot = [String::new(), cut(&told, columns), cut(KEYS, columns)];
        let mut lines = vec![self.title(columns), String::new()];
        // The services have the room that is left, and the chosen one is always seen.
        let room = rows.saturating_sub(lines.len() + 1 + nodes.len() + foot.len()).max(1);
        let (head, services) = self.service_lines(rates, columns);
        let first = (self.chosen + 1).saturating_sub(room);
        lines.push(head);
        lines.extend(services.into_iter().skip(first).take(room));
        lines.extend(nodes);
        lines.extend(foot);
        lines.truncate(rows);
        lines
    }

    fn title(&self, columns: usize) -> String {
        let at = if self.now == 0 { String::new() } else { format!(", {}", time::moment(self.now)) };
        let voters = self.overview.as_ref().map(|overview| format!("; voters: {}", overview.quorum.text()));
        let failed = self.failed.as_ref().map(|reason| format!("; out of date: {reason}"));
        cut(&format!("{}{at}{}{}", self.network, failed.unwrap_or_default(), voters.unwrap_or_default()), columns)
    }

    fn service_lines(&self, rates: &BTreeMap<String, Rate>, columns: usize) -> (String, Vec<String>) {
        let mut table =
            vec![["SERVICE", "RULE", "HOLDER", "EPOCH", "EXPIRES", "WAITS", "RATE", "P50", "P99"].map(str::to_owned)];
        table.extend(self.services().map(|(robot, service)| self.row(robot, service, rates.get(&service.service))));
        let mut lines = laid_out(&table, columns);
        if let Some(line) = lines.get_mut(self.chosen + 1) {
            *line = format!("{}{line:<columns$}{}", CHOSEN.0, CHOSEN.1);
        }
        let head = lines.remove(0);
        (head, lines)
    }

    fn row(&self, robot: &RobotAsset, service: &ServiceState, rate: Option<&Rate>) -> [String; 9] {
        let span = |micros: Option<u64>| micros.map(time::span).unwrap_or_default();
        let expires = (service.expires > 0).then(|| time::relative(service.expires, self.now));
        let holder = match (&robot.stopped, service.holders.as_slice()) {
            (Some(Stopped { by, .. }), _) => format!("STOPPED by {by}"),
            (None, []) => "-".to_owned(),
            (None, holders) => holders.join(", "),
        };
        [
            service.service.clone(),
            service.mode.to_string(),
            holder,
            service.epoch.to_string(),
            expires.unwrap_or_default(),
            if service.waiting == 0 { String::new() } else { service.waiting.to_string() },
            rate.map(|rate| format!("{:.1}/s", rate.hertz)).unwrap_or_default(),
            span(rate.map(|rate| rate.p50_us)),
            span(rate.map(|rate| rate.p99_us)),
        ]
    }

    fn nodes(&self, columns: usize) -> Vec<String> {
        let Some(overview) = &self.overview else { return Vec::new() };
        let mut table = vec![["NODE", "STATE", "HEIGHT", "BEHIND", "DISK FREE", "CLOCK"].map(str::to_owned)];
        table.extend(overview.nodes.iter().map(|node| {
            let behind = node.height.map(|height| overview.height.saturating_sub(height).to_string());
            let clock = node.clock_offset_us.map(|off| format!("{:+.1} ms", off as f64 / 1000.0));
            [
                node.full_name(),
                node.state(),
                node.height.map(|height| height.to_string()).unwrap_or_default(),
                behind.unwrap_or_default(),
                node.disk.as_ref().map(crate::health::disk_free).unwrap_or_default(),
                clock.unwrap_or_default(),
            ]
        }));
        let attention = overview.attention.iter().map(|item| cut(&format!("attention: {}", item.text()), columns));
        std::iter::once(String::new()).chain(laid_out(&table, columns)).chain(attention).collect()
    }
}

/// Columns as wide as their widest cell, and lines that fit.
fn laid_out<const N: usize>(table: &[[String; N]], columns: usize) -> Vec<String> {
    let table: Vec<[String; N]> =
        table.iter().map(|row| row.clone().map(|cell| printable(&cell).into_owned())).collect();
    let width = |at: usize| table.iter().filter_map(|row| row.get(at)).map(|cell| cell.chars().count()).max();
    let widths: Vec<usize> = (0..N).map(|at| width(at).unwrap_or_default()).collect();
    let line = |row: &[String; N]| {
        let cells: Vec<String> = row.iter().zip(&widths).map(|(cell, width)| format!("{cell:<width$}")).collect();
        cut(cells.join("  ").trim_end(), columns)
    };
    table.iter().map(line).collect()
}

/// A line that a terminal only shows, and no more of it than fits.
fn cut(text: &str, columns: usize) -> String {
    printable(text).chars().take(columns).collect()
}

#[cfg(test)]
#[expect(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]
mod tests {
    use super::*;

    fn view(services: usize) -> View {
        let service = |n: usize| {
            format!(
                r#"{{"service":"T/c{n}","robot":"T","organisation":"Org2","topic":"/c{n}","type":"a/msg/B","mode":"exclusive",
                "direction":"command","max_age_ms":1,"lease_ms":1,"lease_ms_max":1,"stop_hex":null,"holder":"",
                "holders":["Org1/\u001b[2J"],"epoch":7,"expires":11000000,
                "capabilities":{{"fencing":"newest","publishing":"grant","sequence":"per_epoch"}}}}"#
            )
        };
        let services = (0..services).map(service).collect::<Vec<_>>().join(",");
        let robot = format!(
            r#"{{"Name":"T","SubTopic":"","PubTopic":"","owner":"","UnderOp":false,"organisation":"Org2",
            "attribute_required":"T","trusted":[],"services":[{services}]}}"#
        );
        View {
            network: "fleet".into(),
            robots: vec![serde_json::from_str(&robot).unwrap()],
            overview: None,
            now: 1_000_000,
            chosen: 0,
            told: String::new(),
            question: None,
            failed: None,
        }
    }

    #[test]
    fn a_screen_shows_who_holds_what_and_obeys_no_name() {
        let rate = Rate { hertz: 20.0, p50_us: 3_000, p99_us: 9_000 };
        let lines = view(1).lines(&[("T/c0".to_owned(), rate)].into(), (120, 24));
        assert!(lines[0].starts_with("fleet, 1970-01-01"), "{}", lines[0]);
        for part in ["T/c0", "Org1/\\u{1b}[2J", "in 10 s", "20.0/s", "3 ms", "9 ms"] {
            assert!(lines[3].contains(part), "{part:?} in {:?}", lines[3]);
        }
        assert!(!lines.concat().contains("\u{1b}[2J") && lines.last().is_some_and(|line| line.contains("q quit")));
    }

    #[test]
    fn everything_fits_into_the_screen_and_the_chosen_service_is_seen() {
        let mut view = view(50);
        view.choose(42);
        assert_eq!((view.service().as_deref(), view.robot().as_deref()), (Some("T/c42"), Some("T")));
        for size in [(80, 24), (20, 8), (5, 3), (1, 1)] {
            let lines = view.lines(&BTreeMap::new(), size);
            assert!(lines.len() <= size.1, "{size:?}");
            let wide = |line: &String| line.replace(CHOSEN.0, "").replace(CHOSEN.1, "").chars().count();
            assert!(lines.iter().map(wide).all(|wide| wide <= size.0), "{size:?} {lines:?}");
            let is_seen = lines.iter().any(|line| line.contains(CHOSEN.0));
            assert!(is_seen || size.1 < 4, "{size:?} {lines:?}");
        }
        view.choose(100);
        assert_eq!(view.service().as_deref(), Some("T/c49"));
        view.choose(-100);
        assert_eq!(view.service().as_deref(), Some("T/c0"));
    }

    #[test]
    fn only_a_stopped_robot_is_resumed_and_its_reason_is_asked_for() {
        let mut view = view(1);
        view.ask_to_resume();
        assert!(view.question.is_none() && view.told == "T is not stopped", "{}", view.told);
        view.robots[0].stopped = Some(Stopped { by: "Org2/Admin".into(), reason: String::new(), since: 1 });
        view.ask_to_resume();
        let lines = view.lines(&BTreeMap::new(), (120, 24)).concat();
        assert!(lines.contains("resume T: why? _") && lines.contains("Esc cancels"), "{lines}");
    }

    #[test]
    fn after_a_look_that_failed_the_last_one_stays_and_says_so() {
        let mut view = view(1);
        view.saw(Err(Rejection::new(ledger_base::rejection::Code::Unreachable, "no node answers")), 2_000_000);
        let lines = view.lines(&BTreeMap::new(), (120, 24));
        assert!(lines[0].contains("out of date: no node answers [LGR-4001]") && lines[3].contains("T/c0"), "{lines:?}");
    }
}
