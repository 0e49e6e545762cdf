//! `network organisations`: who the network consists of.

use super::ask;
use crate::failure::Failure;
use crate::nodes::nodes;
use crate::output::{Facts, Output, Table};
use crate::session::Session;
use crate::time;
use bytes::Bytes;
use ledger::msp::{NodeRole, Organisation};
use serde::Serialize;
use std::io::{self, Write};

/// List the organisations with their CAs.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl network organisations")]
pub(crate) struct List {}

pub(super) async fn run(session: &Session, output: &mut Output) -> Result<(), Failure> {
    let names: Vec<String> = ask(session, "organisations", vec![], "the organisations").await?;
    let nodes = nodes(session).await?.nodes;
    let mut organisations = Vec::new();
    for name in names {
        let of = nodes.iter().filter(|node| node.organisation == name && node.role != NodeRole::Removed).count();
        let organisation = ask(session, "organisation", vec![Bytes::from(name)], "an organisation").await?;
        organisations.push(Member { organisation, nodes: of });
    }
    output.show(&Members(organisations))
}

/// An organisation of the network.
#[derive(Serialize)]
struct Member {
    #[serde(flatten)]
    organisation: Organisation,
    /// How many nodes it runs.
    nodes: usize,
}

#[derive(Serialize)]
struct Members(Vec<Member>);

impl Facts for Members {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let mut table = Table::new(["ORGANISATION", "NODES", "AUTHORITY", "FINGERPRINT", "VALID UNTIL"]);
        for Member { organisation, nodes } in &self.0 {
            let Organisation { name, roots, intermediates, .. } = organisation;
            for (index, authority) in roots.iter().chain(intermediates).enumerate() {
                table.row([
                    if index == 0 { name.clone() } else { String::new() },
                    if index == 0 { nodes.to_string() } else { String::new() },
                    authority.subject.clone(),
                    authority.fingerprint.to_string(),
                    time::moment(authority.not_after),
                ]);
            }
        }
        table.write(out, 0)
    }
}
