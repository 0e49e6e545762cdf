//! The output of `ledgerd lab`.

use super::layout::{NodeLayout, admin_context};
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_base::shell;
use serde::Serialize;
use std::path::PathBuf;

/// The output of `ledgerd lab --json`.
#[derive(Serialize)]
pub(super) struct Facts {
    pub(super) label: &'static str,
    pub(super) network: Hash,
    /// Everything is in it; it is removed at the end.
    pub(super) directory: PathBuf,
    /// `LEDGERD_HOME` for `ledgerctl`.
    pub(super) home: PathBuf,
    /// The organisation that owns the robots.
    pub(super) owner: String,
    pub(super) robots: Vec<String>,
    pub(super) contexts: Vec<String>,
    pub(super) nodes: Vec<NodeFacts>,
    pub(super) version: &'static str,
}

/// A node that runs.
#[derive(Serialize)]
pub(super) struct NodeFacts {
    name: String,
    organisation: String,
    voter: bool,
    address: String,
    /// `http://HOST:PORT` of the monitoring endpoint, and of the console.
    admin: String,
    console: String,
    config: PathBuf,
    process: Option<u32>,
}

impl NodeFacts {
    pub(super) fn of(node: &NodeLayout, process: Option<u32>) -> Self {
        Self {
            name: node.name.clone(),
            organisation: node.organisation.clone(),
            voter: node.is_voter,
            address: node.address.clone(),
            admin: format!("http://{}", node.admin),
            console: format!("http://{}", node.console),
            config: node.config.clone(),
            process,
        }
    }

    fn cells(&self) -> [String; 6] {
        [
            format!("{}/{}", self.organisation, self.name),
            if self.voter { "voter" } else { "learner" }.to_owned(),
            self.process.map(|id| id.to_string()).unwrap_or_default(),
            self.address.clone(),
            self.console.clone(),
            format!("{}/metrics", self.admin),
        ]
    }
}

impl Facts {
    /// One line of JSON.
    pub(super) fn json(&self) -> Result<String, Rejection> {
        serde_json::to_string(self).map_err(|error| Rejection::new(Code::Internal, error.to_string()))
    }

    /// The same for people, with what to type next.
    pub(super) fn text(&self) -> String {
        let head = ["NODE", "ROLE", "PROCESS", "ADDRESS", "CONSOLE", "METRICS"].map(str::to_owned);
        let table: Vec<[String; 6]> = std::iter::once(head).chain(self.nodes.iter().map(NodeFacts::cells)).collect();
        let width = |at: usize| table.iter().filter_map(|row| row.get(at)).map(String::len).max().unwrap_or_default();
        let widths: Vec<usize> = (0..6).map(width).collect();
        let line = |row: &[String; 6]| {
            let cells: Vec<String> = row.iter().zip(&widths).map(|(cell, width)| format!("{cell:<width$}")).collect();
            format!("  {}\n", cells.join("  ").trim_end())
        };
        format!(
            "ledgerd {version} · a network for trials, ready\n\n\
             {nodes}\n  \
             robots    {robots} (of {owner})\n  \
             contexts  {contexts}\n  \
             files     {directory} (removed at the end)\n\n\
             Next, in another terminal:\n\n  \
             export LEDGERD_HOME={home}\n  \
             ledgerctl --context {admin} network status\n  \
             ledgerctl --context Salma acquire Turtlebot4\n  \
             ledgerctl --context {owner_admin} console\n\n\
             To lose a node: kill -9 PROCESS. To start it again: ledgerd run --config {configs}. Ctrl-C ends all.",
            version = self.version,
            nodes = table.iter().map(line).collect::<String>(),
            robots = self.robots.join(", "),
            owner = self.owner,
            contexts = self.contexts.join(", "),
            directory = self.directory.display(),
            configs = shell::path(&self.directory.join("NODE.toml")),
            home = shell::path(&self.home),
            admin = admin_context("Org1"),
            owner_admin = admin_context(&self.owner),
        )
    }
}
