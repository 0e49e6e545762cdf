//! `network status`: how every node is, asked one by one.

use super::nodes::{absent, actual};
use super::{ask, current, nodes};
use crate::failure::Failure;
use crate::output::{Facts, Output, Table, printable};
use crate::session::Session;
use ledger::governance::{AttestationRecord, NodeRecord, NodeRole, Nodes};
use ledger::{Hash, Rejection};
use ledger_api::{Client, Context, Credentials, Options, v1};
use serde::Serialize;
use std::collections::BTreeMap;
use std::io::{self, Write};
use std::time::Duration;
use tokio::task::JoinSet;

/// How long one node has to answer.
const PATIENCE: Duration = Duration::from_secs(3);

/// Show how every node of the network is.
///
/// Asks each node itself. IS is what it does in the ordering, SHALL BE what the ledger wants, ATTESTED the last height
/// whose state it has signed.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl network status")]
pub(crate) struct Status {}

/// The network as its nodes see it.
#[derive(Serialize)]
struct Overview {
    network: Hash,
    label: String,
    /// 0 = nobody knows one.
    leader_id: u64,
    term: u64,
    /// Greatest height that a node has executed.
    height: u64,
    voters: usize,
    voters_reachable: usize,
    nodes: Vec<Node>,
}

/// A node.
#[derive(Serialize)]
struct Node {
    id: u64,
    name: String,
    organisation: String,
    address: String,
    /// What it shall be.
    wanted: NodeRole,
    /// What it is: voter, learner, joining or removed.
    role: String,
    leader: bool,
    reachable: bool,
    /// Why it is not reachable.
    #[serde(skip_serializing_if = "String::is_empty")]
    reason: String,
    /// What it says of itself; none if it is not reachable.
    height: Option<u64>,
    committed: Option<u64>,
    first_height: Option<u64>,
    snapshot_height: Option<u64>,
    catching_up_to: Option<u64>,
    version: Option<String>,
    #[serde(skip_serializing_if = "String::is_empty")]
    divergence: String,
    /// How much of the log is on its disk, as the leader knows.
    matched: Option<u64>,
    /// Last height that it has attested.
    attested: Option<u64>,
}

pub(super) async fn run(session: &Session, output: &mut Output) -> Result<(), Failure> {
    let known = nodes(session).await?;
    let attestations: Vec<AttestationRecord> = ask(session, "attestations", vec![], "the attestations").await?;
    let credentials = current(session).await?.credentials()?;
    let answers = everybody(&known, &credentials).await;
    output.show(&overview(session.context(), &known, &attestations, answers))
}

type Answers = BTreeMap<u64, Result<v1::StatusResponse, Rejection>>;

/// Asks all nodes at once.
async fn everybody(known: &Nodes, credentials: &Credentials) -> Answers {
    let mut asked = JoinSet::new();
    for node in known.nodes.iter().filter(|node| shown(known, node)) {
        let (id, address, credentials) = (node.id, node.address.clone(), credentials.clone());
        let options = Options { deadline: PATIENCE, connect: PATIENCE, ..Options::default() };
        asked.spawn(async move {
            let ask = async { Client::connect_with(vec![address], credentials, options).await?.status().await };
            (id, ask.await)
        });
    }
    let mut answers = Answers::new();
    while let Some(answer) = asked.join_next().await {
        answers.extend(answer.ok());
    }
    answers
}

fn shown(known: &Nodes, node: &NodeRecord) -> bool {
    node.role != NodeRole::Removed || known.members.contains(node.id)
}

fn overview(context: &Context, known: &Nodes, attestations: &[AttestationRecord], mut answers: Answers) -> Overview {
    let newest = answers.values().flatten().max_by_key(|status| (status.term, status.leader_id != 0));
    let (leader_id, term) = newest.map_or((0, 0), |status| (status.leader_id, status.term));
    let leader = answers.get(&leader_id).and_then(|answer| answer.as_ref().ok());
    let matched: BTreeMap<u64, u64> =
        leader.map(|leader| leader.peers.iter().map(|peer| (peer.node_id, peer.matched)).collect()).unwrap_or_default();
    let height = answers.values().flatten().map(|status| status.height).max().unwrap_or_default();
    let nodes = known.nodes.iter().filter(|node| shown(known, node)).map(|node| {
        let answer = answers.remove(&node.id);
        // Another node may have taken its address.
        let (said, reason) = match answer {
            Some(Ok(said)) if said.node_id == node.id => (Some(said), String::new()),
            Some(Ok(other)) => (None, format!("node {} answers there", other.node_id)),
            Some(Err(refused)) => (None, refused.message),
            None => (None, "it was not asked".to_owned()),
        };
        let said = said.as_ref();
        Node {
            id: node.id,
            name: node.name.clone(),
            organisation: node.organisation.clone(),
            address: node.address.clone(),
            wanted: node.role,
            role: actual(&known.members, node.id).unwrap_or(absent(node.role)).to_owned(),
            leader: node.id == leader_id,
            reachable: said.is_some(),
            reason,
            height: said.map(|said| said.height),
            committed: said.map(|said| said.committed),
            first_height: said.map(|said| said.first_height),
            snapshot_height: said.map(|said| said.snapshot_height).filter(|height| *height > 0),
            catching_up_to: said.map(|said| said.catching_up_to).filter(|height| *height > 0),
            version: said.map(|said| said.version.clone()),
            divergence: said.map_or_else(String::new, |said| said.divergence.clone()),
            matched: match said {
                Some(leader) if node.id == leader_id => Some(leader.last_index),
                _ => matched.get(&node.id).copied().filter(|matched| *matched > 0),
            },
            attested: attestations.iter().find(|record| record.id == node.id).map(|record| record.latest.attest.height),
        }
    });
    let nodes: Vec<_> = nodes.collect();
    let voters = || nodes.iter().filter(|node| node.role == "voter");
    Overview {
        network: context.network,
        label: context.label.clone(),
        leader_id,
        term,
        height,
        voters: voters().count(),
        voters_reachable: voters().filter(|node| node.reachable).count(),
        nodes,
    }
}

impl Node {
    fn full_name(&self) -> String {
        format!("{}/{}", self.organisation, self.name)
    }

    /// One word or two for people.
    fn state(&self) -> String {
        match self {
            Self { reachable: false, .. } => "unreachable".into(),
            Self { divergence, .. } if !divergence.is_empty() => "differs".into(),
            Self { catching_up_to: Some(height), .. } => format!("catching up to {height}"),
            Self { leader: true, .. } => "leader".into(),
            _ => "follows".into(),
        }
    }
}

impl Facts for Overview {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let leader = self.nodes.iter().find(|node| node.leader);
        let leader =
            leader.map_or_else(|| "none known".to_owned(), |node| format!("{} (id {})", node.full_name(), node.id));
        let mut table = Table::pairs();
        table.pair("network", format!("{} {}", self.label, self.network).trim_start());
        table.pair("leader", format!("{leader}, term {}", self.term));
        table.pair("height", self.height);
        table.pair("voters", format!("{} reachable of {}", self.voters_reachable, self.voters));
        table.write(out, 0)?;
        writeln!(out)?;
        let mut table =
            Table::new(["NODE", "ID", "ADDRESS", "IS", "SHALL BE", "HEIGHT", "MATCHED", "ATTESTED", "STATE"]);
        let number = |number: Option<u64>| number.map_or_else(|| "-".to_owned(), |number| number.to_string());
        for node in &self.nodes {
            table.row([
                node.full_name(),
                node.id.to_string(),
                node.address.clone(),
                node.role.clone(),
                node.wanted.to_string(),
                number(node.height),
                number(node.matched),
                number(node.attested),
                node.state(),
            ]);
        }
        table.write(out, 0)?;
        let told = |node: &Node, what: &str| printable(&format!("{}: {what}", node.full_name())).into_owned();
        for node in self.nodes.iter().filter(|node| !node.reachable) {
            writeln!(out, "{}", told(node, &node.reason))?;
        }
        for node in self.nodes.iter().filter(|node| !node.divergence.is_empty()) {
            writeln!(out, "{}", told(node, &node.divergence))?;
        }
        let majority = self.voters / 2 + 1;
        if self.voters_reachable < majority {
            writeln!(
                out,
                "only {} of {} voters answer, and {majority} are needed to order",
                self.voters_reachable, self.voters
            )?;
        }
        Ok(())
    }
}
