//! Messages that wait for the next answer of the voters.

use std::collections::VecDeque;

use bytes::Bytes;

use super::act::Act;
use crate::gate::{Delivered, Gate, Now, Passed, Refused};

/// Most messages that wait; the oldest make room.
const HELD_MAX: usize = 64;

/// A message of a block, as a node has delivered it.
#[derive(Debug, Default)]
pub(super) struct Message {
    pub(super) height: u64,
    pub(super) block_time: u64,
    /// Was its block fetched for those who come late?
    pub(super) is_latched: bool,
    pub(super) transaction: Bytes,
    /// The creator's certificate, if that came along.
    pub(super) certificate: Bytes,
}

/// A message that waits.
#[derive(Debug)]
pub(super) struct Waiting {
    message: Message,
    /// Why it did not pass.
    refused: Refused,
    /// When it came, by the steady clock (microseconds).
    pub(super) came: u64,
}

/// The messages that wait, in the order in which they came.
#[derive(Debug, Default)]
pub(super) struct Held(VecDeque<Waiting>);

impl Waiting {
    /// The block.
    pub(super) fn height(&self) -> u64 {
        self.message.height
    }

    /// The gate's word on it now.
    pub(super) fn judge(&self, gate: &mut Gate, now: Now) -> Result<Passed, Refused> {
        let Message { block_time, is_latched, transaction, certificate, .. } = &self.message;
        let delivered = Delivered { block_time: *block_time, transaction, certificate };
        if *is_latched { gate.pass_latched(delivered, now) } else { gate.pass(delivered, now) }
    }
}

impl Held {
    /// Keeps a message, and why it did not pass. Answers with the refusal of one that can wait no longer.
    pub(super) fn push(&mut self, message: Message, refused: Refused, came: u64) -> Option<Act> {
        self.0.push_back(Waiting { message, refused, came });
        let crowded_out = if self.0.len() > HELD_MAX { self.0.pop_front() } else { None };
        crowded_out.map(|waiting| Act::Refused { refused: waiting.refused, height: waiting.height() })
    }

    /// All that wait, which wait no longer.
    pub(super) fn take(&mut self) -> VecDeque<Waiting> {
        std::mem::take(&mut self.0)
    }

    /// Lets one wait on.
    pub(super) fn keep(&mut self, waiting: Waiting) {
        self.0.push_back(waiting);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_oldest_of_too_many_makes_room_and_is_refused_for_its_reason() {
        let mut held = Held::default();
        let mut push = |height, refused| held.push(Message { height, ..Message::default() }, refused, 0);
        assert_eq!(push(1, Refused::UnknownEpoch), None);
        assert!((2..=HELD_MAX as u64).all(|height| push(height, Refused::Stale).is_none()));
        assert_eq!(push(99, Refused::Stale), Some(Act::Refused { refused: Refused::UnknownEpoch, height: 1 }));
        assert_eq!(held.take().len(), HELD_MAX);
        assert!(held.take().is_empty());
    }
}
