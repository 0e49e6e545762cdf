//! `network promote|demote|remove|remove-organisation|transfer`.

use super::decision::Decided;
use super::json;
use crate::answer;
use crate::confirm::confirm;
use crate::failure::Failure;
use crate::nodes::{carriers, current, find, nodes};
use crate::output::{Facts, Output};
use crate::session::{MSP, Session};
use bytes::Bytes;
use ledger::msp::{CarrierRecord, NodeRecord, NodeRole, SetNodeRole};
use ledger_base::durable;
use ledger_base::rejection::{Code, Rejection};
use ledger_light::Misbehaviour;
use ledger_light::lie::MISBEHAVIOUR_BYTES_MAX;
use serde::Serialize;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// Make a node a voter; for admins.
///
/// Needs the approval of more than half of the organisations. The leader admits the node once its log is up to date.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl network promote Org2/node2")]
pub(crate) struct Promote {
    /// The node: its name, ORGANISATION/NAME, or its id
    node: String,
}

/// Make a voter a learner; for admins.
///
/// For nodes of your own organisation this takes effect at once; for others it needs approval.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl network demote node2")]
pub(crate) struct Demote {
    /// The node: its name, ORGANISATION/NAME, or its id
    node: String,
}

/// Remove a node from the network; for admins.
///
/// For nodes of your own organisation this takes effect at once; for others it needs approval. The id is never reused:
/// to bring the machine back, invite it as a new node.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Example:
  ledgerctl network remove node2
  ledgerctl network remove node2 --i-mean-it
  ledgerctl network remove Org2/node2 --proof 00000000000000000104-2.lie")]
pub(crate) struct Remove {
    /// The node: its name, ORGANISATION/NAME, or its id
    node: String,
    /// Do not ask if it is the last node of an organisation, or the last one with its CA key
    #[arg(long)]
    i_mean_it: bool,
    /// Proof that the node lied: approval by its organisation is then not needed. Nodes store proofs in certificates/
    /// of their data directory
    #[arg(long, value_name = "FILE")]
    proof: Option<PathBuf>,
}

/// Remove an organisation with its nodes and robots; for admins, with approval.
///
/// Its certificates become invalid, and the grants and permissions of its members end in the same block.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl network remove-organisation Org3")]
pub(crate) struct RemoveOrganisation {
    /// The organisation
    name: String,
}

/// Transfer the leadership to another voter; for admins.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl network transfer Org2/node2\n  ledgerctl network transfer")]
pub(crate) struct Transfer {
    /// The voter: its name, ORGANISATION/NAME, or its id; by default the one with the newest log
    node: Option<String>,
}

impl Promote {
    pub(super) async fn run(self, session: &Session, output: &mut Output) -> Result<(), Failure> {
        let soon = "becomes a voter as soon as its log is up to date; see ledgerctl network status";
        set(session, output, (&self.node, None), NodeRole::Voter, soon).await
    }
}

impl Demote {
    pub(super) async fn run(self, session: &Session, output: &mut Output) -> Result<(), Failure> {
        set(session, output, (&self.node, None), NodeRole::Learner, "becomes a learner").await
    }
}

impl Remove {
    pub(super) async fn run(self, session: &Session, output: &mut Output) -> Result<(), Failure> {
        let proof = self.proof.as_deref().map(read_proof).transpose()?;
        let nodes = nodes(session).await?.nodes;
        let lost = lost(find(&nodes, &self.node)?, &nodes, &carriers(session).await?);
        confirm(&format!("removing {}", self.node), &lost, self.i_mean_it)?;
        set(session, output, (&self.node, proof), NodeRole::Removed, "leaves the network").await
    }
}

/// The proof of a lie in a file, in hexadecimal.
fn read_proof(file: &Path) -> Result<String, Rejection> {
    let bytes = durable::read(file, MISBEHAVIOUR_BYTES_MAX)?;
    let proof = Misbehaviour::from_bytes(&bytes)?;
    if !proof.is_lie() {
        return Err(Rejection::new(Code::BadArgument, "the file does not prove a lie")
            .found("two different results of one block: the machine or the state of that node is faulty")
            .wanted("a file HEIGHT-NODE.lie, TERM-NODE.votes or TERM-NODE.heads in certificates/ of a node"));
    }
    Ok(hex::encode(bytes))
}

/// The losses of an organisation after this node has left, a sentence each.
fn lost(node: &NodeRecord, nodes: &[NodeRecord], carriers: &[CarrierRecord]) -> Vec<String> {
    let organisation = &node.organisation;
    let live = nodes.iter().filter(|other| other.role != NodeRole::Removed && other.organisation == *organisation);
    let mut lost = Vec::new();
    if live.count() == 1 {
        lost.push(format!("{} is the last node of {organisation}, which then has no node", node.full_name()));
    }
    let carried = carriers.iter().filter(|carrier| carrier.full_name() == node.full_name());
    for CarrierRecord { organisation, .. } in carried {
        if carriers.iter().filter(|other| other.organisation == *organisation).count() == 1 {
            lost.push(format!(
                "no other node holds the CA key of {organisation}: without a backup, enrolment and renewal in \
                 {organisation} end permanently (ledgerctl ca carry NODE first)"
            ));
        }
    }
    lost
}

async fn set(
    session: &Session,
    output: &mut Output,
    (meant, proof): (&str, Option<String>),
    role: NodeRole,
    becomes: &str,
) -> Result<(), Failure> {
    let nodes = nodes(session).await?.nodes;
    let node = find(&nodes, meant)?;
    let set = SetNodeRole { id: Some(node.id), organisation: None, name: None, role, proof };
    let done = format!("node {} (id {}) {becomes}", node.full_name(), node.id);
    decide(session, output, "set_node_role", json(&set)?, done).await
}

impl RemoveOrganisation {
    pub(super) async fn run(self, session: &Session, output: &mut Output) -> Result<(), Failure> {
        let done = format!("organisation {} was removed, with its nodes and robots", self.name);
        let args = json(&serde_json::json!({ "name": self.name }))?;
        decide(session, output, "remove_organisation", args, done).await
    }
}

/// Calls a function that may need approval, and tells what came of it.
pub(super) async fn decide(
    session: &Session,
    output: &mut Output,
    function: &str,
    args: Vec<Bytes>,
    done: String,
) -> Result<(), Failure> {
    let called = session.call(MSP, function, args).await?;
    Decided { decision: answer::parse(&called.response, "the decision")?, done }.show(output)
}

/// The present leader.
#[derive(Serialize)]
struct Leads {
    leader_id: u64,
    leader: String,
    term: u64,
}

impl Facts for Leads {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        writeln!(out, "node {} (id {}) leads in term {}", self.leader, self.leader_id, self.term)
    }
}

impl Transfer {
    pub(super) async fn run(self, session: &Session, output: &mut Output) -> Result<(), Failure> {
        let nodes = nodes(session).await?.nodes;
        let id = self.node.as_deref().map(|meant| find(&nodes, meant)).transpose()?.map_or(0, |node| node.id);
        // The leader itself is asked, and may be of an organisation that has joined since.
        let session = Session::connect(current(session).await?).await?;
        let leadership = session.client.transfer_leadership(id).await.map_err(|refused: Rejection| {
            if refused.advice().is_empty() {
                refused.next("ledgerctl network status shows the voters")
            } else {
                refused
            }
        })?;
        let leader = nodes.iter().find(|node| node.id == leadership.leader).map_or_else(String::new, |n| n.full_name());
        output.show(&Leads { leader_id: leadership.leader, leader, term: leadership.term })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_node_and_the_last_carrier_of_a_ca_are_told_from_others() {
        let node = |name: &str, organisation: &str| NodeRecord {
            id: 1,
            name: name.into(),
            organisation: organisation.into(),
            address: "h:1".into(),
            role: NodeRole::Voter,
            speaks: None,
        };
        let carrier = |organisation: &str, node: &str| CarrierRecord {
            organisation: organisation.into(),
            node_organisation: "Org1".into(),
            node: node.into(),
            since: 0,
            copied: None,
        };
        let (one, two, other) = (node("node1", "Org1"), node("node2", "Org1"), node("node1", "Org2"));
        let nodes = [one.clone(), two.clone(), other.clone()];
        let both = [carrier("Org1", "node1"), carrier("Org1", "node2")];
        assert!(lost(&one, &nodes, &both).is_empty());
        assert_eq!(lost(&one, &nodes, &both[..1]).len(), 1, "the CA");
        assert!(lost(&two, &nodes, &both[..1]).is_empty());
        assert_eq!(lost(&other, &nodes, &both).len(), 1, "the last node of Org2");
        // It carries the CA of an organisation that runs no node, too.
        assert_eq!(
            lost(&one, std::slice::from_ref(&one), &[carrier("Org1", "node1"), carrier("Org3", "node1")]).len(),
            3
        );
    }
}
