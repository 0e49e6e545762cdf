//! The options of every command.

use crate::argument::destination::{self, Destination};
use crate::output::Format;
use crate::upkeep::Upkeep;

/// Options of every command.
#[derive(Debug, clap::Args)]
pub(crate) struct Global {
    /// Use this context; otherwise LEDGERCTL_CONTEXT, otherwise the one selected with `context use`
    #[arg(long, global = true, value_name = "NAME", help_heading = "For every command")]
    pub(crate) context: Option<String>,
    /// Output format: table for people; json for programs, one object or array on one line, with errors and warnings as
    /// objects on standard error; csv for tables of numbers
    #[arg(short, long, global = true, value_parser = destination::Reader, default_value = "table", value_name = "table|json|csv")]
    #[arg(hide_possible_values = true, hide_default_value = true, help_heading = "For every command")]
    pub(crate) output: Destination,
    /// Upkeep of the context beside the command
    #[arg(skip)]
    pub(crate) upkeep: Upkeep,
}

impl Global {
    /// How results are written.
    pub(crate) fn format(&self) -> Format {
        self.output.format()
    }
}
