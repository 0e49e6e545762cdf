//! What waits to become a block: two lanes, each bounded in count and bytes.

use crate::interface::Lane;
use ledger::block::{PAYLOAD_BYTES_MAX, TRANSACTIONS_MAX};
use ledger::{Bytes, Code, Rejection};
use std::collections::VecDeque;

/// Most control transactions that wait. They are few and small; a longer queue means that nothing is ordered.
pub const CONTROL_QUEUE_TRANSACTIONS_MAX: usize = 4096;
/// Most bytes of control transactions that wait.
pub const CONTROL_QUEUE_BYTES_MAX: usize = 8 * 1024 * 1024;
/// Most data transactions that wait: about a second of the load a leader carries, so that a client learns of an
/// overload within its patience instead of waiting in a queue without end.
pub const DATA_QUEUE_TRANSACTIONS_MAX: usize = 16_384;
/// Most bytes of data transactions that wait.
pub const DATA_QUEUE_BYTES_MAX: usize = 32 * 1024 * 1024;

const _: () = assert!(CONTROL_QUEUE_BYTES_MAX >= PAYLOAD_BYTES_MAX && DATA_QUEUE_BYTES_MAX >= PAYLOAD_BYTES_MAX);

/// How full a queue is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct QueueStatus {
    /// Transactions that wait.
    pub transactions: usize,
    /// Their bytes.
    pub bytes: usize,
}

/// A transaction that waits.
#[derive(Debug)]
pub(crate) struct Waiting {
    /// The signed bytes.
    pub(crate) transaction: Bytes,
    /// The peer that forwarded it, who is told if it is dropped; `None` if it was submitted here.
    pub(crate) origin: Option<u64>,
}

/// A transaction that could not be taken in, and why.
pub(crate) type Refused = Box<(Waiting, Rejection)>;

/// One lane.
#[derive(Debug)]
pub(crate) struct Queue {
    items: VecDeque<Waiting>,
    bytes: usize,
    transactions_max: usize,
    bytes_max: usize,
}

/// Both lanes.
#[derive(Debug)]
pub(crate) struct Queues {
    /// First into every block.
    pub(crate) control: Queue,
    /// Fills what is left.
    pub(crate) data: Queue,
}

/// How many transactions of each lane the next block takes, and their bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Cut {
    pub(crate) control: usize,
    pub(crate) data: usize,
    pub(crate) bytes: usize,
}

impl Queue {
    fn new(transactions_max: usize, bytes_max: usize) -> Self {
        Self { items: VecDeque::new(), bytes: 0, transactions_max, bytes_max }
    }

    fn push(&mut self, waiting: Waiting) -> Result<(), Refused> {
        let bytes = waiting.transaction.len();
        if bytes > PAYLOAD_BYTES_MAX {
            let reason = Rejection::new(Code::TooLarge, "transaction does not fit a block")
                .found(format!("{bytes} bytes"))
                .wanted(format!("at most {PAYLOAD_BYTES_MAX} bytes"))
                .next("split it");
            return Err(Box::new((waiting, reason)));
        }
        if self.items.len() >= self.transactions_max || self.bytes.saturating_add(bytes) > self.bytes_max {
            let reason = Rejection::new(Code::Overloaded, "too many transactions wait to be ordered")
                .found(format!("{} transactions, {} bytes", self.items.len(), self.bytes))
                .wanted(format!("at most {} transactions, {} bytes", self.transactions_max, self.bytes_max))
                .next("submit it again later, unchanged");
            return Err(Box::new((waiting, reason)));
        }
        self.bytes += bytes;
        self.items.push_back(waiting);
        Ok(())
    }

    /// Takes the first `count`.
    pub(crate) fn take(&mut self, count: usize) -> impl Iterator<Item = Waiting> + '_ {
        let count = count.min(self.items.len());
        self.bytes -= self.items.iter().take(count).map(|waiting| waiting.transaction.len()).sum::<usize>();
        self.items.drain(..count)
    }

    /// How full it is.
    pub(crate) fn status(&self) -> QueueStatus {
        QueueStatus { transactions: self.items.len(), bytes: self.bytes }
    }

    fn peek(&self, count: usize) -> impl Iterator<Item = Bytes> + '_ {
        self.items.iter().take(count).map(|waiting| waiting.transaction.clone())
    }

    fn cut(&self, cut: &mut Cut, bytes_target: usize) -> usize {
        let before = cut.control + cut.data;
        let mut taken = 0;
        for waiting in &self.items {
            let (count, bytes) = (before + taken, waiting.transaction.len());
            let full = cut.bytes >= bytes_target || cut.bytes + bytes > bytes_target.max(bytes);
            if count >= TRANSACTIONS_MAX || (count > 0 && (full || cut.bytes + bytes > PAYLOAD_BYTES_MAX)) {
                break;
            }
            cut.bytes += bytes;
            taken += 1;
        }
        taken
    }
}

impl Queues {
    pub(crate) fn new() -> Self {
        Self {
            control: Queue::new(CONTROL_QUEUE_TRANSACTIONS_MAX, CONTROL_QUEUE_BYTES_MAX),
            data: Queue::new(DATA_QUEUE_TRANSACTIONS_MAX, DATA_QUEUE_BYTES_MAX),
        }
    }

    /// Appends to a lane, or says why not and gives the transaction back.
    pub(crate) fn push(&mut self, lane: Lane, waiting: Waiting) -> Result<(), Refused> {
        match lane {
            Lane::Control => self.control.push(waiting),
            Lane::Data => self.data.push(waiting),
        }
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.control.items.is_empty() && self.data.items.is_empty()
    }

    /// What the next block holds: control first, then data, up to about `bytes_target`, at least one transaction.
    pub(crate) fn cut(&self, bytes_target: usize) -> Cut {
        let mut cut = Cut::default();
        cut.control = self.control.cut(&mut cut, bytes_target);
        // A lane that was cut short has filled the block.
        if cut.control == self.control.items.len() {
            cut.data = self.data.cut(&mut cut, bytes_target);
        }
        cut
    }

    /// The transactions of a cut, left in place.
    pub(crate) fn peek(&self, cut: Cut) -> Vec<Bytes> {
        self.control.peek(cut.control).chain(self.data.peek(cut.data)).collect()
    }

    /// Takes the transactions of a cut out.
    pub(crate) fn take(&mut self, cut: Cut) -> impl Iterator<Item = Waiting> + '_ {
        self.control.take(cut.control).chain(self.data.take(cut.data))
    }

    /// Takes everything out.
    pub(crate) fn take_all(&mut self) -> impl Iterator<Item = Waiting> + '_ {
        self.take(Cut { control: usize::MAX, data: usize::MAX, bytes: 0 })
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    fn waiting(bytes: usize) -> Waiting {
        Waiting { transaction: vec![7; bytes].into(), origin: None }
    }

    #[test]
    fn control_comes_before_data_that_was_there_first() {
        let mut queues = Queues::new();
        queues.push(Lane::Data, waiting(10)).unwrap();
        queues.push(Lane::Control, waiting(3)).unwrap();
        let cut = queues.cut(1000);
        assert_eq!(queues.peek(cut).iter().map(Bytes::len).collect::<Vec<_>>(), [3, 10]);
    }

    #[test]
    fn a_block_holds_at_least_one_transaction_and_about_the_target() {
        let mut queues = Queues::new();
        for _ in 0..4 {
            queues.push(Lane::Data, waiting(40)).unwrap();
        }
        assert_eq!(queues.cut(1), Cut { control: 0, data: 1, bytes: 40 });
        assert_eq!(queues.cut(100), Cut { control: 0, data: 2, bytes: 80 });
        assert_eq!(queues.cut(1000), Cut { control: 0, data: 4, bytes: 160 });
    }

    #[test]
    fn a_block_never_exceeds_the_limits_of_a_payload() {
        let mut queues = Queues::new();
        for _ in 0..=TRANSACTIONS_MAX {
            queues.push(Lane::Data, waiting(0)).unwrap();
        }
        assert_eq!(queues.cut(1000).data, TRANSACTIONS_MAX);
        let mut queues = Queues::new();
        queues.push(Lane::Data, waiting(PAYLOAD_BYTES_MAX)).unwrap();
        queues.push(Lane::Data, waiting(1)).unwrap();
        assert_eq!(queues.cut(usize::MAX).data, 1);
    }

    #[test]
    fn a_full_lane_refuses_and_the_other_does_not() {
        let mut queues = Queues::new();
        for _ in 0..DATA_QUEUE_TRANSACTIONS_MAX {
            queues.push(Lane::Data, waiting(1)).unwrap();
        }
        assert_eq!(queues.push(Lane::Data, waiting(1)).unwrap_err().1.code, Code::Overloaded);
        queues.push(Lane::Control, waiting(1)).unwrap();
        assert_eq!(queues.take_all().count(), DATA_QUEUE_TRANSACTIONS_MAX + 1);
        assert!(queues.is_empty());
        assert_eq!(queues.data.status(), QueueStatus::default());
    }

    #[test]
    fn a_lane_is_bounded_in_bytes() {
        let mut queues = Queues::new();
        for _ in 0..DATA_QUEUE_BYTES_MAX / PAYLOAD_BYTES_MAX {
            queues.push(Lane::Data, waiting(PAYLOAD_BYTES_MAX)).unwrap();
        }
        assert_eq!(queues.push(Lane::Data, waiting(1)).unwrap_err().1.code, Code::Overloaded);
        assert_eq!(queues.push(Lane::Data, waiting(PAYLOAD_BYTES_MAX + 1)).unwrap_err().1.code, Code::TooLarge);
    }
}
