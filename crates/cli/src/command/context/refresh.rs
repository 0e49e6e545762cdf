//! `context refresh`: learns the nodes and organisations of the network now.

use super::show::{Node, nodes};
use crate::context;
use crate::failure::Failure;
use crate::global::Global;
use crate::output::{Facts, Output, Table};
use crate::session::Session;
use ledger_api::Context;
use serde::Serialize;
use std::io::{self, Write};

/// Update the nodes and organisations that a context lists.
///
/// Every command does this in the background. This one fails if no node answers or the context cannot be written.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl context refresh\n  ledgerctl context refresh Salma")]
pub(crate) struct Refresh {
    /// Name of the context; by default the selected one
    name: Option<String>,
}

#[derive(Serialize)]
struct Refreshed {
    context: String,
    /// The node that told it.
    told_by: String,
    nodes: Vec<Node>,
    /// Addresses that were not known before.
    new: Vec<String>,
    /// Addresses that were known, and are no node's any more.
    gone: Vec<String>,
}

impl Refresh {
    pub(super) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let mut refreshed = match &self.name {
            Some(name) => Context::load(&context::home()?, Some(name))?,
            None => context::selected(global)?,
        };
        let before = refreshed.addresses();
        let session = Session::connect(refreshed.clone()).await?;
        let told = session.client.network().await?;
        let told_by = session.client.node().to_string();
        refreshed.learn(&told, &told_by)?;
        refreshed.note()?;
        let after = refreshed.addresses();
        let missing = |from: &[String], of: &[String]| of.iter().filter(|one| !from.contains(one)).cloned().collect();
        output.show(&Refreshed {
            nodes: nodes(&refreshed),
            context: refreshed.name,
            told_by,
            new: missing(&before, &after),
            gone: missing(&after, &before),
        })
    }
}

impl Facts for Refreshed {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let (nodes, new, gone) = (self.nodes.len(), self.new.len(), self.gone.len());
        writeln!(out, "context {} lists {nodes} nodes: {new} new, {gone} removed", self.context)?;
        let mut table = Table::new(["NODE", "ORGANISATION", ""]);
        for node in &self.nodes {
            let told = if node.address == self.told_by { "answered" } else { "" };
            let new = if self.new.contains(&node.address) { "new" } else { told };
            table.row([node.address.clone(), node.organisation.clone(), new.to_owned()]);
        }
        for address in &self.gone {
            table.row([address.clone(), String::new(), "gone".to_owned()]);
        }
        table.write(out, 2)
    }
}
