//! `identity renew`: the next certificate of the selected context.

use crate::context;
use crate::failure::Failure;
use crate::global::Global;
use crate::output::{Facts, Output, Table};
use crate::time;
use serde::Serialize;
use std::io::{self, Write};

/// Renew your own certificate, with a new key, while the current one is still valid.
///
/// The new certificate has the attributes that are registered now. Nodes and bridges renew theirs automatically.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl identity renew --context Salma")]
pub(crate) struct Renew {}

#[derive(Serialize)]
struct Renewed {
    context: String,
    id: String,
    before: u64,
    not_after: u64,
}

impl Facts for Renewed {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        writeln!(out, "renewed {}, stored as context {}", self.id, self.context)?;
        let mut table = Table::pairs();
        table.pair("valid until", time::moment(self.not_after));
        table.pair("before", time::moment(self.before));
        table.write(out, 2)
    }
}

impl Renew {
    pub(crate) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let before = context::selected(global)?;
        let client = ledger_api::Client::connect(&before).await?;
        let renewed = before.renew(&client).await?;
        let identity = context::identity(&renewed)?;
        output.show(&Renewed {
            context: renewed.name,
            id: identity.id(),
            before: context::identity(&before)?.not_after,
            not_after: identity.not_after,
        })
    }
}
