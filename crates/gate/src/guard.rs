//! One service of a robot, between a node that may lie and the robot's own side. Events of the node and answers of the voters
//! go in, acts come out.
//!
//! The driver keeps the clocks, asks the questions and publishes. It looks first at [`Guard::overdue`], whatever else there is:
//! a flood of events must not put off a stop. Then come answers, [`Guard::asks_at`], revocations and events, in this order.

mod act;
mod block;
mod held;
mod questions;

#[cfg(test)]
mod tests;

pub use self::act::Act;
pub use self::block::{Block, Told};
use self::{block::changes, held::Held, questions::Questions};
use ledger::CallRef;
use ledger_base::mutation::{Mutation, active};
use ledger_confidential::Keyring;

use crate::{
    gate::{Gate, Now, Refused, Settings},
    service::Service,
    standing::Standing,
};

/// The reason of a stop because nothing comes from the driver.
pub const SILENT: &str = "silent";

/// The gate of a service, with the messages that wait for an answer of the voters, and the times at which to ask and to stop.
#[derive(Debug)]
pub struct Guard {
    gate: Gate,
    questions: Questions,
    held: Held,
    /// Silence of the node after which the robot is stopped, in microseconds.
    stale_us: u64,
    /// When the node last gave a sign of life, by the steady clock (microseconds).
    heard: u64,
}

impl Guard {
    /// Nothing passes until an answer is learnt.
    pub fn new(settings: Settings, service: &str, now: Now) -> Self {
        let stale_us = u64::try_from(settings.stale_after.as_micros()).unwrap_or(u64::MAX);
        Self {
            gate: Gate::new(settings, service, now),
            questions: Questions::new(stale_us, now.steady),
            held: Held::default(),
            stale_us,
            heard: now.steady,
        }
    }

    /// Reads confidential messages with these keys, and with those that publishers share.
    pub fn read_with(&mut self, keyring: Keyring) {
        self.gate.read_with(keyring);
    }

    /// The gate, to look at.
    pub fn gate(&self) -> &Gate {
        &self.gate
    }

    /// The time at which the robot must stop, by the steady clock (microseconds), and why: the node is silent, its voters are,
    /// its driver is, or the driver's lease ends. The earliest of them; none while nobody moves the robot.
    pub fn stop_at(&self) -> Option<(u64, &'static str)> {
        let lease = self.gate.deadline()?;
        let silence = self.heard.saturating_add(self.stale_us);
        let unsigned = self.gate.fresh_until().filter(|_| !active(Mutation::IgnoreStaleness)).unwrap_or(silence);
        let quiet = self.gate.silent_at().unwrap_or(u64::MAX);
        let causes = [(lease, "lease"), (silence, "stale"), (unsigned, "uncertified"), (quiet, SILENT)];
        causes.into_iter().min_by_key(|(due, _)| *due)
    }

    /// Why the robot must stop now, if it must. Then nothing from before passes any more, unless only the driver was silent.
    pub fn overdue(&mut self, now: Now) -> Option<&'static str> {
        let (_, reason) = self.stop_at().filter(|(due, _)| *due <= now.steady)?;
        if reason == SILENT {
            self.gate.paused();
        } else {
            self.stopped(now);
        }
        Some(reason)
    }

    /// The last command is done: nobody moves the robot until the next one.
    pub fn rested(&mut self) {
        self.gate.paused();
    }

    /// The robot is being stopped for a reason of the driver's: nothing from before this moment passes any more.
    pub fn stopped(&mut self, now: Now) {
        self.gate.stopped(now);
    }

    /// When to ask how the robot stands, by the steady clock (microseconds). None if nothing is to be asked, or a question is
    /// under way.
    pub fn asks_at(&self) -> Option<u64> {
        self.questions.due(self.gate.is_moving() || self.gate.has_open_stops())
    }

    /// A question is asked now. Answers since when it must have been asked to count, by the steady clock (microseconds): another
    /// of the same robot may have got such an answer.
    pub fn ask(&mut self, now: Now) -> u64 {
        self.questions.ask(now.steady)
    }

    /// The stops whose verdicts the question asks for.
    pub fn open_stops(&self) -> impl Iterator<Item = CallRef> {
        self.gate.open_stops()
    }

    /// The node reports blocks: see [`Gate::heads`].
    pub fn heads(&mut self, height: u64, hashes: &[u8], now: Now) {
        let was_silent = self.gate.was_silent();
        self.gate.heads(height, hashes, now);
        if self.gate.was_silent() && !was_silent {
            self.questions.changed(now.steady);
        }
    }

    /// The node gives a sign of life, with its block time.
    pub fn heard(&mut self, block_time: u64, now: Now) {
        self.heard = now.steady;
        self.gate.heard(block_time, now);
    }

    /// Takes an event of a block.
    pub fn told(&mut self, block: &mut Block, event: &Told<'_>, now: Now) -> Option<Act> {
        match block.judge(&mut self.gate, event, now) {
            Ok(act) => {
                if changes(event) {
                    self.questions.changed(now.steady);
                }
                act
            }
            Err(refused) if refused.may_pass_later() => {
                self.questions.changed(now.steady);
                self.held.push(block.message(event.index), refused, now.steady)
            }
            Err(refused) => Some(self.refused(refused, block.height)),
        }
    }

    /// A message that does not pass. Some of them end the motion that came before.
    fn refused(&mut self, refused: Refused, height: u64) -> Act {
        if refused.stops() {
            self.gate.paused();
        }
        Act::Refused { refused, height }
    }

    /// Takes how the robot stands, with this service of it, and judges the messages that waited for it. `asked` is when that was
    /// asked, by the steady clock in microseconds.
    pub fn answered(&mut self, service: &Service, standing: &Standing, asked: u64, now: Now) -> Vec<Act> {
        self.questions.answered(asked);
        let over = self.gate.learn(service, standing, asked, now).map(Act::Stop);
        over.into_iter().chain(self.judge_held(Some(asked), now)).collect()
    }

    /// A question has led to no standing: the one before counts for a while. `asked` is when it was asked, by the steady clock in
    /// microseconds, if it was answered at all.
    pub fn unanswered(&mut self, asked: Option<u64>) {
        match asked {
            Some(asked) => self.questions.answered(asked),
            None => self.questions.failed(),
        }
    }

    /// There is no such service, or none that this version knows: nothing passes.
    pub fn gone(&mut self, now: Now) -> Vec<Act> {
        self.gate.close();
        self.judge_held(None, now)
    }

    /// Lets the messages that waited pass, or refuses them. Those that came after the question wait on, for the next one.
    fn judge_held(&mut self, asked: Option<u64>, now: Now) -> Vec<Act> {
        let mut acts = Vec::new();
        for message in self.held.take() {
            match message.judge(&mut self.gate, now) {
                Ok(passed) => acts.push(Act::Publish(passed)),
                Err(refused) if refused.may_pass_later() && asked.is_some_and(|asked| message.came > asked) => {
                    self.held.keep(message);
                }
                Err(refused) => acts.push(self.refused(refused, message.height())),
            }
        }
        acts
    }
}
