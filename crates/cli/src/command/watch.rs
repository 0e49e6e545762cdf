//! `watch`: what changes, line by line.

use super::audit::{About, Audit};
use crate::failure::Failure;
use crate::global::Global;
use crate::output::Output;

/// Print changes as they happen, one line each, until Ctrl-C: grants and their ends, rejections, stops, policies,
/// identities, nodes.
///
/// The lines are rows of `ledgerctl audit`, which also shows the past. Commands are not included: `ledgerctl echo`
/// prints them.
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
