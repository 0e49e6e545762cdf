//! Messages that wait for the next answer of the voters.

use std::{collections::VecDeque, time::Instant};

use bytes::Bytes;

use crate::gate::{Delivered, Refused};

/// Most messages that wait; the oldest make room.
const HELD_MAX: usize = 64;

/// A message that waits.
pub(super) struct Waiting {
    /// The block.
    pub(super) height: u64,
    /// When it came.
    pub(super) came: Instant,
    block_time: u64,
    transaction: Bytes,
    certificate: Bytes,
    refused: Refused,
}

/// The messages that wait, in the order in which they came.
#[derive(Default)]
pub(super) struct Held(VecDeque<Waiting>);

impl Waiting {
    /// As the node delivered it.
    pub(super) fn delivered(&self) -> Delivered<'_> {
        Delivered { block_time: self.block_time, transaction: &self.transaction, certificate: &self.certificate }
    }
}

impl Held {
    /// Keeps a message of a block, with the creator's certificate if that came along, and why it did not pass. Answers with the
    /// height and the reason of one that can wait no longer.
    pub(super) fn push(
        &mut self,
        (height, block_time): (u64, u64),
        (transaction, certificate): (Bytes, Bytes),
        refused: Refused,
    ) -> Option<(u64, Refused)> {
        let came = Instant::now();
        self.0.push_back(Waiting { height, came, block_time, transaction, certificate, refused });
        let crowded_out = if self.0.len() > HELD_MAX { self.0.pop_front() } else { None };
        crowded_out.map(|waiting| (waiting.height, waiting.refused))
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
        let mut push = |height, refused| held.push((height, 1), (Bytes::new(), Bytes::new()), refused);
        assert_eq!(push(1, Refused::UnknownEpoch), None);
        assert!((2..=HELD_MAX as u64).all(|height| push(height, Refused::Stale).is_none()));
        assert_eq!(push(99, Refused::Stale), Some((1, Refused::UnknownEpoch)));
        assert_eq!(held.take().len(), HELD_MAX);
        assert!(held.take().is_empty());
    }
}
