//! `network nodes`: the nodes as the ledger wants them.

use crate::output::{Facts, Table};
use ledger::members::Membership;
use ledger::msp::{NodeRole, Nodes};
use serde::Serialize;
use std::io::{self, Write};

/// List the nodes with their roles and target roles.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl network nodes")]
pub(crate) struct List {}

/// The nodes on the ledger.
#[derive(Serialize)]
#[serde(transparent)]
pub(super) struct Known(pub(super) Nodes);

impl Facts for Known {
    fn rows(&self) -> serde_json::Result<String> {
        serde_json::to_string(&self.0.nodes)
    }

    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let mut table = Table::new(["NODE", "ID", "ADDRESS", "TARGET", "ROLE"]);
        for node in &self.0.nodes {
            table.row([
                node.full_name(),
                node.id.to_string(),
                node.address.clone(),
                node.role.to_string(),
                actual(&self.0.members, node.id).unwrap_or(absent(node.role)).to_owned(),
            ]);
        }
        table.write(out, 0)
    }
}

/// The role of a node in the ordering; none if it is not in it.
pub(super) fn actual(members: &Membership, id: u64) -> Option<&'static str> {
    match (members.is_voter(id), members.contains(id)) {
        (true, _) => Some("voter"),
        (false, true) => Some("learner"),
        (false, false) => None,
    }
}

/// The word for a node that is not in the ordering.
pub(super) fn absent(wanted: NodeRole) -> &'static str {
    if wanted == NodeRole::Removed { "removed" } else { "joining" }
}
