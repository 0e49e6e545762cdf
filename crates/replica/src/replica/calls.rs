//! Control calls and questions that the leader has not ordered: given to it again, passed on to the voters, and complained about.

use super::{Effect, Now, Replica};
use crate::waiters::Waiter;
use crate::withheld::{Kind, Step, URGENT_BYTES_MAX, View};
use bytes::Bytes;
use ledger::transaction::Transaction;
use ledger::{Admission, Ledger};
use ledger_base::mutation::{Mutation, active};
use ledger_raft::{Input, Lane, PeerMessage, UnansweredCall};

impl<W: Waiter> Replica<W> {
    /// A client of this node has submitted a call. Control calls are kept, and the questions of robots.
    pub(super) fn keep_call(&mut self, now: Now, lane: Lane, encoded: &Bytes) {
        if self.leading || lane == Lane::Data && encoded.len() > URGENT_BYTES_MAX {
            return;
        }
        let Ok(transaction) = Transaction::decode(encoded.clone()) else { return };
        let ledger = self.executor.ledger();
        let kind = kind(ledger, &transaction);
        if lane == Lane::Control || kind == Some(Kind::Question) {
            let kind = kind.unwrap_or(Kind::Control);
            self.withheld.keep(&transaction, kind, || organisation(ledger, &transaction), true, now.elapsed);
        }
    }

    /// Another node passes on a control call that the leader has not ordered. It goes to the leader from here as well.
    pub(super) fn passed_on(&mut self, now: Now, from: u64, call: UnansweredCall, out: &mut Vec<Effect>) {
        if !self.withheld.may_pass_on(from, now.elapsed) {
            return out.push(Effect::Ignored { from, reason: "it forwards too many calls" });
        }
        let Ok(transaction) = Transaction::decode(call.transaction) else {
            return out.push(Effect::Ignored { from, reason: "it forwards a call that cannot be read" });
        };
        let Some(kind) = kind(self.executor.ledger(), &transaction).filter(|_| self.is_admissible(now, &transaction))
        else {
            return;
        };
        let ledger = self.executor.ledger();
        self.withheld.keep(&transaction, kind, || organisation(ledger, &transaction), false, now.elapsed);
        if self.leading {
            let transaction = transaction.encoded().clone();
            self.order(now, Input::Submit { lane: Lane::Control, transaction }, out);
        }
    }

    /// With each step of time: what is to be done about the calls that wait.
    pub(super) fn tend_calls(&mut self, now: Now, out: &mut Vec<Effect>) {
        if !self.withheld.is_due(now.elapsed) {
            return;
        }
        let (status, tip) = (self.engine.status(), self.executor.ledger().tip());
        let leader = status.role.leader.filter(|_| !self.leading).map(|leader| (status.role.term, leader));
        let view =
            View { elapsed: now.elapsed, clock: now.clock, leader, height: tip.height, term: tip.term, time: tip.time };
        let ledger = self.executor.ledger();
        for step in self.withheld.tend(view, |call| ledger.is_settled(&call.call_ref())) {
            match step {
                Step::Give(transaction) => self.order(now, Input::Submit { lane: Lane::Control, transaction }, out),
                Step::PassOn(transaction) => {
                    let message = PeerMessage::Unanswered(UnansweredCall { transaction });
                    let voters = status.membership.voters.iter().filter(|node| **node != status.id);
                    out.extend(voters.map(|to| Effect::Send { to: *to, message: message.clone() }));
                }
                Step::Complain(call) if !self.is_admissible(now, &call) => self.withheld.forget(&call),
                Step::Complain(call) => {
                    let over = self.executor.budgets().owes(self.executor.ledger(), &call, now.clock);
                    if let Some((term, leader)) = leader.filter(|_| !over && !active(Mutation::NeverComplain)) {
                        self.order(now, Input::Complain { term, leader }, out);
                    }
                }
            }
        }
    }

    fn is_admissible(&self, now: Now, call: &Transaction) -> bool {
        matches!(self.executor.ledger().admit_decoded(call.clone(), now.clock), Ok(Admission::New(_)))
    }
}

/// The kind of a call that voters keep; none for data.
fn kind(ledger: &Ledger, call: &Transaction) -> Option<Kind> {
    let body = call.body();
    let chaincode =
        ledger.registry().find(&body.chaincode).ok().filter(|_| call.encoded().len() <= URGENT_BYTES_MAX)?;
    match () {
        () if chaincode.urgent(&body.function) => Some(Kind::Control),
        () if chaincode.asks(&body.function) => Some(Kind::Question),
        () => None,
    }
}

/// The organisation of the creator; empty if the ledger does not know its certificate.
fn organisation(ledger: &Ledger, call: &Transaction) -> String {
    ledger.counted_for(&call.creator()).map(|identity| identity.organisation.clone()).unwrap_or_default()
}
