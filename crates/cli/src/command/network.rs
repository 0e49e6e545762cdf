//! `network …`: who belongs to the network, who orders, and what the organisations decide together.

mod add_org;
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
use crate::cli::Global;
use crate::failure::Failure;
use crate::output::Output;
use crate::session::{MSP, Session};
use bytes::Bytes;
use ledger::msp::{NodeRecord, NodeRole, Nodes};
use ledger_api::Context;
use ledger_api::context::msps_of;
use ledger_base::rejection::{Code, Rejection};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::sync::Arc;

/// See and change who belongs to the network and who orders.
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
    Rules(rules::Rules),
    Approve(proposals::Approve),
    Withdraw(proposals::Withdraw),
}

impl Network {
    pub(crate) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let session = &Session::open(global).await?;
        match self {
            Self::Status(command) => command.run(session, output).await,
            Self::Nodes(_) => output.show(&nodes::Known(nodes(session).await?)),
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
            Self::Proposals(_) => proposals::run(session, output).await,
            Self::Approve(command) => command.run(session, output).await,
            Self::Withdraw(command) => command.run(session, output).await,
        }
    }
}

/// The nodes of the network.
pub(super) async fn nodes(session: &Session) -> Result<Nodes, Rejection> {
    ask(session, "nodes", vec![], "the nodes").await
}

/// The context with the organisations of now: some may have joined since it was made, and their nodes answer too.
pub(super) async fn current(session: &Session) -> Result<Context, Rejection> {
    let msps = Arc::new(msps_of(&session.client.network().await?.organisations)?);
    Ok(Context { msps, ..session.context().clone() })
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
        .map_err(|error| Rejection::new(Code::Internal, "an argument cannot be written").found(error.to_string()))?;
    Ok(vec![text.into()])
}

/// The node that somebody means by its id, its name, or organisation and name; those that were removed are past.
pub(super) fn find<'a>(nodes: &'a [NodeRecord], meant: &str) -> Result<&'a NodeRecord, Rejection> {
    let live = || nodes.iter().filter(|node| node.role != NodeRole::Removed);
    let is_meant = |node: &&NodeRecord| node.name == meant || node.full_name() == meant || node.id.to_string() == meant;
    let names = || live().map(NodeRecord::full_name).collect::<Vec<_>>().join(", ");
    let mut found = live().filter(is_meant);
    match (found.next(), found.next()) {
        (Some(node), None) => Ok(node),
        (Some(_), Some(_)) => Err(Rejection::new(Code::BadArgument, format!("several nodes are called {meant:?}"))
            .found(live().filter(is_meant).map(NodeRecord::full_name).collect::<Vec<_>>().join(", "))
            .wanted("ORGANISATION/NAME, or the id")),
        _ => Err(Rejection::new(Code::NotFound, "the network has no such node")
            .found(format!("{meant:?}"))
            .wanted(format!("one of {}", names()))
            .next("ledgerctl network nodes")),
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    fn node(id: u64, organisation: &str, name: &str, role: NodeRole) -> NodeRecord {
        NodeRecord::new(id, [organisation, name], &format!("{name}:1"), role)
    }

    #[test]
    fn nodes_are_meant_by_id_or_name_and_removed_ones_never() {
        let nodes = [
            node(1, "Org1", "a", NodeRole::Removed),
            node(2, "Org1", "a", NodeRole::Learner),
            node(3, "Org1", "b", NodeRole::Voter),
            node(4, "Org2", "b", NodeRole::Voter),
        ];
        for (meant, id) in [("a", 2), ("Org1/a", 2), ("2", 2), ("Org2/b", 4)] {
            assert_eq!(find(&nodes, meant).unwrap().id, id, "{meant}");
        }
        assert_eq!(find(&nodes, "b").unwrap_err().found, "Org1/b, Org2/b");
        let unknown = find(&nodes, "1").unwrap_err();
        assert!(unknown.code == Code::NotFound && unknown.wanted.contains("Org1/a, Org1/b, Org2/b"), "{unknown}");
    }
}
