//! `network proposals|approve|withdraw`: what waits for approval.

use super::ask;
use super::decision::{Decided, joined, short, what};
use crate::answer;
use crate::failure::Failure;
use crate::output::{Facts, Output, Table, printable};
use crate::session::{MSP, Session};
use crate::time;
use bytes::Bytes;
use ledger::governance::{Decision, Proposal};
use serde::Serialize;
use std::io::{self, Write};

/// List what waits for the approval of organisations.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl network proposals")]
pub(crate) struct List {}

/// Approve a proposal for your organisation; for admins.
///
/// It is done in the block in which more than half of the organisations have approved.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl network approve 3f9a0c77c1d2")]
pub(crate) struct Approve {
    /// Id of the proposal, or its first 8 digits or more
    id: String,
}

/// Take a proposal of your organisation back, or your approval of another's; for admins.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl network withdraw 3f9a0c77c1d2")]
pub(crate) struct Withdraw {
    /// Id of the proposal, or its first 8 digits or more
    id: String,
}

pub(super) async fn run(session: &Session, output: &mut Output) -> Result<(), Failure> {
    let decisions = ask(session, "proposals", vec![], "the proposals").await?;
    output.show(&Standing { decisions, now: session.client.now() })
}

impl Approve {
    pub(super) async fn run(self, session: &Session, output: &mut Output) -> Result<(), Failure> {
        let done = session.call(MSP, "approve", vec![Bytes::from(self.id)]).await?;
        let decision: Decision = answer::parse(&done.response, "the decision")?;
        let action = decision.proposal.as_ref().map_or_else(String::new, |proposal| what(&proposal.action));
        output.show(&Decided { done: format!("approved and done: {action}"), decision })
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
            return writeln!(out, "nothing waits for approval");
        }
        let mut table = Table::new(["PROPOSAL", "WHAT", "BY", "APPROVED", "MISSING", "WAITS FOR", "ENDS"]);
        for decision in &self.decisions {
            let Some(proposal) = &decision.proposal else { continue };
            table.row([
                short(&proposal.id.to_string()).to_owned(),
                what(&proposal.action),
                proposal.by.clone(),
                joined(&proposal.approvals),
                decision.missing.to_string(),
                joined(&decision.pending),
                time::relative(proposal.expires, self.now),
            ]);
        }
        table.write(out, 0)
    }
}

/// The rest of a proposal.
#[derive(Serialize)]
struct Withdrawn(Proposal);

impl Facts for Withdrawn {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let Proposal { id, action, approvals, organisation, .. } = &self.0;
        let action = what(action);
        // The proposer's approval goes only with the whole proposal.
        let line = format!("withdrawn: {action} ({}), proposed by {organisation}", short(&id.to_string()));
        writeln!(out, "{}; approved by {}", printable(&line), printable(&joined(approvals)))
    }
}
