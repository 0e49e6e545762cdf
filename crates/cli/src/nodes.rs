//! The nodes of the network, and those that hold the CA key of an organisation.

use crate::answer;
use crate::session::{MSP, Session};
use ledger::msp::{CarrierRecord, NodeRecord, NodeRole, Nodes};
use ledger_api::Context;
use ledger_api::context::msps_of;
use ledger_base::rejection::{Code, Rejection};
use std::sync::Arc;

/// The nodes of the network.
pub(crate) async fn nodes(session: &Session) -> Result<Nodes, Rejection> {
    answer::parse(&session.ask(MSP, "nodes", vec![]).await?, "the nodes")
}

/// The context with the organisations of now: some may have joined since it was made, and their nodes answer too.
pub(crate) async fn current(session: &Session) -> Result<Context, Rejection> {
    let msps = Arc::new(msps_of(&session.client.network().await?.organisations)?);
    Ok(Context { msps, ..session.context().clone() })
}

/// Every node that carries a CA.
pub(crate) async fn carriers(session: &Session) -> Result<Vec<CarrierRecord>, Rejection> {
    answer::parse(&session.ask(MSP, "carriers", vec![]).await?, "the nodes that carry a CA")
}

/// The node that somebody means by its id, its name, or organisation and name; those that were removed are past.
pub(crate) fn find<'a>(nodes: &'a [NodeRecord], meant: &str) -> Result<&'a NodeRecord, Rejection> {
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
