//! Giving the leadership to another node: when an admin asks for it, and before a leader stops, so that the others need
//! not wait for an election timeout to notice.

use super::Handle;
use ledger_raft::{Input, Role, RoleChange, successor};
use ledger_rejection::{Code, Rejection};
use std::time::Duration;

impl Handle {
    /// Makes another voter the leader: this one, or for 0 the one that has caught up most. Answers who leads then; at
    /// once, if it is that one already.
    ///
    /// # Errors
    /// [`Code::NoLeader`] if this node does not lead, [`Code::BadArgument`] if the other is no voter,
    /// [`Code::Timeout`] if it did not take over within `patience`; then this node may go on leading.
    pub(crate) async fn transfer(&self, to: u64, patience: Duration) -> Result<RoleChange, Rejection> {
        let status = self.status();
        if status.role.role != Role::Leader {
            return Err(Rejection::new(Code::NoLeader, "this node does not lead, so it cannot hand over")
                .found(status.role.leader.map_or("no leader is known".into(), |leader| format!("node {leader} leads")))
                .next("ask the leader"));
        }
        if to == status.id {
            return Ok(status.role);
        }
        let to = match to {
            0 => successor(&status).ok_or_else(|| {
                Rejection::new(Code::NoLeader, "there is no other voter that could lead now")
                    .next("make another node a voter first, or wait until one is reachable")
            })?,
            to if status.membership.voters.contains(&to) => to,
            to => {
                return Err(Rejection::new(Code::BadArgument, format!("node {to} cannot lead, as it is not a voter"))
                    .wanted(format!("one of {:?}", status.membership.voters)));
            }
        };
        let mut role = self.role.clone();
        if !self.input(Input::TransferLeadership { to }) {
            return Err(Rejection::new(Code::Overloaded, "the node is stopping or flooded").next("ask again later"));
        }
        let elsewhere = |change: &RoleChange| change.role != Role::Leader && change.leader.is_some();
        match tokio::time::timeout(patience, role.wait_for(elsewhere)).await {
            Ok(Ok(change)) => Ok(*change),
            Ok(Err(_)) => Err(Rejection::new(Code::ShuttingDown, "the node is stopping")),
            Err(_) => Err(Rejection::new(Code::Timeout, format!("node {to} did not take over within {patience:?}"))
                .next("see with ledgerctl network status whether it is reachable and has caught up")),
        }
    }
}
