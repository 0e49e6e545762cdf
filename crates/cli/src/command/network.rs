//! `network …`: who belongs to the network, who orders, and what the organisations decide together.

mod add_org;
mod certificates;
mod change;
mod decision;
mod invite;
mod nodes;
mod organisations;
mod proposals;
mod quorums;
mod rules;
pub(crate) mod status;

use crate::answer;
use crate::failure::Failure;
use crate::global::Global;
use crate::output::Output;
use crate::session::{MSP, Session};
use bytes::Bytes;
use ledger_base::rejection::{Code, Rejection};
use serde::Serialize;
use serde::de::DeserializeOwned;

/// Show and change the members of the network and its voters.
#[derive(Debug, clap::Subcommand)]
pub(crate) enum Network {
    Status(status::Status),
    Nodes(nodes::List),
    Organisations(organisations::List),
    Invite(invite::Invite),
    AddOrg(add_org::AddOrg),
    Promote(change::Promote),
    Demote(change::Demote),
    Remove(change::Remove),
    RemoveOrganisation(change::RemoveOrganisation),
    Transfer(change::Transfer),
    Proposals(proposals::List),
    Propose(proposals::Propose),
    Quorums(quorums::Quorums),
    Certificates(certificates::Certificates),
    Rules(rules::Rules),
    Approve(proposals::Approve),
    Withdraw(proposals::Withdraw),
}

impl Network {
    pub(crate) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        if let Self::AddOrg(command) = &self
            && let Some(checked) = command.check(global, output)
        {
            return checked;
        }
        let session = &Session::open(global).await?;
        match self {
            Self::Status(command) => command.run(session, output).await,
            Self::Nodes(_) => output.show(&nodes::Known(crate::nodes::nodes(session).await?)),
            Self::Organisations(_) => organisations::run(session, output).await,
            Self::Invite(command) => command.run(session, output).await,
            Self::AddOrg(command) => command.run(session, global, output).await,
            Self::Promote(command) => command.run(session, output).await,
            Self::Demote(command) => command.run(session, output).await,
            Self::Remove(command) => command.run(session, output).await,
            Self::RemoveOrganisation(command) => command.run(session, output).await,
            Self::Transfer(command) => command.run(session, output).await,
            Self::Rules(command) => command.run(session, output).await,
            Self::Propose(command) => command.run(session, output).await,
            Self::Quorums(command) => command.run(session, output).await,
            Self::Certificates(command) => command.run(session, output).await,
            Self::Proposals(_) => proposals::run(session, output).await,
            Self::Approve(command) => command.run(session, output).await,
            Self::Withdraw(command) => command.run(session, output).await,
        }
    }
}

/// The answer of a query of the chaincode `msp`.
async fn ask<T: DeserializeOwned>(
    session: &Session,
    function: &str,
    args: Vec<Bytes>,
    what: &str,
) -> Result<T, Rejection> {
    answer::parse(&session.ask(MSP, function, args).await?, what)
}

/// One argument in JSON.
fn json(value: &impl Serialize) -> Result<Vec<Bytes>, Rejection> {
    let text = serde_json::to_vec(value)
        .map_err(|error| Rejection::new(Code::Internal, "an argument cannot be encoded").found(error.to_string()))?;
    Ok(vec![text.into()])
}
