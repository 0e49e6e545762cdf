//! `watch`: what changes, line by line.

use super::audit::{About, Audit};
use crate::failure::Failure;
use crate::global::Global;
use crate::output::Output;

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
    #[command(flatten)]
    about: About,
}

impl Watch {
    pub(crate) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        Audit::from_now(self.about).run(global, output).await
    }
}
