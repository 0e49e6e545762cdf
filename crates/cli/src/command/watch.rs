//! `watch`: what changes, line by line.

use super::audit::Audit;
use crate::cli::Global;
use crate::failure::Failure;
use crate::output::Output;
use ledger_rejection::Code;

/// Print what changes from now on, a line each, until Ctrl-C: grants and their ends, refusals, stops, policies, people, nodes.
///
/// The lines are rows of `ledgerctl audit`, which shows the past as well. Commands have no lines: `ledgerctl echo` prints them.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Example:
  ledgerctl watch
  ledgerctl watch --robot Turtlebot4
  ledgerctl watch --code LGR-3005 -o json")]
pub(crate) struct Watch {
    /// Only about this robot
    #[arg(long, value_name = "ROBOT")]
    robot: Option<String>,
    /// Only what this identity did, or what was done to it; without an organisation one of your own
    #[arg(long, value_name = "[ORG/]NAME")]
    user: Option<String>,
    /// Only what concerns identities of this organisation
    #[arg(long, value_name = "ORG")]
    organisation: Option<String>,
    /// Only refusals with this code
    #[arg(long, value_name = "LGR-NNNN", value_parser = super::audit::code)]
    code: Option<Code>,
}

impl Watch {
    pub(crate) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let Self { robot, user, organisation, code } = self;
        Audit::from_now(robot, user, organisation, code).run(global, output).await
    }
}
