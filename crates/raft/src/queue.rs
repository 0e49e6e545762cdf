//! Transactions that wait to become a block: two lanes, each bounded in count and bytes, and the data lane in time.

mod creators;
mod fair;

pub use creators::Creators;

use crate::interface::Lane;
use bytes::Bytes;
use fair::Queue;
use ledger::block::PAYLOAD_BYTES_MAX;
use ledger_base::rejection::{Code, Rejection};

/// Most control transactions that wait. They are few and small; a longer queue means that nothing is ordered.
pub const CONTROL_QUEUE_TRANSACTIONS_MAX: usize = 4096;
/// Most bytes of control transactions that wait.
pub const CONTROL_QUEUE_BYTES_MAX: usize = 8 * 1024 * 1024;
/// Most data transactions that wait: about a second of the load a leader carries. Usually time is the limit: see
/// `EngineConfig::data_wait_us`.
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
    /// When it came, microseconds.
    pub(crate) since: u64,
}

/// Both lanes.
#[derive(Debug)]
pub(crate) struct Queues {
    /// First into every block.
    pub(crate) control: Queue,
    /// Fills what is left.
    pub(crate) data: Queue,
}

/// How many transactions of each lane the next block takes, and what they cost to execute (bytes that cost as much).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Cut {
    pub(crate) control: usize,
    pub(crate) data: usize,
    pub(crate) cost: usize,
}

impl Cut {
    pub(crate) fn is_empty(&self) -> bool {
        self.control == 0 && self.data == 0
    }
}

impl Queues {
    pub(crate) fn new(creators: &Creators) -> Self {
        let queue = |transactions, bytes| Queue::new(transactions, bytes, creators.clone());
        Self {
            control: queue(CONTROL_QUEUE_TRANSACTIONS_MAX, CONTROL_QUEUE_BYTES_MAX),
            data: queue(DATA_QUEUE_TRANSACTIONS_MAX, DATA_QUEUE_BYTES_MAX),
        }
    }

    /// Takes a transaction into a lane. Answers with what is refused for it: itself, or others of the lane.
    pub(crate) fn push(&mut self, lane: Lane, waiting: Waiting) -> Vec<(Waiting, Rejection)> {
        match lane {
            Lane::Control => self.control.push(waiting),
            Lane::Data => self.data.push(waiting),
        }
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.control.is_empty() && self.data.is_empty()
    }

    /// The content of the next block: control first, then data until it costs `data_cost_max`, together up to about
    /// `bytes_target`. It has at least one transaction, unless only data waits and may cost nothing.
    pub(crate) fn cut(&self, bytes_target: usize, data_cost_max: usize) -> Cut {
        let control = self.control.cut(0, 0, bytes_target, usize::MAX);
        let mut cut = Cut { control: control.transactions, data: 0, cost: control.cost };
        // A lane that was cut short has filled the block.
        if control.transactions == self.control.status().transactions {
            let data = self.data.cut(control.transactions, control.bytes, bytes_target, data_cost_max);
            (cut.data, cut.cost) = (data.transactions, cut.cost + data.cost);
        }
        cut
    }

    /// Takes out data that waited too long to be worth ordering, as far as `data_cost_max` would order it now.
    pub(crate) fn take_late(&mut self, now: u64, wait_us_max: u64, data_cost_max: usize) -> Vec<(Waiting, Rejection)> {
        let waited = |waiting: &Waiting| now.saturating_sub(waiting.since) / 1000;
        let refuse = |waiting: Waiting| {
            let reason = Rejection::new(Code::Overloaded, "more arrives than can be ordered in time")
                .found(format!("it waited {} ms to be ordered", waited(&waiting)))
                .wanted(format!("at most {} ms", wait_us_max / 1000));
            (waiting, reason)
        };
        self.data.take_late(now, wait_us_max, data_cost_max).into_iter().map(refuse).collect()
    }

    /// The transactions of a cut, left in place.
    pub(crate) fn peek(&self, cut: Cut) -> Vec<Bytes> {
        self.control.peek(cut.control).chain(self.data.peek(cut.data)).collect()
    }

    /// Takes the transactions of a cut out.
    pub(crate) fn take(&mut self, cut: Cut) -> Vec<Waiting> {
        let mut taken = self.control.take(cut.control);
        taken.append(&mut self.data.take(cut.data));
        taken
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ledger::block::TRANSACTIONS_MAX;

    const FREE: usize = usize::MAX;

    fn push(queues: &mut Queues, lane: Lane, bytes: usize) -> Vec<Code> {
        let waiting = Waiting { transaction: vec![7; bytes].into(), origin: None, since: 0 };
        queues.push(lane, waiting).into_iter().map(|(_, reason)| reason.code).collect()
    }

    #[test]
    fn control_comes_before_data_that_was_there_first() {
        let mut queues = Queues::new(&Creators::default());
        push(&mut queues, Lane::Data, 10);
        push(&mut queues, Lane::Control, 3);
        let cut = queues.cut(1000, FREE);
        assert_eq!(queues.peek(cut).iter().map(Bytes::len).collect::<Vec<_>>(), [3, 10]);
    }

    #[test]
    fn control_goes_on_while_data_has_to_wait() {
        let mut queues = Queues::new(&Creators::default());
        push(&mut queues, Lane::Data, 10);
        assert!(queues.cut(1000, 0).is_empty());
        push(&mut queues, Lane::Control, 3);
        let cut = queues.cut(1000, 0);
        assert_eq!((cut.control, cut.data), (1, 0));
        assert_eq!(queues.cut(1000, 1).data, 1, "one at least, when there is room at all");
    }

    #[test]
    fn a_block_holds_at_least_one_transaction_and_about_the_target() {
        let mut queues = Queues::new(&Creators::default());
        for _ in 0..4 {
            push(&mut queues, Lane::Data, 40);
        }
        assert_eq!(queues.cut(1, FREE).data, 1);
        assert_eq!(queues.cut(100, FREE).data, 2);
        assert_eq!(queues.cut(1000, FREE).data, 4);
    }

    #[test]
    fn a_block_never_exceeds_the_limits_of_a_payload() {
        let mut queues = Queues::new(&Creators::default());
        for _ in 0..=TRANSACTIONS_MAX {
            push(&mut queues, Lane::Data, 0);
        }
        assert_eq!(queues.cut(1000, FREE).data, TRANSACTIONS_MAX);
        let mut queues = Queues::new(&Creators::default());
        push(&mut queues, Lane::Data, PAYLOAD_BYTES_MAX);
        push(&mut queues, Lane::Data, 1);
        assert_eq!(queues.cut(usize::MAX, FREE).data, 1);
    }

    #[test]
    fn a_full_lane_refuses_and_the_other_does_not() {
        let mut queues = Queues::new(&Creators::default());
        for _ in 0..DATA_QUEUE_TRANSACTIONS_MAX {
            assert_eq!(push(&mut queues, Lane::Data, 1), []);
        }
        assert_eq!(push(&mut queues, Lane::Data, 1), [Code::Overloaded]);
        assert_eq!(push(&mut queues, Lane::Control, 1), []);
        assert_eq!(queues.data.take(FREE).len() + queues.control.take(FREE).len(), DATA_QUEUE_TRANSACTIONS_MAX + 1);
        assert!(queues.is_empty());
        assert_eq!(queues.data.status(), QueueStatus::default());
    }

    #[test]
    fn a_lane_is_bounded_in_bytes() {
        let mut queues = Queues::new(&Creators::default());
        for _ in 0..DATA_QUEUE_BYTES_MAX / PAYLOAD_BYTES_MAX {
            assert_eq!(push(&mut queues, Lane::Data, PAYLOAD_BYTES_MAX), []);
        }
        assert_eq!(push(&mut queues, Lane::Data, 1), [Code::Overloaded]);
        assert_eq!(push(&mut queues, Lane::Data, PAYLOAD_BYTES_MAX + 1), [Code::TooLarge]);
    }

    #[test]
    fn data_that_waited_too_long_says_so() {
        let mut queues = Queues::new(&Creators::default());
        for _ in 0..200 {
            push(&mut queues, Lane::Data, 1);
        }
        let late = queues.take_late(300_001, 200_000, FREE);
        assert!(!late.is_empty());
        for (_, reason) in late {
            assert_eq!(reason.code, Code::Overloaded);
            assert!(reason.found.contains("300 ms") && reason.wanted.contains("200 ms"), "{reason}");
        }
    }
}
