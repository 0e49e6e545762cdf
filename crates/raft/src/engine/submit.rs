//! Transactions on their way into the log: taken in, forwarded to the leader, or given back with a reason.

use super::Engine;
use crate::interface::{Lane, Output, Role};
use crate::message::{PeerMessage, Transactions};
use crate::queue::Waiting;
use bytes::Bytes;
use ledger::block::{PAYLOAD_BYTES_MAX, TRANSACTIONS_MAX};
use ledger_base::mutation::withholds_control;
use ledger_base::rejection::{Code, Rejection};

impl Engine {
    /// A client of this node wants a transaction ordered.
    pub(super) fn submit(&mut self, lane: Lane, transaction: Bytes, out: &mut Vec<Output>) {
        if self.is_withheld(lane) {
            return;
        }
        let waiting = Waiting { transaction, origin: None, since: self.now };
        let refused = match self.leader() {
            None => vec![(waiting, no_leader())],
            Some(_) => self.queues.push(lane, waiting),
        };
        give_back(refused.into_iter().map(|(waiting, reason)| (lane, waiting, reason)), out);
    }

    /// A test has this leader lie.
    fn is_withheld(&self, lane: Lane) -> bool {
        lane == Lane::Control && withholds_control() && self.is_leader()
    }

    /// Gives back data that has waited too long to be worth ordering.
    pub(super) fn drop_late(&mut self, out: &mut Vec<Output>) {
        // The first is looked at in any case: control may leave no room for long.
        let late = self.queues.take_late(self.now, self.config.data_wait_us, self.room_ahead().max(1));
        give_back(late.into_iter().map(|(waiting, reason)| (Lane::Data, waiting, reason)), out);
    }

    /// Another node takes this one for the leader.
    pub(super) fn forwarded(&mut self, from: u64, transactions: Transactions, out: &mut Vec<Output>) {
        let mut refused = Vec::new();
        let lanes = [(Lane::Control, transactions.control), (Lane::Data, transactions.data)];
        for (lane, transactions) in lanes {
            if self.is_withheld(lane) {
                continue;
            }
            for transaction in transactions {
                let waiting = Waiting { transaction, origin: Some(from), since: self.now };
                // Never forwarded again: two nodes that take each other for the leader would play ping-pong.
                let more = match self.raw.raft.state {
                    raft::StateRole::Leader => self.queues.push(lane, waiting),
                    _ => vec![(waiting, no_leader())],
                };
                refused.extend(more.into_iter().map(|(waiting, reason)| (lane, waiting, reason)));
            }
        }
        give_back(refused, out);
    }

    /// Transactions of this node's clients that were not ordered.
    pub(super) fn returned(&mut self, transactions: Transactions, out: &mut Vec<Output>) {
        // A node speaks of its own trouble here. It does not decide about calls.
        let code = u16::try_from(transactions.code).ok().and_then(Code::from_number);
        let code = code.filter(|code| (4000..5000).contains(&code.number())).unwrap_or(Code::NoLeader);
        for transaction in transactions.control.into_iter().chain(transactions.data) {
            let reason = Rejection::new(code, "the node that was taken for the leader did not order the transaction");
            out.push(Output::Dropped { transaction, reason });
        }
    }

    /// A follower passes on what waits, in messages of bounded size.
    pub(super) fn forward(&mut self, out: &mut Vec<Output>) {
        let (Some(leader), false) = (self.told.leader, self.told.role == Role::Leader) else { return };
        if leader == self.config.id {
            return;
        }
        while !self.queues.is_empty() {
            let cut = self.queues.cut(self.config.message_bytes.min(PAYLOAD_BYTES_MAX), usize::MAX);
            let transactions = |taken: Vec<Waiting>| taken.into_iter().map(|waiting| waiting.transaction).collect();
            let control = transactions(self.queues.control.take(cut.control));
            let data = transactions(self.queues.data.take(cut.data));
            let message = PeerMessage::Forward(Transactions { control, data, code: 0 });
            out.push(Output::Send { to: leader, message });
        }
    }

    /// Gives everything back that waits: whoever waits for it should look for another node.
    pub(super) fn drop_waiting(&mut self, reason: &Rejection, out: &mut Vec<Output>) {
        let control = self.queues.control.take(usize::MAX).into_iter().map(|waiting| (Lane::Control, waiting));
        let data = self.queues.data.take(usize::MAX).into_iter().map(|waiting| (Lane::Data, waiting));
        give_back(control.chain(data).map(|(lane, waiting)| (lane, waiting, reason.clone())), out);
    }
}

pub(super) fn no_leader() -> Rejection {
    Rejection::new(Code::NoLeader, "no leader is known, so nothing can be ordered now")
}

/// Tells whoever submitted: a client of this node, or the node that forwarded.
fn give_back(refused: impl IntoIterator<Item = (Lane, Waiting, Rejection)>, out: &mut Vec<Output>) {
    for (lane, waiting, reason) in refused {
        let Some(to) = waiting.origin else {
            out.push(Output::Dropped { transaction: waiting.transaction, reason });
            continue;
        };
        let code = u32::from(reason.code.number());
        if let Some(Output::Send { to: last, message: PeerMessage::Returned(returned) }) = out.last_mut()
            && *last == to
            && returned.code == code
            && returned.control.len() + returned.data.len() < TRANSACTIONS_MAX
            && bytes(returned) + waiting.transaction.len() <= PAYLOAD_BYTES_MAX
        {
            lane_of(returned, lane).push(waiting.transaction);
            continue;
        }
        let mut returned = Transactions { control: Vec::new(), data: Vec::new(), code };
        lane_of(&mut returned, lane).push(waiting.transaction);
        out.push(Output::Send { to, message: PeerMessage::Returned(returned) });
    }
}

fn lane_of(transactions: &mut Transactions, lane: Lane) -> &mut Vec<Bytes> {
    match lane {
        Lane::Control => &mut transactions.control,
        Lane::Data => &mut transactions.data,
    }
}

fn bytes(transactions: &Transactions) -> usize {
    transactions.control.iter().chain(&transactions.data).map(Bytes::len).sum()
}
