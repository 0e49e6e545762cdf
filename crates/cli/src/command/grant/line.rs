//! The line of a service, for people.

use super::confirm;
use crate::failure::Failure;
use crate::output::{Facts, Output, Table};
use crate::time;
use crate::words::Words;
use ledger_api::Committed;
use ledger_base::rejection::Class;
use ledger_contract::{LineState, Place};
use serde::Serialize;
use std::io::{self, Write};

/// The words of the command line where the chaincode has other names.
pub(super) const WORDS: Words = Words { arguments: &[], help: "ledgerctl queue" };

/// A line, and the moment by which its times are told.
#[derive(Serialize)]
#[serde(transparent)]
pub(super) struct Line(pub(super) LineState, #[serde(skip)] pub(super) u64);

impl Facts for Line {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let Self(LineState { service, holders, line, pending }, now) = self;
        if holders.is_empty() {
            writeln!(out, "{service} has no holder")?;
        }
        for grant in holders {
            let expires = time::relative(grant.expires, *now);
            let who = with_task(&grant.holder, grant.task);
            writeln!(out, "{service} is held by {who} with epoch {}, expires {expires}", grant.epoch)?;
        }
        for pending in pending {
            let (who, until) = (&pending.contender, time::relative(pending.until, *now));
            writeln!(out, "{who} waits for confirmations until {until}: confirmed by {}", confirm::state(pending))?;
        }
        if line.is_empty() {
            return writeln!(out, "the queue is empty");
        }
        let mut table = Table::new(["POSITION", "WHO", "PRIORITY", "SINCE", "UNTIL", "TURN"]);
        for place in line {
            table.row([
                place.position.to_string(),
                with_task(&place.contender, place.task),
                place.priority.to_string(),
                time::relative(place.since, *now),
                time::relative(place.until, *now),
                turn(place, *now),
            ]);
        }
        table.write(out, 0)
    }
}

/// A contender or holder, and the task for which it wants or holds the service.
fn with_task(who: &str, task: Option<u64>) -> String {
    task.map_or_else(|| who.to_owned(), |task| format!("{who} (task {task})"))
}

/// When a turn comes, as far as that is known.
pub(crate) fn turn(place: &Place, now: u64) -> String {
    match place.expected {
        None => "-".to_owned(),
        Some(expected) if expected <= now => "soon".to_owned(),
        Some(expected) => format!("{} unless renewed", time::relative(expected, now)),
    }
}

/// A place in line, and the transaction that gave it.
#[derive(Serialize)]
struct Joined<'a> {
    queued: Place,
    time: u64,
    height: u64,
    transaction: &'a ledger_base::hash::Hash,
}

impl Facts for Joined<'_> {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let Place { service, position, priority, until, .. } = &self.queued;
        writeln!(out, "{service} is held by others: you are in the queue")?;
        let mut table = Table::pairs();
        table.pair("position", position);
        table.pair("priority", priority);
        table.pair("turn", turn(&self.queued, self.time));
        table.pair("until", format!("{} ({})", time::moment(*until), time::relative(*until, self.time)));
        table.write(out, 2)?;
        writeln!(
            out,
            "to wait for it: ledgerctl acquire {service} --wait 5m; to leave the queue: ledgerctl release \
                       {service}"
        )
    }
}

/// Tells the place of a caller who does not wait. It has no grant: the exit code says that others hold the service.
pub(super) fn joined(queued: Place, done: &Committed, output: &mut Output) -> Result<(), Failure> {
    output.show(&Joined { queued, time: done.time, height: done.height, transaction: &done.id })?;
    Err(Failure::Told(Class::Conflict.exit_code()))
}

#[cfg(test)]
#[expect(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]
mod tests {
    use super::*;

    const LINE: &str = r#"{"service":"Husky/cmd_vel","holders":[{"service":"Husky/cmd_vel","holder":"Org1/Salma",
        "epoch":3,"expires":11000000,"mode":"exclusive","acquired_at":0,"lease_ms":10000,"next_seq":0}],
        "line":[{"service":"Husky/cmd_vel","contender":"Org1/Farhad","position":1,"priority":-2,"since":1000000,
        "until":61000000,"expected":11000000}]}"#;

    #[test]
    fn a_line_tells_who_holds_the_service_and_whose_turn_comes_when() {
        let line = Line(serde_json::from_str(LINE).unwrap(), 3_000_000);
        let mut out = Vec::new();
        line.text(&mut out).unwrap();
        let wanted = "\
Husky/cmd_vel is held by Org1/Salma with epoch 3, expires in 8 s
POSITION  WHO          PRIORITY  SINCE    UNTIL    TURN
1         Org1/Farhad  -2        2 s ago  in 58 s  in 8 s unless renewed
";
        assert_eq!(String::from_utf8(out).unwrap(), wanted);
    }

    #[test]
    fn a_line_tells_the_tasks_of_holders_and_places() {
        let mut state: LineState = serde_json::from_str(LINE).unwrap();
        state.holders[0].task = Some(6);
        state.line[0].task = Some(7);
        let mut out = Vec::new();
        Line(state, 3_000_000).text(&mut out).unwrap();
        let told = String::from_utf8(out).unwrap();
        for part in ["held by Org1/Salma (task 6) with epoch 3", "1         Org1/Farhad (task 7)  -2"] {
            assert!(told.contains(part), "{part:?} in {told}");
        }
    }
}
