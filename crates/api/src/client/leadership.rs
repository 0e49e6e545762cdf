//! Choosing who leads.

use super::Client;
use super::retry::RETRY_AFTER;
use super::uplink::Uplink;
use crate::report::accepted;
use crate::v1;
use ledger_base::rejection::{Code, Rejection};
use std::time::Instant;
use tokio::time::sleep;

/// The leader.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Leadership {
    /// The leader's id.
    pub leader: u64,
    /// Its term.
    pub term: u64,
}

impl Client {
    /// Makes another voter the leader: this one, or for 0 the one that has caught up most. Asks the present leader,
    /// wherever this client is connected. For admins of organisations that have a voter.
    ///
    /// # Errors
    /// [`Code::NotAdmin`]; [`Code::Overloaded`] if the leader has led for a moment only, with when to ask again;
    /// [`Code::BadArgument`] if the node is no voter; [`Code::Timeout`] if it did not take over;
    /// [`Code::NoLeader`] if no leader was found before the deadline.
    pub async fn transfer_leadership(&self, to: u64) -> Result<Leadership, Rejection> {
        let deadline = Instant::now() + self.session.options.deadline;
        loop {
            let refused = match self.transfer_once(to).await {
                Err(refused) if matches!(refused.code, Code::NoLeader | Code::Unreachable) => refused,
                done => return done,
            };
            if deadline <= Instant::now() + RETRY_AFTER {
                return Err(refused);
            }
            sleep(RETRY_AFTER).await;
        }
    }

    async fn transfer_once(&self, to: u64) -> Result<Leadership, Rejection> {
        let status = self.status().await?;
        if to != 0 && status.leader_id == to {
            return Ok(Leadership { leader: to, term: status.term });
        }
        let leader = status.peers.into_iter().find(|peer| peer.node_id == status.leader_id);
        let asked = match leader {
            // The leader is another node than the one that this client is connected to.
            Some(leader) => {
                let credentials = self.credentials.as_ref().clone();
                Self::connect_with(vec![leader.address], credentials, self.session.options).await?
            }
            None => self.clone(),
        };
        let request = v1::TransferLeadershipRequest { node_id: to };
        let ask = |up: Uplink| async move { up.gateway().transfer_leadership(request).await };
        let answer = asked.ask(ask, |_| Ok(())).await?;
        accepted(answer.verdict.as_ref())?;
        Ok(Leadership { leader: answer.leader_id, term: answer.term })
    }
}
