//! `stop`, `resume`: nobody commands a robot that is stopped, until somebody who may resumes it.

use crate::answer;
use crate::failure::Failure;
use crate::global::Global;
use crate::output::{Facts, Output};
use crate::session::{ABAC, Session};
use crate::words::Words;
use bytes::Bytes;
use ledger_api::Committed;
use ledger_contract::EmergencyAnswer;
use serde::Serialize;
use std::io::{self, Write};

/// Stop a robot: whoever commands it loses it, and nobody gets it until it is resumed.
///
/// For admins of the robot's owner, for identities with the attribute safety=true of organisations that the owner trusts,
/// for the robot itself, and those whom the owner's policies permit `stop`.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Example:
  ledgerctl stop Turtlebot4 --reason 'person in the cell'
  ledgerctl stop --all")]
pub(crate) struct Stop {
    #[command(flatten)]
    which: Which,
}

/// Let a stopped robot be commanded again; for admins of its owner and those whom policies permit `resume`.
///
/// The next one in line gets it, if anybody waits.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl resume Turtlebot4 --reason 'cell is empty'")]
pub(crate) struct Resume {
    #[command(flatten)]
    which: Which,
}

#[derive(Debug, clap::Args)]
struct Which {
    /// Name of the robot
    #[arg(value_name = "ROBOT", required_unless_present = "all", conflicts_with = "all")]
    robot: Option<String>,
    /// Every robot for which you may do so
    #[arg(long)]
    all: bool,
    /// Why, for everybody to read
    #[arg(long, value_name = "TEXT")]
    reason: Option<String>,
}

/// The answer, and the transaction that it came with.
#[derive(Serialize)]
struct Done {
    #[serde(flatten)]
    answer: EmergencyAnswer,
    time: u64,
    height: u64,
    transaction: ledger_base::hash::Hash,
    #[serde(skip)]
    state: &'static str,
}

impl Facts for Done {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let Self { answer: EmergencyAnswer { robots, unchanged, ended }, state, .. } = self;
        for robot in robots {
            writeln!(out, "{robot} is {state}")?;
        }
        for robot in unchanged {
            writeln!(out, "{robot} was {state} before")?;
        }
        for grant in ended {
            writeln!(out, "  ended the grant of {} to {} (epoch {})", grant.service, grant.holder, grant.epoch)?;
        }
        if robots.is_empty() && unchanged.is_empty() {
            writeln!(out, "there is no robot")?;
        }
        Ok(())
    }
}

impl Which {
    async fn run(
        self,
        (function, state): (&str, &'static str),
        words: Words,
        global: &Global,
        output: &mut Output,
    ) -> Result<(), Failure> {
        let session = Session::open(global).await?;
        let robot = self.robot.unwrap_or_else(|| "*".to_owned());
        let args = std::iter::once(robot).chain(self.reason).map(Bytes::from).collect();
        let done = session.call(ABAC, function, args).await.map_err(|refused| words.told(refused))?;
        let Committed { id, height, time, response, .. } = done;
        let answer = answer::parse(&response, "an answer about robots")?;
        output.show(&Done { answer, time, height, transaction: id, state })
    }
}

/// The words of the command line where the chaincode has other names.
const STOP: Words = Words { arguments: &[("ROBOT|*", "the robot"), ("REASON", "--reason")], help: "ledgerctl stop" };
const RESUME: Words = Words { help: "ledgerctl resume", ..STOP };

impl Stop {
    pub(crate) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        self.which.run(("stop", "stopped"), STOP, global, output).await
    }
}

impl Resume {
    pub(crate) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        self.which.run(("resume", "resumed"), RESUME, global, output).await
    }
}
