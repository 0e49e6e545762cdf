//! Giving the leadership to another node: when an admin asks for it, and before a leader stops, so that the others need
//! not wait for an election timeout to notice.
//!
//! A transfer costs everybody a pause. So a leader hands over on demand only after it has led for [`TENURE_MIN`], and
//! tries so once in that time. That bounds the transfers of the whole network, whoever demands them.

use super::{Handle, Reign};
use ledger_base::rejection::{Code, Rejection};
use ledger_raft::{Input, Role, RoleChange, Status, successor};
use std::sync::PoisonError;
use std::time::{Duration, Instant};

/// Time that a node leads before it hands over on demand, and time between two demands.
pub(crate) const TENURE_MIN: Duration = Duration::from_secs(10);

impl Handle {
    /// Makes another voter the leader, without a limit: for a leader that stops. Otherwise as
    /// [`Handle::transfer_on_demand`].
    ///
    /// # Errors
    /// As [`Handle::transfer_on_demand`], without [`Code::Overloaded`] for demands that come too often.
    pub(crate) async fn transfer(&self, to: u64, patience: Duration) -> Result<RoleChange, Rejection> {
        let status = self.status();
        match self.heir(&status, to)? {
            Some(to) => self.hand_over(to, patience).await,
            None => Ok(status.role),
        }
    }

    /// Makes another voter the leader: this one, or for 0 the one that has caught up most. Answers who leads then; at
    /// once, if it is that one already.
    ///
    /// # Errors
    /// [`Code::NoLeader`] if this node does not lead, [`Code::BadArgument`] if the other is no voter.
    /// [`Code::Overloaded`] before this node has led for [`TENURE_MIN`]. [`Code::Timeout`] if the other did not take over
    /// within `patience`; then this node may go on leading.
    pub(crate) async fn transfer_on_demand(&self, to: u64, patience: Duration) -> Result<RoleChange, Rejection> {
        let status = self.status();
        let Some(to) = self.heir(&status, to)? else { return Ok(status.role) };
        let since = self.role.borrow().since;
        {
            let mut demanded = self.demanded.lock().unwrap_or_else(PoisonError::into_inner);
            check_rest(since.max(demanded.unwrap_or(since)).elapsed())?;
            *demanded = Some(Instant::now());
        }
        self.hand_over(to, patience).await
    }

    /// The voter that shall lead; none if this node leads and is the one.
    fn heir(&self, status: &Status, to: u64) -> Result<Option<u64>, Rejection> {
        if status.role.role != Role::Leader {
            return Err(Rejection::new(
                Code::NoLeader,
                "this node is not the leader, so it cannot transfer the \
                                                       leadership",
            )
            .found(status.role.leader.map_or("there is no leader".into(), |leader| format!("node {leader} leads")))
            .next("ask the leader"));
        }
        if to == status.id {
            return Ok(None);
        }
        match to {
            0 => successor(status).map(Some).ok_or_else(|| {
                Rejection::new(Code::NoLeader, "no other voter can become the leader now")
                    .next("make another node a voter first, or wait until one is reachable")
            }),
            to if status.membership.voters.contains(&to) => Ok(Some(to)),
            to => {
                Err(Rejection::new(Code::BadArgument, format!("node {to} cannot become the leader: it is not a voter"))
                    .wanted(format!("one of {:?}", status.membership.voters)))
            }
        }
    }

    async fn hand_over(&self, to: u64, patience: Duration) -> Result<RoleChange, Rejection> {
        let mut role = self.role.clone();
        if !self.input(Input::TransferLeadership { to }) {
            return Err(Rejection::new(Code::Overloaded, "the node is stopping or overloaded").next("ask again later"));
        }
        let elsewhere = |Reign { change, .. }: &Reign| change.role != Role::Leader && change.leader.is_some();
        match tokio::time::timeout(patience, role.wait_for(elsewhere)).await {
            Ok(Ok(reign)) => Ok(reign.change),
            Ok(Err(_)) => Err(Rejection::new(Code::ShuttingDown, "the node is stopping")),
            Err(_) => Err(Rejection::new(
                Code::Timeout,
                format!(
                    "node {to} did not become the leader within \
                                                                 {patience:?}"
                ),
            )
            .next("check with ledgerctl network status that it is reachable and up to date")),
        }
    }
}

/// Refuses a demand that comes so soon after the last change or the last demand.
fn check_rest(rested: Duration) -> Result<(), Rejection> {
    let left = TENURE_MIN.saturating_sub(rested);
    if left.is_zero() {
        return Ok(());
    }
    Err(Rejection::new(Code::Overloaded, "a leadership transfer was requested a moment ago")
        .found(format!("{:.1} s ago", rested.as_secs_f64()))
        .wanted(format!("at most one request in {} s in the whole network", TENURE_MIN.as_secs()))
        .next(format!("try again in {:.1} s", left.as_secs_f64() + 0.1)))
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn a_demand_that_comes_too_soon_names_the_limit_and_when_to_ask_again() {
        assert_eq!(check_rest(TENURE_MIN), Ok(()));
        let refused = check_rest(Duration::from_millis(2500)).unwrap_err();
        assert_eq!(refused.code, Code::Overloaded);
        assert!(refused.wanted.contains("in 10 s") && refused.advice() == "try again in 7.6 s", "{refused}");
    }
}
