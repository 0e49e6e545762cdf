//! Transactions on their way into the log: taken in, forwarded to the leader, or given back with a reason.

use super::Engine;
use crate::interface::{Lane, Output, Role};
use crate::message::{PeerMessage, Transactions};
use crate::queue::{Cut, Waiting};
use ledger::block::{PAYLOAD_BYTES_MAX, TRANSACTIONS_MAX};
use ledger::{Bytes, Code, Rejection};

impl Engine {
    /// A client of this node wants a transaction ordered.
    pub(super) fn submit(&mut self, lane: Lane, transaction: Bytes, out: &mut Vec<Output>) {
        let waiting = Waiting { transaction, origin: None };
        let refused = match self.leader() {
            None => Err(Box::new((waiting, no_leader()))),
            Some(_) => self.queues.push(lane, waiting),
        };
        if let Err(refused) = refused {
            let (waiting, reason) = *refused;
            out.push(Output::Dropped { transaction: waiting.transaction, reason });
        }
    }

    /// Another node takes this one for the leader.
    pub(super) fn forwarded(&mut self, from: u64, transactions: Transactions, out: &mut Vec<Output>) {
        let mut refused = Vec::new();
        let lanes = [(Lane::Control, transactions.control), (Lane::Data, transactions.data)];
        for (lane, transactions) in lanes {
            for transaction in transactions {
                let waiting = Waiting { transaction, origin: Some(from) };
                // Never forwarded again: two nodes that take each other for the leader would play ping-pong.
                let result = match self.raw.raft.state {
                    raft::StateRole::Leader => self.queues.push(lane, waiting),
                    _ => Err(Box::new((waiting, no_leader()))),
                };
                if let Err(error) = result {
                    let (waiting, reason) = *error;
                    refused.push((lane, waiting, reason));
                }
            }
        }
        give_back(refused, out);
    }

    /// Transactions of this node's clients that were not ordered.
    pub(super) fn returned(&mut self, transactions: Transactions, out: &mut Vec<Output>) {
        let code = u16::try_from(transactions.code).ok().and_then(Code::from_number).unwrap_or(Code::NoLeader);
        for transaction in transactions.control.into_iter().chain(transactions.data) {
            let reason = Rejection::new(code, "the node that was taken for the leader did not order the transaction")
                .next("submit it again later, unchanged");
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
            let cut = self.queues.cut(self.config.message_bytes.min(PAYLOAD_BYTES_MAX));
            let control = self.queues.control.take(cut.control).map(|waiting| waiting.transaction).collect();
            let data = self.queues.data.take(cut.data).map(|waiting| waiting.transaction).collect();
            let message = PeerMessage::Forward(Transactions { control, data, code: 0 });
            out.push(Output::Send { to: leader, message });
        }
    }

    /// No leader for too long: whoever waits should look for another node.
    pub(super) fn drop_waiting(&mut self, out: &mut Vec<Output>) {
        let all = Cut { control: usize::MAX, data: 0, bytes: 0 };
        let control: Vec<_> = self.queues.take(all).map(|waiting| (Lane::Control, waiting, no_leader())).collect();
        let data = self.queues.take_all().map(|waiting| (Lane::Data, waiting, no_leader()));
        let refused = control.into_iter().chain(data).collect();
        give_back(refused, out);
    }
}

fn no_leader() -> Rejection {
    Rejection::new(Code::NoLeader, "no leader is known, so nothing can be ordered now")
        .next("submit it again later, unchanged, or through another node")
}

/// Tells whoever submitted: a client of this node, or the node that forwarded.
fn give_back(refused: Vec<(Lane, Waiting, Rejection)>, out: &mut Vec<Output>) {
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
