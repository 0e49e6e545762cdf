//! A voter that is alone and does not believe its own clock.
//!
//! Where several vote, the clocks of a majority count ([`super::time`]). One that is alone has nobody to ask. Block time
//! never goes back, so a clock that is a year ahead for a second would end every certificate for good. Such a node
//! orders nothing until its clock is right again, or an operator has confirmed it.

use super::Engine;
use super::time::TIME_AHEAD_MAX;
use crate::interface::Output;
use ledger_base::rejection::{Code, Rejection};

/// Why the clock of a machine may be wrong. Both in microseconds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ClockDoubt {
    /// It has jumped ahead, against the steady clock of the machine.
    Ahead(u64),
    /// It was behind block time when the process started, and is since.
    Behind(u64),
}

impl ClockDoubt {
    /// The answer to whatever the only voter would order meanwhile.
    pub fn refusal(self) -> Rejection {
        let (what, found) = match self {
            Self::Ahead(by) => ("has jumped ahead", format!("{} ms ahead of the machine's steady clock", by / 1000)),
            Self::Behind(by) => ("is behind block time since the start", format!("{} ms behind it", by / 1000)),
        };
        Rejection::new(Code::ClockJumped, format!("the clock of the only voter {what}, so it orders nothing"))
            .found(found)
            .wanted(format!("at most {} ms", TIME_AHEAD_MAX / 1000))
    }
}

impl Engine {
    /// From now on this node doubts its clock, or does not any more.
    pub fn doubt_clock(&mut self, doubt: Option<ClockDoubt>) {
        if self.doubt.is_none()
            && let Some(doubt) = doubt.filter(|_| self.membership.is_alone(self.config.id))
        {
            let refusal = doubt.refusal();
            tracing::error!(code = refusal.code.name(), reason = %refusal, "ordering waits for the clock");
        }
        self.doubt = doubt;
    }

    /// Does this node, as the only voter, doubt its clock?
    pub(super) fn waits_for_clock(&self) -> bool {
        self.doubt.is_some() && self.membership.is_alone(self.config.id)
    }

    /// Gives back what waits to be ordered, if this node waits for its clock.
    pub(super) fn refuse_in_doubt(&mut self, out: &mut Vec<Output>) -> bool {
        let Some(doubt) = self.doubt.filter(|_| self.waits_for_clock()) else { return false };
        self.drop_waiting(&doubt.refusal(), out);
        true
    }
}
