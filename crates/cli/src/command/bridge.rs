//! `bridge`: what a bridge needs around it.

mod export_sros2;
mod keystore;
mod policy;

use crate::failure::Failure;
use crate::global::Global;
use crate::output::Output;
use clap::Subcommand;

/// Prepare a robot's ROS graph for a bridge.
#[derive(Debug, Subcommand)]
pub(crate) enum Bridge {
    ExportSros2(export_sros2::ExportSros2),
}

impl Bridge {
    pub(crate) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        match self {
            Self::ExportSros2(command) => command.run(global, output).await,
        }
    }
}
