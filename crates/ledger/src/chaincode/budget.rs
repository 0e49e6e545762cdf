//! Budgets: the most that a call may use, and what the calls of one organisation may use of a block.
//!
//! Every node counts the same: what a call asks of its [`Context`](super::Context), never time, and never what a node
//! remembers. A call that goes beyond its budget is stopped at once and refused with [`Code::OverBudget`]. The budget of a
//! block counts for each organisation apart, so that nobody uses up what others need. The steps of policies are counted for
//! the organisation whose policies they are.

use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use std::cell::{Cell, RefCell};
use std::collections::{BTreeMap, HashSet};
use std::panic::resume_unwind;

/// The kinds of what is counted.
const KINDS: usize = 7;

/// The use of calls, or the most that they may use.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Usage {
    /// Keys read; a range counts one more than it finds.
    pub reads: u64,
    /// Bytes of the keys and values read.
    pub read_bytes: u64,
    /// Keys written or deleted.
    pub writes: u64,
    /// Bytes of the keys and values written.
    pub written_bytes: u64,
    /// Bytes of answers.
    pub answer_bytes: u64,
    /// Bytes of events: subject and payload.
    pub event_bytes: u64,
    /// Steps of policies: see [`Context::charge_steps`](super::Context::charge_steps).
    pub steps: u64,
}

const MIB: u64 = 1024 * 1024;

/// The most that one call may use.
pub const CALL_BUDGET: Usage = Usage {
    reads: 256 * 1024,
    read_bytes: 128 * MIB,
    writes: 128 * 1024,
    written_bytes: 32 * MIB,
    answer_bytes: MIB / 2,
    event_bytes: 8 * MIB,
    steps: 64 * MIB,
};

/// The most that the calls of one organisation may use in one block; of steps, what its policies may take.
pub const BLOCK_BUDGET: Usage = Usage {
    reads: 2 * MIB,
    read_bytes: 512 * MIB,
    writes: 512 * 1024,
    written_bytes: 128 * MIB,
    answer_bytes: 32 * MIB,
    event_bytes: 32 * MIB,
    steps: 128 * MIB,
};

/// The most that a query may use.
pub const QUERY_BUDGET: Usage = Usage { answer_bytes: MIB, ..CALL_BUDGET };

impl Usage {
    fn counts(&self) -> [(&'static str, u64); KINDS] {
        [
            ("keys read", self.reads),
            ("bytes read", self.read_bytes),
            ("keys written", self.writes),
            ("bytes written", self.written_bytes),
            ("bytes of the answer", self.answer_bytes),
            ("bytes of events", self.event_bytes),
            ("steps of policies", self.steps),
        ]
    }

    fn add(&mut self, more: &Self) {
        self.reads = self.reads.saturating_add(more.reads);
        self.read_bytes = self.read_bytes.saturating_add(more.read_bytes);
        self.writes = self.writes.saturating_add(more.writes);
        self.written_bytes = self.written_bytes.saturating_add(more.written_bytes);
        self.answer_bytes = self.answer_bytes.saturating_add(more.answer_bytes);
        self.event_bytes = self.event_bytes.saturating_add(more.event_bytes);
        self.steps = self.steps.saturating_add(more.steps);
    }

    /// The first kind of which more was used than `most`, with both numbers.
    fn beyond(&self, most: &Self) -> Option<(&'static str, u64, u64)> {
        let both = self.counts().into_iter().zip(most.counts());
        both.into_iter().find(|((_, used), (_, most))| used > most).map(|((kind, used), (_, most))| (kind, used, most))
    }
}

/// The budgets that hold.
#[derive(Clone, Copy, Debug)]
struct Budgets {
    call: Usage,
    block: Usage,
}

/// Counts what the calls of one block use, or one query.
#[derive(Debug)]
pub struct Meter {
    budgets: Budgets,
    /// Is a call counted now? Hooks are not: what they do is bounded by their chaincodes, and must be done.
    counting: Cell<bool>,
    call: Cell<Usage>,
    /// By organisation.
    block: RefCell<BTreeMap<String, Usage>>,
    /// The organisation that the call is counted for.
    payer: RefCell<String>,
    /// Questions to policies whose steps were counted in this block.
    asked: RefCell<HashSet<Hash>>,
    over: RefCell<Option<Rejection>>,
}

/// Stops a call that is over its budget.
pub(super) struct Stopped;

impl Meter {
    /// Of a block, or of a call that is simulated.
    pub fn of_block() -> Self {
        Self::of(Budgets { call: CALL_BUDGET, block: BLOCK_BUDGET })
    }

    /// Of a query.
    pub fn of_query() -> Self {
        Self::of(Budgets { call: QUERY_BUDGET, block: QUERY_BUDGET })
    }

    fn of(budgets: Budgets) -> Self {
        Self {
            budgets,
            counting: Cell::default(),
            call: Cell::default(),
            block: RefCell::default(),
            payer: RefCell::default(),
            asked: RefCell::default(),
            over: RefCell::default(),
        }
    }

    /// The use of the last call.
    pub fn used(&self) -> Usage {
        self.call.get()
    }

    /// A call begins.
    pub(super) fn begin(&self, payer: &str) {
        self.call.set(Usage::default());
        payer.clone_into(&mut self.payer.borrow_mut());
        self.over.replace(None);
        self.counting.set(true);
    }

    /// The refusal of the call that is counted, if it is over its budget: its chaincode may go on after a nested call was
    /// stopped.
    pub(super) fn within(&self) -> Result<(), Rejection> {
        self.over.borrow().clone().map_or(Ok(()), Err)
    }

    /// The call has ended: the refusal, if it was over its budget, whatever else came of it.
    pub(super) fn end(&self) -> Result<(), Rejection> {
        self.counting.set(false);
        self.over.take().map_or(Ok(()), Err)
    }

    /// Does something that is not counted.
    pub(super) fn uncounted<T>(&self, body: impl FnOnce() -> T) -> T {
        /// A panic in between is no end of counting.
        struct Again<'a>(&'a Cell<bool>, bool);
        impl Drop for Again<'_> {
            fn drop(&mut self) {
                self.0.set(self.1);
            }
        }
        let _again = Again(&self.counting, self.counting.replace(false));
        body()
    }

    /// Counts keys that were read.
    pub(super) fn read(&self, keys: usize, bytes: usize) {
        self.charge(&Usage { reads: keys as u64, read_bytes: bytes as u64, ..Usage::default() });
    }

    /// Counts a key that is written.
    pub(super) fn write(&self, bytes: usize) {
        self.charge(&Usage { writes: 1, written_bytes: bytes as u64, ..Usage::default() });
    }

    /// Counts an event.
    pub(super) fn event(&self, bytes: usize) {
        self.charge(&Usage { event_bytes: bytes as u64, ..Usage::default() });
    }

    /// Counts an answer. It may be too long for a transaction and none of a chaincode's reads was: so it is refused
    /// without stopping anything.
    pub(super) fn answer(&self, bytes: usize) -> Result<(), Rejection> {
        let payer = self.payer.borrow().clone();
        self.count(&payer, &Usage { answer_bytes: bytes as u64, ..Usage::default() })
    }

    /// Counts the steps of a question to the policies of `owner`, once in a block.
    pub(super) fn steps(&self, owner: &str, steps: u64, question: impl FnOnce() -> Hash) {
        if self.counting.get() && self.asked.borrow_mut().insert(question()) {
            self.stop_beyond(self.count(owner, &Usage { steps, ..Usage::default() }));
        }
    }

    fn charge(&self, more: &Usage) {
        if self.counting.get() {
            let payer = self.payer.borrow().clone();
            self.stop_beyond(self.count(&payer, more));
        }
    }

    /// Nothing that the chaincode would do from here on counts, and it must not go on with half of what it asked for.
    fn stop_beyond(&self, counted: Result<(), Rejection>) {
        if let Err(refused) = counted {
            self.over.borrow_mut().get_or_insert(refused);
            resume_unwind(Box::new(Stopped));
        }
    }

    fn count(&self, payer: &str, more: &Usage) -> Result<(), Rejection> {
        let mut call = self.call.get();
        call.add(more);
        self.call.set(call);
        let Budgets { call: of_call, block: of_block } = &self.budgets;
        if let Some((kind, used, most)) = call.beyond(of_call) {
            let reading = kind == "bytes of the answer";
            return Err(Rejection::new(Code::OverBudget, "the call exceeds the budget of a call")
                .found(format!("{used} {kind}"))
                .wanted(format!("at most {most}"))
                .next(if reading { "request less at once: in pages" } else { "split it into several calls" }));
        }
        let mut block = self.block.borrow_mut();
        let used = match block.get_mut(payer) {
            Some(used) => used,
            None => block.entry(payer.to_owned()).or_default(),
        };
        used.add(more);
        if let Some((kind, used, most)) = used.beyond(of_block) {
            let whose = if more.steps > 0 { "the policies" } else { "the calls" };
            return Err(Rejection::new(Code::OverBudget, format!("{whose} of {payer} exceed the budget of a block"))
                .found(format!("{used} {kind}"))
                .wanted(format!("at most {most} per organisation and block"))
                .next("send the call again in a new transaction: each block has a new budget"));
        }
        Ok(())
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use std::panic::{AssertUnwindSafe, catch_unwind};

    fn used(meter: &Meter, body: impl FnOnce(&Meter)) -> Result<(), Rejection> {
        meter.begin("Org1");
        let _stopped = catch_unwind(AssertUnwindSafe(|| body(meter)));
        meter.end()
    }

    #[test]
    fn a_call_beyond_its_budget_is_stopped_and_the_next_one_begins_anew() {
        let meter = Meter::of_block();
        let within = CALL_BUDGET.written_bytes as usize;
        assert!(used(&meter, |meter| meter.write(within)).is_ok());
        let mut went_on = false;
        let refused = used(&meter, |meter| {
            meter.write(within + 1);
            went_on = true;
        });
        let refused = refused.unwrap_err();
        assert!(refused.code == Code::OverBudget && !went_on, "{refused}");
        assert!(refused.to_string().contains("bytes written"), "{refused}");
        assert!(used(&meter, |meter| meter.write(within)).is_ok());
    }

    #[test]
    fn who_uses_up_a_block_stops_nobody_else() {
        let meter = Meter::of_block();
        let most = CALL_BUDGET.read_bytes as usize;
        let calls = (BLOCK_BUDGET.read_bytes / CALL_BUDGET.read_bytes) as usize;
        for _ in 0..calls {
            assert!(used(&meter, |meter| meter.read(1, most)).is_ok());
        }
        let refused = used(&meter, |meter| meter.read(1, most)).unwrap_err();
        assert!(refused.code == Code::OverBudget && refused.message.contains("Org1"), "{refused}");
        meter.begin("Org2");
        meter.read(1, most);
        assert!(meter.end().is_ok());
    }

    #[test]
    fn the_steps_of_a_question_are_counted_once_in_a_block_and_for_whose_policies_they_are() {
        let meter = Meter::of_block();
        let question = |number: u64| Hash::of(&[&number.to_be_bytes()]);
        let ask =
            |meter: &Meter, number| used(meter, |meter| meter.steps("Org2", CALL_BUDGET.steps, || question(number)));
        for _ in 0..10 {
            assert!(ask(&meter, 0).is_ok());
        }
        assert!(ask(&meter, 1).is_ok());
        assert!(ask(&meter, 2).unwrap_err().message.contains("Org2"));
        assert!(used(&meter, |meter| meter.steps("Org3", CALL_BUDGET.steps, || question(3))).is_ok());
    }

    #[test]
    fn what_is_uncounted_has_no_budget() {
        let meter = Meter::of_block();
        assert!(used(&meter, |meter| meter.uncounted(|| meter.write(usize::MAX))).is_ok());
        assert!(used(&meter, |meter| meter.write(usize::MAX)).is_err());
    }
}
