//! Tasks, for people.

use crate::argument::points::decimal;
use crate::output::{Facts, Table, printable};
use crate::time;
use ledger_contract::Task;
use serde::Serialize;
use std::io::{self, Write};

/// Tasks, and the moment by which their times are told.
#[derive(Serialize)]
#[serde(transparent)]
pub(super) struct Tasks(pub(super) Vec<Task>, #[serde(skip)] pub(super) u64);

impl Facts for Tasks {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let Self(tasks, now) = self;
        if tasks.is_empty() {
            return writeln!(out, "there are no tasks");
        }
        let mut table =
            Table::new(["TASK", "SERVICE", "SUBMITTER", "STATE", "REACHED", "PRIORITY", "SUBMITTED", "REASON"]);
        for task in tasks {
            table.row([
                task.id.to_string(),
                task.service.clone(),
                task.submitter.clone(),
                task.state.to_string(),
                reached(task),
                task.priority.to_string(),
                time::relative(task.submitted, *now),
                task.reason.clone(),
            ]);
        }
        table.write(out, 0)
    }
}

/// A task with its points, and the moment by which its times are told.
#[derive(Serialize)]
#[serde(transparent)]
pub(super) struct Shown(pub(super) Task, #[serde(skip)] pub(super) u64);

impl Facts for Shown {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let Self(task, now) = self;
        writeln!(out, "{}", headline(task))?;
        let at = |moment: Option<u64>| moment.map_or_else(String::new, |moment| when(moment, *now));
        let mut table = Table::pairs();
        table.pair("submitter", &task.submitter);
        table.pair("reached", reached(task));
        table.pair("reason", &task.reason);
        table.pair("priority", task.priority);
        table.pair("requeue", if task.requeue { "waits again after it was preempted" } else { "" });
        table.pair("submitted", at(Some(task.submitted)));
        table.pair("not before", at(task.not_before));
        table.pair("deadline", at(task.deadline));
        table.pair("started", at(task.started));
        table.pair("ended", at(task.ended));
        table.pair("frame", &task.frame);
        table.write(out, 2)?;
        points(task).write(out, 0)
    }
}

/// The points of a task, those first that were reached.
fn points(task: &Task) -> Table {
    let mut table = Table::new(["POINT", "X (m)", "Y (m)", "YAW (rad)", "REACHED"]);
    for (number, point) in (1..).zip(&task.points) {
        let reached = if number <= task.reached { "yes" } else { "no" };
        let [x, y, yaw] = [point.x_um, point.y_um, point.yaw_urad].map(decimal);
        table.row([number.to_string(), x, y, yaw, reached.to_owned()]);
    }
    table
}

/// A task that has changed, and the transaction that changed it.
#[derive(Serialize)]
pub(super) struct Changed {
    #[serde(flatten)]
    pub(super) task: Task,
    /// Block time of the transaction, microseconds.
    pub(super) time: u64,
    pub(super) height: u64,
    pub(super) transaction: ledger_base::hash::Hash,
}

impl Facts for Changed {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let Self { task, .. } = self;
        let reason = if task.reason.is_empty() { String::new() } else { format!(" ({})", printable(&task.reason)) };
        writeln!(out, "{}{reason}; {} points reached", headline(task), reached(task))
    }
}

/// `task 7 for Turtlebot4/cmd_vel is running`.
pub(super) fn headline(task: &Task) -> String {
    format!("task {} for {} is {}", task.id, printable(&task.service), printable(task.state.word()))
}

/// A moment of the calendar, and as seen from another one.
pub(super) fn when(moment: u64, now: u64) -> String {
    format!("{} ({})", time::moment(moment), time::relative(moment, now))
}

fn reached(task: &Task) -> String {
    format!("{} of {}", task.reached, task.total)
}

#[cfg(test)]
#[expect(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]
mod tests {
    use super::*;

    const TASK: &str = r#"{"id":7,"service":"Husky/cmd_vel","submitter":"Org1/Salma","state":"failed","reached":1,
        "total":2,"frame":"map","points":[{"x_um":1000000,"y_um":0,"yaw_urad":0},
        {"x_um":-2500000,"y_um":1,"yaw_urad":1570796}],"priority":-2,"submitted":1000000,"reason":"a\u001b door"}"#;

    fn task() -> Task {
        serde_json::from_str(TASK).unwrap()
    }

    fn text(facts: &impl Facts) -> String {
        let mut out = Vec::new();
        facts.text(&mut out).unwrap();
        String::from_utf8(out).unwrap()
    }

    #[test]
    fn a_task_tells_its_points_those_reached_and_why_it_ended() {
        let shown = text(&Shown(task(), 3_000_000));
        for part in [
            "task 7 for Husky/cmd_vel is failed\n",
            "  submitter  Org1/Salma\n  reached    1 of 2\n  reason     a\\u{1b} door\n  priority   -2\n",
            "(2 s ago)",
            "POINT  X (m)  Y (m)     YAW (rad)  REACHED\n",
            "1      1      0         0          yes\n",
            "2      -2.5   0.000001  1.570796   no\n",
        ] {
            assert!(shown.contains(part), "{part:?} in {shown}");
        }
        assert!(!shown.contains("deadline"), "{shown}");
    }

    #[test]
    fn tasks_are_a_table_of_one_line_each() {
        let wanted = "\
TASK  SERVICE        SUBMITTER   STATE   REACHED  PRIORITY  SUBMITTED  REASON
7     Husky/cmd_vel  Org1/Salma  failed  1 of 2   -2        2 s ago    a\\u{1b} door
";
        assert_eq!(text(&Tasks(vec![task()], 3_000_000)), wanted);
        assert_eq!(text(&Tasks(Vec::new(), 0)), "there are no tasks\n");
    }

    #[test]
    fn a_changed_task_is_flat_in_json_and_one_line_for_people() {
        let changed = Changed { task: task(), time: 9, height: 3, transaction: ledger_base::hash::Hash::ZERO };
        assert_eq!(text(&changed), "task 7 for Husky/cmd_vel is failed (a\\u{1b} door); 1 of 2 points reached\n");
        let value = serde_json::to_value(&changed).unwrap();
        assert_eq!((&value["id"], &value["state"], &value["height"]), (&7.into(), &"failed".into(), &3.into()));
    }
}
