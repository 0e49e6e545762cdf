//! `network propose|proposals|approve|withdraw`: what waits for approval.

use super::change::decide;
use super::decision::{Decided, joined, node_role, short, what};
use super::json;
use crate::answer;
use crate::command::chaincode;
use crate::failure::Failure;
use crate::nodes::nodes;
use crate::output::{Facts, Output, Table, printable};
use crate::session::{MSP, Session};
use crate::time;
use bytes::Bytes;
use ledger::Call;
use ledger::msp::{Decision, NodeRecord, NodeRole, Proposal};
use ledger_base::rejection::Code;
use serde::Serialize;
use std::io::{self, Write};

/// List the proposals that wait for the approval of organisations.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl network proposals")]
pub(crate) struct List {}

/// Propose a call of a function that needs approval; for admins.
///
/// It is executed in the block with the last approval that is needed (`ledgerctl network quorums`). The proposal counts
/// as an approval of your organisation.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Example:
  ledgerctl network propose msp remove_organisation '{\"name\":\"Org3\"}'")]
pub(crate) struct Propose {
    #[command(flatten)]
    call: chaincode::Call,
}

/// Approve a proposal on behalf of your organisation; for admins.
///
/// The call is executed in the block with the last approval that is needed: more than half of the organisations, unless
/// the network has set another quorum (`ledgerctl network quorums`). If the call fails then, the proposal has failed.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl network approve 3f9a0c77c1d2")]
pub(crate) struct Approve {
    /// Id of the proposal, or at least its first 8 digits
    id: String,
}

/// Withdraw a proposal of your organisation, or your approval of another's; for admins.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl network withdraw 3f9a0c77c1d2")]
pub(crate) struct Withdraw {
    /// Id of the proposal, or at least its first 8 digits
    id: String,
}

pub(super) async fn run(session: &Session, output: &mut Output) -> Result<(), Failure> {
    let mut decisions: Vec<Decision> = session.list(MSP, "proposals").await?;
    decisions.sort_by_key(|decision| decision.proposal.as_ref().map(|proposal| (proposal.created, proposal.id)));
    output.show(&Standing { decisions, nodes: nodes(session).await?.nodes, now: session.client.now() })
}

impl Propose {
    pub(super) async fn run(self, session: &Session, output: &mut Output) -> Result<(), Failure> {
        let (chaincode, function, args) = self.call.read()?;
        let done = format!("{chaincode} {function} was executed");
        let call = json(&Call { chaincode, function, args })?;
        decide(session, output, "propose", call, done).await
    }
}

impl Approve {
    pub(super) async fn run(self, session: &Session, output: &mut Output) -> Result<(), Failure> {
        let done = session.call(MSP, "approve", vec![Bytes::from(self.id)]).await?;
        let decision: Decision = answer::parse(&done.response, "the decision")?;
        let action = decision.proposal.as_ref().map_or_else(String::new, |proposal| what(&proposal.call));
        Decided { done: format!("approved and executed: {action}"), decision }.show(output)
    }
}

impl Withdraw {
    pub(super) async fn run(self, session: &Session, output: &mut Output) -> Result<(), Failure> {
        let done = session.call(MSP, "withdraw", vec![Bytes::from(self.id)]).await?;
        output.show(&Withdrawn(answer::parse(&done.response, "the proposal")?))
    }
}

/// The proposals that stand.
struct Standing {
    decisions: Vec<Decision>,
    /// The nodes of the network, as they have registered.
    nodes: Vec<NodeRecord>,
    /// The network's clock, microseconds.
    now: u64,
}

impl Serialize for Standing {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.decisions.serialize(serializer)
    }
}

impl Facts for Standing {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        if self.decisions.is_empty() {
            return writeln!(out, "no proposal waits for approval");
        }
        let mut table = Table::new(["PROPOSAL", "WHAT", "BY", "APPROVED", "MISSING", "WAITS FOR", "ENDS"]);
        for decision in &self.decisions {
            let Some(proposal) = &decision.proposal else { continue };
            table.row([
                short(&proposal.id.to_string()).to_owned(),
                self.what(&proposal.call),
                proposal.by.clone(),
                joined(&proposal.approvals),
                missing(decision),
                if proposal.failed.is_some() { "-".to_owned() } else { joined(&decision.pending) },
                time::relative(proposal.expires, self.now),
            ]);
        }
        table.write(out, 0)
    }
}

impl Standing {
    /// A call in words. A node that shall order comes with its address, which all nodes will dial.
    fn what(&self, call: &Call) -> String {
        let orders = node_role(call).filter(|(_, _, role)| *role != NodeRole::Removed);
        let node = orders.and_then(|(id, ..)| self.nodes.iter().find(|node| node.id == id));
        node.map_or_else(|| what(call), |node| format!("{}, at {}", what(call), node.address))
    }
}

/// How many approvals are missing, or why there is no use in more.
fn missing(decision: &Decision) -> String {
    let failed = decision.proposal.as_ref().and_then(|proposal| proposal.failed);
    let code = |code| Code::from_number(code).map_or_else(|| format!("code {code}"), |code| code.to_string());
    failed.map_or_else(|| decision.missing.to_string(), |failed| format!("failed: {}", code(failed.code)))
}

/// The rest of a proposal.
#[derive(Serialize)]
struct Withdrawn(Proposal);

impl Facts for Withdrawn {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let Proposal { id, call, approvals, organisation, .. } = &self.0;
        let action = what(call);
        // The proposer's approval goes only with the whole proposal.
        let line = format!("withdrawn: {action} ({}), proposed by {organisation}", short(&id.to_string()));
        writeln!(out, "{}; approved by {}", printable(&line), printable(&joined(approvals)))
    }
}
