//! Is this node's state as new as what was committed when somebody asked? Only then may it refuse because of its state, or
//! answer from it.
//!
//! The leader knows, and a majority must confirm that it leads (Raft §6.4). One question serves everybody who waits
//! when it is asked. A read that comes while it is under way waits for the next one, as an answer may be older than the
//! read. So a flood of refusals costs the leader one question at a time.
//!
//! A question or its answer may be lost when the leader changes. Then it is asked again, within a bounded time. Once the
//! height is known, this node must execute up to it.

use ledger_base::mutation::{Mutation, active};
use ledger_base::rejection::{Code, Rejection};
use ledger_base::{costly_invariant, invariant};

/// Longest time in which the leader must confirm a read, all attempts together, microseconds.
pub const CONFIRM_TIME_MAX: u64 = 1_000_000;
/// How long the first attempt waits, microseconds; each further one waits twice as long.
const FIRST_ATTEMPT: u64 = 150_000;
/// Pause after a refusal, microseconds: an election takes this long at least.
const REFUSED_PAUSE: u64 = 20_000;
/// Longest time that somebody waits for a height that this node has not executed, microseconds.
pub const WAIT_FOR_HEIGHT: u64 = 2_000_000;
/// From one question to the next while more and more ask, microseconds. The first after a quiet moment is asked at once.
const BETWEEN_QUESTIONS: u64 = 1_000;

const _: () = assert!(FIRST_ATTEMPT < CONFIRM_TIME_MAX && REFUSED_PAUSE < CONFIRM_TIME_MAX);

/// The height that the state has reached at least, and that was committed when the question was asked; or why that cannot
/// be told now.
pub type Known = Result<u64, Rejection>;

/// Somebody who asks whether the state is current.
pub trait Asker {
    /// Has the client gone away? Then it needs no answer.
    fn is_gone(&self) -> bool;
}

/// The next steps for reads.
#[derive(Debug, PartialEq)]
pub enum ReadEffect<A> {
    /// Hand [`ledger_raft::Input::ReadIndex`] with this context to the engine; its answer, or why it cannot be asked, goes
    /// to [`Reads::answered`].
    Ask {
        /// Never the same twice, so a late answer finds nobody instead of somebody else.
        context: u64,
    },
    /// Tell this asker.
    Tell {
        /// The caller.
        asker: A,
        /// The knowledge by now.
        known: Known,
    },
}

/// Those who ask, and the question that is under way. All times are in microseconds of one clock that does not go back.
#[derive(Debug)]
pub struct Reads<A> {
    /// Context of the next attempt.
    next: u64,
    /// Height of the newest executed block.
    executed: u64,
    /// Those whom the next question serves.
    waiting: Vec<A>,
    /// Those whom the question under way serves.
    served: Vec<A>,
    /// When the last question was first asked.
    asked: u64,
    stage: Stage,
}

/// How far the question under way is.
#[derive(Debug)]
enum Stage {
    /// Nobody asks.
    Quiet,
    /// The next question waits until this time, so that more can join it.
    Gathering { until: u64 },
    /// An attempt is under way, until this time.
    Asked { context: u64, until: u64, attempts: Attempts },
    /// The last attempt failed; the next one is made at this time.
    Pausing { until: u64, attempts: Attempts },
    /// The height is known; until this time the node has to execute it.
    Reaching { height: u64, until: u64 },
}

/// The attempts of one question.
#[derive(Clone, Copy, Debug)]
struct Attempts {
    /// When the last one ends.
    deadline: u64,
    /// Longest time of the next one.
    patience: u64,
}

impl<A: Asker> Reads<A> {
    /// Of a node that has executed up to a height.
    pub fn new(executed: u64) -> Self {
        Self { next: 0, executed, waiting: Vec::new(), served: Vec::new(), asked: 0, stage: Stage::Quiet }
    }

    /// Somebody wants to know a height that was committed at this moment or later, when this node has executed it.
    pub fn ask(&mut self, now: u64, asker: A, out: &mut Vec<ReadEffect<A>>) {
        self.waiting.push(asker);
        if matches!(self.stage, Stage::Quiet) {
            self.begin(now, out);
        }
        self.check();
    }

    /// The engine's answer to an attempt. One that nobody waits for any more has no effect.
    pub fn answered(&mut self, now: u64, context: u64, answer: Known, out: &mut Vec<ReadEffect<A>>) {
        let Stage::Asked { context: asked, attempts, .. } = self.stage else { return };
        if asked != context {
            return;
        }
        match answer {
            Ok(height) => {
                self.stage = Stage::Reaching { height, until: now.saturating_add(WAIT_FOR_HEIGHT) };
                self.reach(now, out);
            }
            Err(reason) => self.failed(now, attempts, reason, out),
        }
        self.check();
    }

    /// This node has executed a block.
    pub fn executed(&mut self, now: u64, height: u64, out: &mut Vec<ReadEffect<A>>) {
        let before = self.executed;
        costly_invariant!(height >= before, "executed heights only grow", "block {height} after {before}");
        self.executed = self.executed.max(height);
        self.reach(now, out);
        self.check();
    }

    /// Time goes on. To be called at [`Reads::wakes_at`] or later.
    pub fn time(&mut self, now: u64, out: &mut Vec<ReadEffect<A>>) {
        if self.wakes_at().is_none_or(|due| now < due) {
            return;
        }
        match self.stage {
            Stage::Quiet => {}
            Stage::Gathering { .. } => self.begin(now, out),
            Stage::Asked { attempts, .. } => self.failed(now, attempts, unconfirmed(), out),
            Stage::Pausing { attempts, .. } => self.attempt(now, attempts, out),
            Stage::Reaching { height, .. } => {
                let late = Rejection::new(Code::Behind, "this node has not reached the requested height")
                    .found(format!("height {}", self.executed))
                    .wanted(format!("height {height}"));
                self.tell(now, &Err(late), out);
            }
        }
        self.check();
    }

    /// When something is to be done although nothing happens; never, while nobody asks.
    pub fn wakes_at(&self) -> Option<u64> {
        match self.stage {
            Stage::Quiet => None,
            Stage::Gathering { until }
            | Stage::Asked { until, .. }
            | Stage::Pausing { until, .. }
            | Stage::Reaching { until, .. } => Some(until),
        }
    }

    /// States that nobody is forgotten: a question under way serves somebody, and those who wait have a question to come.
    fn check(&self) {
        let (served, waiting) = (self.served.len(), self.waiting.len());
        let holds = match self.stage {
            Stage::Quiet => served == 0 && waiting == 0,
            Stage::Gathering { .. } => served == 0 && waiting > 0,
            Stage::Asked { .. } | Stage::Pausing { .. } | Stage::Reaching { .. } => served > 0,
        };
        let stage = &self.stage;
        invariant!(holds, "everybody who asks is told", "{served} are served and {waiting} wait in {stage:?}");
    }

    /// Asks for all that wait.
    fn begin(&mut self, now: u64, out: &mut Vec<ReadEffect<A>>) {
        let served = self.served.len();
        invariant!(served == 0, "one question is asked at a time", "{served} wait for an earlier one");
        self.waiting.retain(|asker| !asker.is_gone());
        if self.waiting.is_empty() {
            self.stage = Stage::Quiet;
            return;
        }
        std::mem::swap(&mut self.waiting, &mut self.served);
        self.asked = now;
        if active(Mutation::AnswerAMinorityRead) {
            return self.tell(now, &Ok(self.executed), out);
        }
        self.attempt(now, Attempts { deadline: now.saturating_add(CONFIRM_TIME_MAX), patience: FIRST_ATTEMPT }, out);
    }

    fn attempt(&mut self, now: u64, attempts: Attempts, out: &mut Vec<ReadEffect<A>>) {
        let context = self.next;
        self.next += 1;
        let until = now.saturating_add(attempts.patience).min(attempts.deadline);
        self.stage = Stage::Asked { context, until, attempts };
        out.push(ReadEffect::Ask { context });
    }

    fn failed(&mut self, now: u64, attempts: Attempts, reason: Rejection, out: &mut Vec<ReadEffect<A>>) {
        let Attempts { deadline, patience } = attempts;
        let until = now.saturating_add(REFUSED_PAUSE);
        if deadline <= until {
            return self.tell(now, &Err(reason), out);
        }
        self.stage = Stage::Pausing { until, attempts: Attempts { deadline, patience: patience.saturating_mul(2) } };
    }

    fn reach(&mut self, now: u64, out: &mut Vec<ReadEffect<A>>) {
        if let Stage::Reaching { height, .. } = self.stage
            && self.executed >= height
        {
            self.tell(now, &Ok(height), out);
        }
    }

    /// The question has come to an end.
    fn tell(&mut self, now: u64, known: &Known, out: &mut Vec<ReadEffect<A>>) {
        let executed = self.executed;
        invariant!(
            known.as_ref().is_ok_and(|height| *height <= executed) || known.is_err(),
            "a state is called current when it is executed",
            "state {executed}, called current at {known:?}"
        );
        out.extend(self.served.drain(..).map(|asker| ReadEffect::Tell { asker, known: known.clone() }));
        let next = self.asked.saturating_add(BETWEEN_QUESTIONS);
        if self.waiting.is_empty() {
            self.stage = Stage::Quiet;
        } else if next <= now {
            self.begin(now, out);
        } else {
            self.stage = Stage::Gathering { until: next };
        }
    }
}

fn unconfirmed() -> Rejection {
    Rejection::new(Code::NoLeader, "no leader confirmed its leadership in time")
        .next("try again, ask another node, or query this node's own state (--stale)")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A client by its number; the one with the number 0 has gone away.
    #[derive(Clone, Copy, Debug, PartialEq)]
    struct Client(u32);

    impl Asker for Client {
        fn is_gone(&self) -> bool {
            self.0 == 0
        }
    }

    type Effect = ReadEffect<Client>;

    /// The steps after an event.
    fn does(happens: impl FnOnce(&mut Vec<Effect>)) -> Vec<Effect> {
        let mut out = Vec::new();
        happens(&mut out);
        out
    }

    fn asks(context: u64) -> Vec<Effect> {
        vec![ReadEffect::Ask { context }]
    }

    fn tells(clients: impl IntoIterator<Item = u32>, known: &Known) -> Vec<Effect> {
        clients.into_iter().map(|client| ReadEffect::Tell { asker: Client(client), known: known.clone() }).collect()
    }

    fn refusal() -> Rejection {
        Rejection::new(Code::NoLeader, "no leader is known")
    }

    #[test]
    fn one_question_serves_all_who_wait_and_none_who_come_while_it_is_under_way() {
        let mut reads = Reads::new(9);
        assert_eq!(does(|out| reads.ask(0, Client(1), out)), asks(0));
        for late in 2..1000 {
            assert_eq!(does(|out| reads.ask(10, Client(late), out)), [], "one at a time");
        }
        assert_eq!(does(|out| reads.answered(20, 0, Ok(3), out)), tells([1], &Ok(3)));
        assert_eq!(reads.wakes_at(), Some(BETWEEN_QUESTIONS), "more may come until then");
        assert_eq!(does(|out| reads.time(BETWEEN_QUESTIONS, out)), asks(1));
        // What was committed before they came may be more than the first answer.
        assert_eq!(does(|out| reads.answered(2_000, 1, Ok(5), out)), tells(2..1000, &Ok(5)));
        assert_eq!(reads.wakes_at(), None, "nobody waits");
        assert_eq!(does(|out| reads.ask(3_000, Client(1), out)), asks(2), "after a quiet moment at once");
    }

    #[test]
    fn nothing_is_asked_for_those_who_have_gone_away() {
        let mut reads = Reads::new(9);
        assert_eq!(does(|out| reads.ask(0, Client(1), out)), asks(0));
        assert_eq!(does(|out| reads.ask(1, Client(0), out)), []);
        assert_eq!(does(|out| reads.answered(BETWEEN_QUESTIONS, 0, Ok(3), out)), tells([1], &Ok(3)));
        assert_eq!(reads.wakes_at(), None);
    }

    #[test]
    fn an_answer_counts_when_this_node_has_executed_so_far() {
        let mut reads = Reads::new(9);
        let _asks = does(|out| reads.ask(0, Client(1), out));
        assert_eq!(does(|out| reads.answered(1, 0, Ok(11), out)), []);
        assert_eq!(does(|out| reads.executed(2, 10, out)), []);
        assert_eq!(does(|out| reads.executed(3, 11, out)), tells([1], &Ok(11)));
    }

    #[test]
    fn a_node_that_does_not_get_so_far_says_how_far_it_is() {
        let mut reads = Reads::new(9);
        let _asks = does(|out| reads.ask(0, Client(1), out));
        let _waits = does(|out| reads.answered(1, 0, Ok(11), out));
        assert_eq!(does(|out| reads.time(WAIT_FOR_HEIGHT, out)), [], "not yet");
        let told = does(|out| reads.time(1 + WAIT_FOR_HEIGHT, out));
        let [ReadEffect::Tell { known: Err(reason), .. }] = told.as_slice() else { unreachable!("{told:?}") };
        assert_eq!(
            (reason.code, reason.wanted.as_str(), reason.found.as_str()),
            (Code::Behind, "height 11", "height 9")
        );
    }

    #[test]
    fn a_question_that_is_lost_or_refused_is_asked_again_until_its_time_is_over() {
        let mut reads = Reads::new(9);
        assert_eq!(does(|out| reads.ask(0, Client(1), out)), asks(0));
        assert_eq!(does(|out| reads.time(FIRST_ATTEMPT - 1, out)), []);
        assert_eq!(does(|out| reads.time(FIRST_ATTEMPT, out)), [], "a pause");
        assert_eq!(does(|out| reads.answered(FIRST_ATTEMPT, 0, Ok(1), out)), [], "too late");
        assert_eq!(does(|out| reads.time(FIRST_ATTEMPT + REFUSED_PAUSE, out)), asks(1));
        let _refused = does(|out| reads.answered(200_000, 1, Err(refusal()), out));
        assert_eq!(reads.wakes_at(), Some(200_000 + REFUSED_PAUSE));
        assert_eq!(does(|out| reads.time(200_000 + REFUSED_PAUSE, out)), asks(2));
        assert_eq!(does(|out| reads.answered(300_000, 2, Ok(4), out)), tells([1], &Ok(4)));

        let asked_again = does(|out| reads.ask(2_000_000, Client(2), out));
        assert_eq!(asked_again, asks(3));
        let mut attempts = 1;
        let (told, now) = loop {
            let now = reads.wakes_at().unwrap_or(u64::MAX);
            let out = does(|out| reads.time(now, out));
            match out.as_slice() {
                [ReadEffect::Ask { .. }] => attempts += 1,
                [] => {}
                _ => break (out, now),
            }
        };
        assert_eq!(told, tells([2], &Err(unconfirmed())));
        assert!(attempts == 3 && now <= 2_000_000 + CONFIRM_TIME_MAX, "{attempts} attempts until {now}");
    }

    #[test]
    #[should_panic(expected = "everybody who asks is told")]
    fn somebody_who_waits_for_no_question_is_found() {
        let mut reads = Reads::new(5);
        reads.waiting.push(Client(1));
        does(|out| reads.executed(0, 6, out));
    }

    #[test]
    #[should_panic(expected = "one question is asked at a time")]
    fn a_second_question_beside_the_first_is_found() {
        let mut reads = Reads::new(5);
        does(|out| reads.ask(0, Client(1), out));
        does(|out| reads.begin(0, out));
    }

    #[test]
    #[should_panic(expected = "a state is called current when it is executed; found state 5, called current at Ok(6)")]
    fn a_state_that_is_called_current_too_early_is_found() {
        let mut reads = Reads::new(5);
        does(|out| reads.ask(0, Client(1), out));
        does(|out| reads.tell(0, &Ok(6), out));
    }

    #[test]
    #[should_panic(expected = "executed heights only grow; found block 4 after 5")]
    fn a_height_that_goes_back_is_found() {
        invariant::look_closely();
        does(|out| Reads::<Client>::new(5).executed(0, 4, out));
    }
}
