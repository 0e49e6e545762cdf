//! Giving the leadership to another node, because an admin asks for it.

use crate::ordering::Ordering;
use ledger_api::v1::{TransferLeadershipResponse, Verdict};
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::Identity;
use ledger_raft::RoleChange;
use std::collections::BTreeSet;
use std::time::Duration;

/// Longest time that the other node has to take over.
const PATIENCE: Duration = Duration::from_secs(2);

pub(super) async fn transfer_leadership(ordering: &Ordering, caller: &Identity, to: u64) -> TransferLeadershipResponse {
    match transfer(ordering, caller, to).await {
        Ok(RoleChange { leader, term, .. }) => TransferLeadershipResponse {
            verdict: Some(Verdict::default()),
            leader_id: leader.unwrap_or_default(),
            term,
        },
        Err(reason) => TransferLeadershipResponse { verdict: Some((&reason).into()), leader_id: 0, term: 0 },
    }
}

async fn transfer(ordering: &Ordering, caller: &Identity, to: u64) -> Result<RoleChange, Rejection> {
    if caller.role != ledger_identity::Role::Admin {
        return Err(Rejection::new(Code::NotAdmin, format!("{} may not transfer the leadership", caller.id()))
            .found(format!("role {}", caller.role))
            .wanted("role admin"));
    }
    let members = ordering.directory.members();
    let voting: Vec<_> = members.iter().filter(|member| member.votes()).collect();
    if !voting.iter().any(|member| member.organisation == caller.organisation) {
        let wanted: BTreeSet<_> = voting.iter().map(|member| member.organisation.as_str()).collect();
        return Err(Rejection::new(Code::NotAdmin, format!("{} may not transfer the leadership", caller.id()))
            .found(format!("{}, which has no voter", caller.organisation))
            .wanted(format!("an admin of {}", wanted.into_iter().collect::<Vec<_>>().join(" or ")))
            .next("ask an admin of an organisation with a voter"));
    }
    let changed = ordering.slot.handle()?.transfer_on_demand(to, PATIENCE).await?;
    let leader = changed.leader.map(|leader| ordering.directory.name(leader));
    tracing::info!(by = %caller.id(), leader, "leadership transfer requested by an admin");
    Ok(changed)
}
