//! `stop`, `resume`: nobody commands a robot that is stopped, until somebody who may resumes it.

use crate::answer;
use crate::argument::span::Milliseconds;
use crate::failure::Failure;
use crate::global::Global;
use crate::in_force::{Described, until_in_force};
use crate::output::{Facts, Output};
use crate::session::{ABAC, Session};
use crate::words::{Words, shell_word};
use bytes::Bytes;
use ledger::CallRef;
use ledger_api::Committed;
use ledger_api::v1::OpenStop;
use ledger_base::hash::Hash;
use ledger_base::rejection::Rejection;
use ledger_contract::EmergencyAnswer;
use serde::Serialize;
use std::io::{self, Write};
use std::time::Duration;

/// Stop a robot: its grants end, and no new ones are given until it is resumed.
///
/// For admins of the robot's owner, the robot itself, and holders of its command services. Also for identities with the
/// attribute safety=true of organisations that the owner trusts, and those to which its policies permit `stop`. Holders
/// must acquire again after `resume`.
///
/// If nothing can be ordered, the robots are notified directly, and the stop is signed and sent again until it is in
/// force. If the command ends earlier, by Ctrl-C or --timeout, it fails: repeat it.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Example:
  ledgerctl stop Turtlebot4 --reason 'person in the cell'
  ledgerctl stop --all")]
pub(crate) struct Stop {
    #[command(flatten)]
    which: Which,
    /// Give up after this time, and fail if the stop is not in force by then [default: never]
    #[arg(long, value_name = "TIME")]
    timeout: Option<Milliseconds>,
}

/// Resume a stopped robot; for admins of its owner and identities to which policies permit `resume`.
///
/// The next contender in the queue, if any, gets the service. Grants that the stop ended are not restored: their
/// holders must acquire again. Pending stops of the robot without a verdict are cancelled.
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
    /// Every robot for which you have this permission
    #[arg(long)]
    all: bool,
    /// Reason; visible to all members
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
    transaction: Hash,
    certified: bool,
    #[serde(skip)]
    state: &'static str,
}

impl Facts for Done {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let Self { answer: EmergencyAnswer { robots, unchanged, ended }, state, .. } = self;
        let force = if *state == "stopped" { ": in force" } else { "" };
        for robot in robots {
            writeln!(out, "{robot} is {state}{force}")?;
        }
        for robot in unchanged {
            writeln!(out, "{robot} was {state} before{force}")?;
        }
        for grant in ended {
            writeln!(out, "  ended the grant of {} to {} (epoch {})", grant.service, grant.holder, grant.epoch)?;
        }
        if !ended.is_empty() {
            writeln!(out, "the holders must acquire again after `ledgerctl resume`")?;
        }
        if *state == "resumed" && !robots.is_empty() {
            writeln!(out, "grants that the stop ended are not restored: their holders must acquire again")?;
        }
        if robots.is_empty() && unchanged.is_empty() {
            writeln!(out, "there is no robot")?;
        }
        Ok(())
    }
}

impl Which {
    /// The robot, or `*`.
    fn robot(&self) -> String {
        self.robot.clone().unwrap_or_else(|| "*".to_owned())
    }
}

fn show(done: Committed, state: &'static str, output: &mut Output) -> Result<(), Failure> {
    let Committed { id, height, time, response, certified, .. } = done;
    let answer = answer::parse(&response, "an answer about robots")?;
    output.show(&Done { answer, time, height, transaction: id, certified, state })
}

/// The words of the command line where the chaincode has other names.
const STOP: Words = Words { arguments: &[("ROBOT|*", "the robot"), ("REASON", "--reason")], help: "ledgerctl stop" };
const RESUME: Words = Words { help: "ledgerctl resume", ..STOP };

/// Most stops that one resume cancels.
const NAMED_MAX: usize = 64;

/// The name of a stop that has no verdict.
fn call(open: &OpenStop) -> Option<CallRef> {
    Some(CallRef { id: Hash::from_slice(&open.id)?, not_after: open.not_after })
}

impl Stop {
    pub(crate) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let robot = self.which.robot();
        let (what, typed) = match robot.as_str() {
            "*" => ("the stop of all robots".to_owned(), "--all".to_owned()),
            robot => (format!("the stop of {robot}"), shell_word(robot)),
        };
        let described = Described { what, command: format!("ledgerctl stop {typed}"), robot: Some(&robot) };
        let session = Session::open(global).await?;
        let args: Vec<_> = [Some(&robot), self.which.reason.as_ref()].into_iter().flatten().cloned().collect();
        let attempt = || async {
            let args = args.iter().cloned().map(Bytes::from).collect();
            session.call(ABAC, "stop", args).await.map_err(|refused| STOP.told(refused))
        };
        let timeout = self.timeout.map(|Milliseconds(ms)| Duration::from_millis(ms));
        let done = until_in_force(&session, &described, timeout, output, attempt).await?;
        show(done, "stopped", output)
    }
}

impl Resume {
    pub(crate) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let session = Session::open(global).await?;
        let cancels = |by: &str| output.note(&format!("cancels the pending stop by {by}, which has no verdict yet"));
        let done = resume(&session, self.which.robot(), self.which.reason.clone(), cancels).await?;
        show(done, "resumed", output)
    }
}

/// Resumes a robot, or every one with `*`. Stops of it that have no verdict are cancelled: `cancels` gets who signed each.
///
/// # Errors
/// Those of the call, in the words of the command line.
pub(crate) async fn resume(
    session: &Session,
    robot: String,
    reason: Option<String>,
    cancels: impl Fn(&str),
) -> Result<Committed, Rejection> {
    // A node that has no stop without a verdict knows of none that could come later.
    let open = session.client.status().await?.open_stops;
    let named = open.iter().filter(|open| open.robot == robot || open.robot == "*" || robot == "*");
    let named: Vec<_> =
        named.inspect(|open| cancels(&open.by)).filter_map(call).take(NAMED_MAX).map(|call| call.to_string()).collect();
    let reason = reason.or_else(|| (!named.is_empty()).then(String::new));
    let args = std::iter::once(robot).chain(reason).chain(named).map(Bytes::from).collect();
    session.call(ABAC, "resume", args).await.map_err(|refused| RESUME.told(refused))
}
