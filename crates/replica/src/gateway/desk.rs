//! Serves one stream of submissions: what has come, what is held, and what is looked at next.
//!
//! The owner of a desk brings it what arrives and the answers to its questions, and lets it look while it has a
//! [turn](super::Turns).

use super::admission::{Admitting, Decision};
use super::held::{Held, Item};
use super::line::{Arrived, Line};
use crate::reads::Known;
use crate::waiters::Waiter;
use ledger_raft::Lane;

/// Signatures that are checked together in one turn.
const TOGETHER_MAX: usize = 16;

/// The next work of a desk, for which it needs a turn of a lane.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Job {
    /// Decide on what was held: it is known now whether the state is current.
    Decide(Lane),
    /// Look at what has come.
    Look(Lane),
}

impl Job {
    /// The lane whose turn it needs.
    pub fn lane(self) -> Lane {
        match self {
            Self::Decide(lane) | Self::Look(lane) => lane,
        }
    }
}

/// The result of a look at a transaction.
#[expect(clippy::large_enum_variant, reason = "it is handed on at once and kept nowhere")]
pub enum Looked<'a, C> {
    /// It is held at the desk from now on.
    Held(&'a Item<C>),
    /// This is to be done.
    Decided(Decision<C>),
}

/// The state of one stream.
pub struct Desk<C> {
    line: Line<C>,
    /// Calls that the state refuses, until it is known whether the state is current.
    held: Held<C>,
}

impl<C> Default for Desk<C> {
    fn default() -> Self {
        Self { line: Line::default(), held: Held::default() }
    }
}

impl<C: Waiter> Desk<C> {
    /// Something has come.
    pub fn take_in(&mut self, arrived: Arrived<C>) {
        self.line.push(arrived);
    }

    /// How many have come and were not looked at.
    pub fn waiting(&self) -> usize {
        self.line.len()
    }

    /// Is there nothing more to be answered here?
    pub fn is_empty(&self) -> bool {
        self.line.len() == 0 && self.held.is_empty()
    }

    /// Is anything held?
    pub fn holds(&self) -> bool {
        !self.held.is_empty()
    }

    /// Is the question to be asked whether the state is current? Then ask ([`crate::Reads::ask`]), and tell
    /// [`Desk::answered`]. To be called after every look.
    pub fn asks(&mut self) -> bool {
        self.held.asks()
    }

    /// The answer to the question that this desk has asked.
    pub fn answered(&mut self, known: Known) {
        self.held.answered(known);
    }

    /// The next job. Control goes first, and what was held goes before what came later.
    pub fn next(&self) -> Option<Job> {
        match (self.held.due(), self.line.next()) {
            (Some(Lane::Control), _) => Some(Job::Decide(Lane::Control)),
            (_, Some(Lane::Control)) => Some(Job::Look(Lane::Control)),
            (Some(Lane::Data), _) => Some(Job::Decide(Lane::Data)),
            (None, Some(Lane::Data)) => Some(Job::Look(Lane::Data)),
            (None, None) => None,
        }
    }

    /// The height that must be executed before a job.
    pub fn min_height(&mut self, job: Job) -> u64 {
        match job {
            Job::Decide(_) => 0,
            Job::Look(lane) => self.line.min_height(lane).unwrap_or(0),
        }
    }

    /// The height of a job is reached, or the state is current: then there is no such height, whoever has told it.
    pub fn reached(&mut self, job: Job) {
        if let Job::Look(lane) = job {
            self.line.reached(lane);
        }
    }

    /// Takes the first of a lane out, which waits for a height in vain.
    pub fn give_up(&mut self, lane: Lane) -> Option<Arrived<C>> {
        self.line.take(lane)
    }

    /// To be done at the beginning of a turn: data that has waited too long is refused, and the signatures of the next few
    /// are checked together.
    pub fn begin(&mut self, job: Job, node: &Admitting<'_, C>, out: impl FnMut(Decision<C>)) {
        let Job::Look(lane) = job else { return };
        if lane == Lane::Data {
            let late = self.line.take_late(node.now.elapsed, node.wait_max).into_iter();
            late.map(|(arrived, reason)| Admitting::refuse(arrived, reason)).for_each(out);
        }
        node.ledger.verify_together(self.line.first(lane, TOGETHER_MAX), node.now.clock);
    }

    /// Does a job until `out`, which hears of everything that was looked at, says that it is enough.
    pub fn work(&mut self, job: Job, node: &Admitting<'_, C>, out: impl FnMut(Looked<'_, C>) -> bool) {
        match job {
            Job::Decide(lane) => self.decide(lane, node, out),
            Job::Look(lane) => self.look(lane, node, out),
        }
    }

    fn decide(&mut self, lane: Lane, node: &Admitting<'_, C>, mut out: impl FnMut(Looked<'_, C>) -> bool) {
        while self.held.due() == Some(lane)
            && let Some((item, known)) = self.held.take(lane)
            && out(Looked::Decided(node.look_again(item, &known)))
        {}
    }

    fn look(&mut self, lane: Lane, node: &Admitting<'_, C>, mut out: impl FnMut(Looked<'_, C>) -> bool) {
        let height = node.ledger.tip().height;
        while self.line.min_height(lane).is_some_and(|wanted| wanted <= height)
            && let Some(arrived) = self.line.take(lane)
        {
            let looked_at = match self.held.holds_back(&arrived) {
                true => Decision::Hold(Item { arrived, refusal: None }),
                false => node.look(arrived),
            };
            let goes_on = match looked_at {
                Decision::Hold(item) => {
                    let goes_on = out(Looked::Held(&item));
                    self.held.push(item);
                    goes_on
                }
                decision => out(Looked::Decided(decision)),
            };
            if !goes_on {
                break;
            }
        }
    }
}
