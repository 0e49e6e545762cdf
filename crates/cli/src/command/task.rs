//! `task submit|list|show|cancel|progress|fail`: points that a robot traverses in order, for one user.

mod show;
mod submit;

use crate::answer;
use crate::failure::Failure;
use crate::global::Global;
use crate::output::Output;
use crate::session::{ABAC, Session};
use crate::words::Words;
use bytes::Bytes;
use ledger_api::Committed;

/// Let a robot traverse points; the tasks of a robot are queued and run one after the other.
#[derive(Debug, clap::Subcommand)]
pub(crate) enum Task {
    Submit(submit::Submit),
    List(List),
    Show(Show),
    Cancel(Cancel),
    Progress(Progress),
    Fail(Fail),
}

/// List the tasks of all robots, oldest first: the open ones, and the newest of those that have ended.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl task list")]
pub(crate) struct List {}

/// Show a task and its points.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl task show 7")]
pub(crate) struct Show {
    #[command(flatten)]
    which: Which,
}

/// End a task that you submitted; admins of the robot's owner can end any task.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl task cancel 7")]
pub(crate) struct Cancel {
    #[command(flatten)]
    which: Which,
}

/// Report that a running task has reached a point; the last point ends the task. For its submitter and for the robot.
///
/// Each report renews the lease of the grant that serves the task.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl task progress 7 2")]
pub(crate) struct Progress {
    #[command(flatten)]
    which: Which,
    /// The point that was reached; the first one is 1
    point: u64,
}

/// Report that a running task has failed, which ends it. For its submitter and for the robot.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl task fail 7 --reason 'the door is locked'")]
pub(crate) struct Fail {
    #[command(flatten)]
    which: Which,
    /// Reason; visible to all members
    #[arg(long, value_name = "TEXT")]
    reason: String,
}

#[derive(Debug, clap::Args)]
struct Which {
    /// Number of the task; see `task list`
    id: u64,
}

/// The words of the command line where the chaincode has other names.
const WORDS: Words = Words {
    arguments: &[
        ("ID", "the number of the task"),
        ("REACHED", "the point"),
        ("REASON", "--reason"),
        ("TASK_JSON", "the task"),
    ],
    help: "ledgerctl task",
};

impl Task {
    pub(crate) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let session = Session::open(global).await?;
        match self {
            Self::Submit(submit) => submit.run(&session, output).await,
            Self::List(_) => {
                let tasks = session.list(ABAC, "tasks").await?;
                output.show(&show::Tasks(tasks, session.client.now()))
            }
            Self::Show(Show { which: Which { id } }) => {
                let response = session.ask(ABAC, "task", vec![Bytes::from(id.to_string())]).await;
                let response = response.map_err(|refused| WORDS.told(refused))?;
                output.show(&show::Shown(answer::parse(&response, "a task")?, session.client.now()))
            }
            Self::Cancel(Cancel { which: Which { id } }) => change(&session, "cancel", [id.to_string()], output).await,
            Self::Progress(Progress { which: Which { id }, point }) => {
                change(&session, "progress", [id.to_string(), point.to_string()], output).await
            }
            Self::Fail(Fail { which: Which { id }, reason }) => {
                change(&session, "fail", [id.to_string(), reason], output).await
            }
        }
    }
}

/// Changes a task, and tells how it is now.
async fn change<const N: usize>(
    session: &Session,
    function: &str,
    args: [String; N],
    output: &mut Output,
) -> Result<(), Failure> {
    let done = session.call(ABAC, function, args.map(Bytes::from).into()).await;
    let Committed { id: transaction, height, time, response, .. } = done.map_err(|refused| WORDS.told(refused))?;
    output.show(&show::Changed { task: answer::parse(&response, "a task")?, time, height, transaction })
}
