//! Requests to the engine besides ordering: reads, transfers of leadership, changes of members.

use super::Engine;
use crate::interface::{Input, Output};
use crate::message::convert::proposal;
use ledger::members::MembershipChange;
use ledger_base::rejection::{Code, Rejection};
use ledger_storage::entry::EntryKind;

/// Length of the name of a read.
pub(super) const READ_NAME_BYTES: usize = 24;
/// Election timeouts to rest after a transfer of leadership, before the planner tries again: each attempt stops the
/// ordering, for an election timeout if the target does not take over.
const TRANSFER_REST_TIMEOUTS: usize = 10;
/// Reads that wait for a majority to confirm the leader.
pub(super) const READS_PENDING_MAX: usize = 4096;

impl Engine {
    /// Names of reads: node, start, the caller's context. A late answer to a read of an earlier start must not
    /// answer one of this start.
    pub(super) fn read_name(&self, context: u64) -> Vec<u8> {
        [self.config.id, self.config.seed, context].iter().flat_map(|part| part.to_be_bytes()).collect()
    }

    /// The context in the name of a read, if it is of this start of this node. Entries that the leader has only
    /// appended do not count.
    pub(super) fn read_context(&self, name: &[u8]) -> Option<u64> {
        let (name, _) = name.split_at_checked(READ_NAME_BYTES)?;
        let (_, context) = name.split_at_checked(16)?;
        let context = u64::from_be_bytes(context.try_into().ok()?);
        (self.read_name(context) == name).then_some(context)
    }

    pub(super) fn read_index(&mut self, context: u64, out: &mut Vec<Output>) {
        let raft = &self.raw.raft;
        let reason = if self.leader().is_none() {
            Rejection::new(Code::NoLeader, "no leader is known, so no node can confirm a read")
        } else if self.is_leader() && !raft.commit_to_current_term() {
            Rejection::new(Code::NoLeader, "the leader is new and has committed nothing yet")
        } else if raft.pending_read_count() >= READS_PENDING_MAX {
            Rejection::new(Code::Overloaded, "too many reads wait for confirmation")
                .found(raft.pending_read_count().to_string())
                .wanted(format!("at most {READS_PENDING_MAX}"))
        } else {
            let name = self.read_name(context);
            return self.raw.read_index(name);
        };
        out.push(Output::Refused { input: Box::new(Input::ReadIndex { context }), reason });
    }

    /// Transfers of leadership and changes of members: both only by a leader that is ready to order.
    pub(super) fn administer(&mut self, input: Input, out: &mut Vec<Output>) {
        let result = if let Input::TransferLeadership { to } = &input
            && self.is_leader()
        {
            self.transfer(*to)
        } else if !self.may_propose() {
            Err(Rejection::new(Code::NoLeader, "this node is not the leader, or not ready to order")
                .found(format!("leader {:?}", self.told.leader)))
        } else {
            match &input {
                Input::ChangeMembership(change) => self.change_membership(change),
                _ => Ok(()),
            }
        };
        if let Err(reason) = result {
            out.push(Output::Refused { input: Box::new(input), reason });
        }
    }

    /// The crate sends the target what it lacks, then tells it to stand for election at once; it gives up after an
    /// election timeout. A target that does not answer would cost that time for nothing, so it is refused.
    fn transfer(&mut self, to: u64) -> Result<(), Rejection> {
        let raft = &self.raw.raft;
        let refused = match raft.lead_transferee {
            _ if !self.membership.voters.contains(&to) => {
                Rejection::new(Code::BadArgument, format!("node {to} is not a voter"))
                    .wanted(format!("one of {:?}", self.membership.voters))
            }
            _ if to == self.config.id => return Ok(()),
            Some(under_way) if under_way == to => return Ok(()),
            Some(under_way) => Rejection::new(Code::Overloaded, "another transfer of leadership is under way")
                .found(format!("a transfer to node {under_way}"))
                .next("ask again when it is done or has failed, in less than a second"),
            None if !self.is_active(to) => {
                Rejection::new(Code::Overloaded, format!("node {to} does not answer, so it cannot lead"))
                    .next("choose another voter, or ask again when it is up")
            }
            None => {
                self.transfer_rest = TRANSFER_REST_TIMEOUTS * self.config.election_tick;
                self.raw.transfer_leader(to);
                return Ok(());
            }
        };
        Err(refused)
    }

    fn change_membership(&mut self, change: &MembershipChange) -> Result<(), Rejection> {
        let bad = |error: String| Rejection::new(Code::BadArgument, error);
        if self.raw.raft.has_pending_conf() {
            return Err(Rejection::new(Code::Overloaded, "another change of members is not complete")
                .next("ask again when it is"));
        }
        let data = change.to_bytes();
        MembershipChange::from_bytes(&data).map_err(|error| bad(error.to_string()))?;
        let next = self.membership.apply(change).map_err(|error| bad(error.to_string()))?;
        if !next.voters.contains(&self.config.id) {
            return Err(bad("the leader cannot take away its own vote".to_owned())
                .next("transfer the leadership to another voter first"));
        }
        let proposal = proposal(self.config.id, EntryKind::ConfChangeV2, data);
        self.raw.step(proposal).map_err(|error| bad(error.to_string()))
    }
}
