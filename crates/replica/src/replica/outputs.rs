//! The engine's wishes, as effects for the node.

use super::{Effect, LEARNER_WRITE_DELAY, Now, Replica};
use crate::waiters::Waiter;
use bytes::Bytes;
use ledger::Refusal;
use ledger::transaction::Transaction;
use ledger_base::invariant;
use ledger_base::rejection::{Code, Rejection};
use ledger_light::{Branch, DoubleHead, DoubleVote, Misbehaviour, Signature};
use ledger_raft::{HeadBranch, Input, Output, PeerMessage, Role, Transactions, VotedTwice};

impl<W: Waiter> Replica<W> {
    /// Hands an input to the engine.
    pub(super) fn order(&mut self, now: Now, input: Input, out: &mut Vec<Effect>) {
        if !matches!(input, Input::Tick) {
            self.ticks.note_work();
        }
        let mut outputs = std::mem::take(&mut self.outputs);
        self.engine.accept_time_until(now.accepts_until);
        self.engine.doubt_clock(now.doubt);
        self.engine.step(now.clock, input, &mut outputs);
        for output in outputs.drain(..) {
            self.carry_out(now, output, out);
        }
        self.outputs = outputs;
    }

    fn carry_out(&mut self, now: Now, output: Output, out: &mut Vec<Effect>) {
        match output {
            Output::Send { to, message } => out.push(Effect::Send { to, message }),
            Output::Flush { ready } => {
                if self.flush.is_none() {
                    let delay = if self.engine.is_voter() { 0 } else { LEARNER_WRITE_DELAY };
                    self.flush_due = now.elapsed.saturating_add(delay);
                }
                let before = self.flush.unwrap_or(0);
                invariant!(before < ready, "numbers of flushes grow", "flush {ready} after {before}");
                self.flush = Some(ready);
            }
            Output::Commit(entries) => self.committed.extend(entries),
            Output::Role(change) => {
                self.leading = change.role == Role::Leader;
                self.asked_for = (0, 0);
                self.report(out);
                out.push(Effect::Role(change));
                self.submit_again = change.leader.is_some();
            }
            Output::Membership { height, membership } => {
                // Whoever sees the change on the ledger must find it in the status, too.
                self.report(out);
                out.push(Effect::Members { height, membership });
                self.reconcile = true;
            }
            Output::Dropped { transaction, reason } => self.refuse(transaction, reason, out),
            Output::ReadReady { context, index } => out.push(Effect::Read { context, answer: Ok(index) }),
            Output::Refused { input, reason } => out.push(match *input {
                Input::ReadIndex { context } => Effect::Read { context, answer: Err(reason) },
                _ => Effect::Refused { input, reason },
            }),
            Output::Behind { from, first_index } => out.push(Effect::Behind { from, first_index }),
            Output::Ignored { from, reason } => out.push(Effect::Ignored { from, reason }),
            Output::VotedTwice(found) => match self.proof(now, &found) {
                Ok(proof) => out.push(Effect::Misbehaved(Box::new(Misbehaviour::DoubleVote(proof)))),
                Err(reason) => {
                    tracing::warn!(voter = found.voter, code = reason.code.name(), %reason, "cannot read two votes of \
                                                                                             one voter")
                }
            },
            Output::TwoHeads(found) => match self.proof_of_heads(now, &found) {
                Ok(proof) => out.push(Effect::Misbehaved(Box::new(Misbehaviour::DoubleHead(proof)))),
                Err(reason) => {
                    tracing::warn!(leader = found.leader, code = reason.code.name(), %reason, "cannot read two heads \
                                                                                               of one leader")
                }
            },
            Output::Contradicted(found) => out.push(Effect::Contradicted(found)),
            Output::Failed(reason) => out.push(Effect::Failed(reason)),
        }
    }

    /// Two votes of one voter, for any reader to check.
    fn proof(&self, now: Now, found: &VotedTwice) -> Result<DoubleVote, Rejection> {
        let [(one, first), (other, second)] = &found.votes;
        let votes = [(*one, Signature::from_bytes(first)?), (*other, Signature::from_bytes(second)?)];
        let (ledger, term) = (self.executor.ledger(), found.term);
        Ok(DoubleVote { network: ledger.network(), recoveries: ledger.recoveries()?, term, time: now.clock, votes })
    }

    /// The transactions that another node forwards, without those far beyond budgets, which it gets back.
    pub(super) fn within_budgets(
        &self,
        now: Now,
        from: u64,
        mut forwarded: Transactions,
        out: &mut Vec<Effect>,
    ) -> Transactions {
        let excess = self.executor.budgets().take_excess(self.executor.ledger(), from, &mut forwarded, now.clock);
        if !(excess.control.is_empty() && excess.data.is_empty()) {
            out.push(Effect::Send { to: from, message: PeerMessage::Returned(excess) });
        }
        forwarded
    }

    /// Two logs of one leader, for any reader to check.
    fn proof_of_heads(&self, now: Now, found: &ledger_raft::DoubleHead) -> Result<DoubleHead, Rejection> {
        let branch = |branch: &HeadBranch| -> Result<Branch, Rejection> {
            let HeadBranch { base, links, vote, signature } = branch;
            let Signature { node, certificate, .. } = Signature::from_bytes(vote)?;
            let signature = Signature { node, certificate, signature: signature.clone() };
            Ok(Branch { base: *base, links: links.clone(), signature })
        };
        let [one, other] = &found.branches;
        let branches = [branch(one)?, branch(other)?];
        let ledger = self.executor.ledger();
        let (network, recoveries) = (ledger.network(), ledger.recoveries()?);
        let ledger_raft::DoubleHead { leader, term, height, .. } = *found;
        Ok(DoubleHead { network, recoveries, leader, term, height, time: now.clock, branches })
    }

    /// There is no way to the leader now, so who waits for what was forwarded is told.
    pub(super) fn unsent(&mut self, to: u64, message: PeerMessage, out: &mut Vec<Effect>) {
        let PeerMessage::Forward(lost) = message else { return };
        let reason =
            Rejection::new(Code::NoLeader, format!("node {to} is the leader, but there is no connection to it"));
        for transaction in lost.control.into_iter().chain(lost.data) {
            self.refuse(transaction, reason.clone(), out);
        }
    }

    /// Tells whoever submitted it.
    fn refuse(&mut self, transaction: Bytes, reason: Rejection, out: &mut Vec<Effect>) {
        let Ok(transaction) = Transaction::decode(transaction) else { return };
        let who = self.waiters.refuse(&transaction.id(), &reason);
        out.push(Effect::Denied(Box::new(Refusal::of_node(who, Some(transaction), reason))));
    }

    pub(super) fn report(&self, out: &mut Vec<Effect>) {
        out.push(Effect::Status(Box::new(self.engine.status())));
    }
}
