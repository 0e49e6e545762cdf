//! Giving the leadership to another node, because an admin asks for it.

use crate::peers::reachability::Reachability;
use ledger_api::v1::{TransferLeadershipResponse, Verdict};
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::Identity;
use ledger_raft::{Role, RoleChange};
use std::collections::BTreeSet;
use std::time::{Duration, Instant};

/// Longest time that the other node has to take over.
const PATIENCE: Duration = Duration::from_secs(2);
/// As long when the node stops.
const HANDOVER_TIME_MAX: Duration = Duration::from_secs(1);
/// Pause before it is tried again.
const HANDOVER_PAUSE: Duration = Duration::from_millis(20);

impl Reachability {
    pub(super) async fn transfer_leadership(&self, caller: &Identity, to: u64) -> TransferLeadershipResponse {
        match self.transfer(caller, to).await {
            Ok(RoleChange { leader, term, .. }) => TransferLeadershipResponse {
                verdict: Some(Verdict::default()),
                leader_id: leader.unwrap_or_default(),
                term,
            },
            Err(reason) => TransferLeadershipResponse { verdict: Some((&reason).into()), leader_id: 0, term: 0 },
        }
    }

    /// A node that stops and leads hands over first, so that the others need not wait until they miss it. Calls that
    /// are under way go to the next leader.
    pub(crate) async fn hand_over(&self) {
        let Ok(orderer) = self.slot.handle() else { return };
        let deadline = Instant::now() + HANDOVER_TIME_MAX;
        loop {
            let status = orderer.status();
            if status.role.role != Role::Leader || status.membership.voters.len() < 2 {
                return;
            }
            let left = deadline.saturating_duration_since(Instant::now());
            match orderer.transfer(0, left).await {
                Ok(RoleChange { leader, .. }) => {
                    let leader = leader.map(|leader| self.directory.name(leader));
                    return tracing::info!(leader, "handed over the leadership");
                }
                Err(reason) if deadline <= Instant::now() + HANDOVER_PAUSE => {
                    return tracing::warn!(code = reason.code.name(), %reason, "could not hand over; the others elect a leader");
                }
                // Perhaps the others have just come back, and are heard of in a moment.
                Err(_) => tokio::time::sleep(HANDOVER_PAUSE).await,
            }
        }
    }

    async fn transfer(&self, caller: &Identity, to: u64) -> Result<RoleChange, Rejection> {
        if caller.role != ledger_identity::Role::Admin {
            return Err(Rejection::new(Code::NotAdmin, format!("{} may not choose the leader", caller.id()))
                .found(format!("role {}", caller.role))
                .wanted("role admin"));
        }
        let members = self.directory.members();
        let voting: Vec<_> = members.iter().filter(|member| member.votes()).collect();
        if !voting.iter().any(|member| member.organisation == caller.organisation) {
            let wanted: BTreeSet<_> = voting.iter().map(|member| member.organisation.as_str()).collect();
            return Err(Rejection::new(Code::NotAdmin, format!("{} may not choose the leader", caller.id()))
                .found(format!("{}, which has no voter", caller.organisation))
                .wanted(format!("an admin of {}", wanted.into_iter().collect::<Vec<_>>().join(" or ")))
                .next("ask one of them; an organisation that orders decides who leads"));
        }
        let changed = self.slot.handle()?.transfer_on_demand(to, PATIENCE).await?;
        let leader = changed.leader.map(|leader| self.directory.name(leader));
        tracing::info!(by = %caller.id(), leader, "an admin has chosen the leader");
        Ok(changed)
    }
}
