//! `task submit`: a user asks a robot to traverse points.

use super::WORDS;
use super::show::{headline, when};
use crate::answer;
use crate::argument::points::Points;
use crate::argument::when::When;
use crate::command::grant::turn;
use crate::failure::Failure;
use crate::output::{Facts, Output, Table};
use crate::session::{self, ABAC, Session};
use bytes::Bytes;
use ledger_api::Committed;
use ledger_contract::{FRAME_DEFAULT, Submitted, TaskSpec};
use serde::Serialize;
use std::io::{self, Write};

/// Let a robot traverse points, at once or when it is the task's turn in the queue.
///
/// You hold the robot's command service while the task runs. If others hold it, the task waits in the queue, provided
/// that the service has one.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Example:
  ledgerctl task submit Turtlebot4 --points '1,0;1,-2.5,1.570796'
  ledgerctl task submit Turtlebot4 --points '0,0' --not-before 10m --deadline 2027-05-01T14:30:00+02:00 --requeue")]
pub(crate) struct Submit {
    /// The robot; with --service unless it offers exactly one command service
    #[arg(value_name = "ROBOT[/TOPIC]")]
    robot: String,
    /// The points in order, in metres and radians, with at most 6 decimals
    #[arg(long, value_name = "X,Y[,YAW];…", allow_hyphen_values = true)]
    points: Points,
    /// Coordinate frame of the points
    #[arg(long, default_value = FRAME_DEFAULT)]
    frame: String,
    /// A lower priority than your own
    #[arg(long, value_name = "N", allow_hyphen_values = true)]
    priority: Option<i64>,
    /// Join the queue only then: a span from now such as 10m, or a time such as 2027-05-01T14:30:00Z
    #[arg(long, value_name = "TIME")]
    not_before: Option<When>,
    /// Expire then unless the task has ended: a span from now, or a time
    #[arg(long, value_name = "TIME")]
    deadline: Option<When>,
    /// The command service, such as cmd_vel
    #[arg(long, value_name = "TOPIC")]
    service: Option<String>,
    /// Join the queue again after a preemption
    #[arg(long)]
    requeue: bool,
}

/// The task, and the transaction that submitted it.
#[derive(Serialize)]
struct Done {
    #[serde(flatten)]
    submitted: Submitted,
    /// Block time of the transaction, microseconds.
    time: u64,
    height: u64,
    transaction: ledger_base::hash::Hash,
}

impl Facts for Done {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let Self { submitted: Submitted { task, grant, queued }, time, .. } = self;
        writeln!(out, "{}", headline(task))?;
        let mut table = Table::pairs();
        table.pair("points", task.total);
        table.pair("priority", task.priority);
        if let Some(place) = queued {
            table.pair("position", place.position);
            table.pair("turn", turn(place, *time));
        }
        if let Some(grant) = grant {
            table.pair("epoch", grant.epoch);
            table.pair("expires", when(grant.expires, *time));
        }
        for (name, moment) in [("not before", task.not_before), ("deadline", task.deadline)] {
            table.pair(name, moment.map_or_else(String::new, |moment| when(moment, *time)));
        }
        table.write(out, 2)?;
        writeln!(out, "to see it: ledgerctl task show {0}; to end it: ledgerctl task cancel {0}", task.id)
    }
}

impl Submit {
    pub(super) async fn run(self, session: &Session, output: &mut Output) -> Result<(), Failure> {
        let (service, spec) = self.into_spec(session.client.now());
        let args = vec![Bytes::from(service), session::argument(&spec)?];
        let done = session.call(ABAC, "submit", args).await.map_err(|refused| WORDS.told(refused))?;
        let Committed { id: transaction, height, time, response, .. } = done;
        output.show(&Done { submitted: answer::parse(&response, "a task")?, time, height, transaction })
    }

    /// The service, and the task as the chaincode reads it.
    fn into_spec(self, now: u64) -> (String, TaskSpec) {
        let Self { robot, points: Points(points), frame, priority, not_before, deadline, service, requeue } = self;
        let service = match service {
            Some(topic) => format!("{robot}/{}", topic.strip_prefix('/').unwrap_or(&topic)),
            None => robot,
        };
        let [not_before, deadline] = [not_before, deadline].map(|time| time.map(|time| time.micros(now)));
        (service, TaskSpec { points, frame, priority, not_before, deadline, lease_ms: None, requeue })
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        submit: Submit,
    }

    fn spec(line: &[&str]) -> (String, String) {
        let words = [&["submit"], line].concat();
        let (service, spec) = Line::try_parse_from(words).unwrap().submit.into_spec(5);
        (service, serde_json::to_string(&spec).unwrap())
    }

    #[test]
    fn a_task_is_told_in_whole_numbers_and_block_time() {
        let point = r#"{"points":[{"x_um":-1500000,"y_um":0,"yaw_urad":0}],"frame""#;
        let (service, json) = spec(&["Husky", "--points", "-1.5,0"]);
        assert_eq!((service.as_str(), json), ("Husky", format!(r#"{point}:"map"}}"#)));
        let line =
            "--frame odom --priority -3 --not-before 1s --deadline 1970-01-01T00:01:00Z --service /cmd_vel --requeue";
        let (service, json) =
            spec(&[["Husky", "--points", "-1.5,0"].as_slice(), &line.split(' ').collect::<Vec<_>>()].concat());
        let rest = r#""priority":-3,"not_before":1000005,"deadline":60000000,"requeue":true}"#;
        assert_eq!((service.as_str(), json), ("Husky/cmd_vel", format!(r#"{point}:"odom",{rest}"#)));
        assert_eq!(spec(&["Husky", "--points", "0,0", "--service", "cmd_vel"]).0, "Husky/cmd_vel");
    }

    #[test]
    fn a_task_that_waits_tells_its_number_state_and_position() {
        let submitted = r#"{"task":{"id":7,"service":"Husky/cmd_vel","submitter":"Org1/Salma","state":"waiting",
            "reached":0,"total":2,"frame":"map","priority":0,"submitted":1},"queued":{"service":"Husky/cmd_vel",
            "contender":"Org1/Salma","position":3,"priority":0,"since":1,"until":2,"task":7}}"#;
        let submitted = serde_json::from_str(submitted).unwrap();
        let mut out = Vec::new();
        Done { submitted, time: 1, height: 1, transaction: ledger_base::hash::Hash::ZERO }.text(&mut out).unwrap();
        let wanted = "\
task 7 for Husky/cmd_vel is waiting
  points    2
  priority  0
  position  3
  turn      -
to see it: ledgerctl task show 7; to end it: ledgerctl task cancel 7
";
        assert_eq!(String::from_utf8(out).unwrap(), wanted);
    }
}
