//! Bytes that count for no identity count for the node that has forwarded them: those without a valid signature, and repetitions.
//!
//! The leader orders what other nodes forward, and a signature is verified when the block is executed. Until then it remembers
//! who has forwarded which bytes. An honest gateway checks signatures before it forwards anything.

use super::account::{Counted, Level, Rate};
use bytes::Bytes;
use ledger_base::rejection::Code;
use std::collections::{HashMap, VecDeque};
use std::hash::{BuildHasher, RandomState};

/// Transactions of which it is remembered who has forwarded them: more than the queues of a leader hold.
const REMEMBERED_MAX: usize = 1 << 16;
/// The bytes and transactions a second that a node may forward although their signature is not valid. An honest gateway has some
/// when a certificate is revoked meanwhile.
const NOT_VALID: Rate = Rate { bytes: 1 << 20, messages: 1000 };
/// The same for transactions that come twice or too late. An honest gateway has many of them after an election or under load.
const REPEATED: Rate = Rate { bytes: 16 << 20, messages: 16_000 };

/// The nodes that forward, as the leader sees them.
#[derive(Default)]
pub(super) struct Forwarders {
    /// Keyed with randomness of this process, so that two transactions of one number cannot be made up.
    state: RandomState,
    from: HashMap<u64, u64>,
    order: VecDeque<u64>,
    owed: HashMap<u64, Level>,
}

impl Forwarders {
    /// A node forwards this transaction.
    pub(super) fn forwarded(&mut self, from: u64, transaction: &Bytes) {
        let number = self.state.hash_one(transaction);
        if self.from.insert(number, from).is_none() {
            self.order.push_back(number);
        }
        if self.order.len() > REMEMBERED_MAX
            && let Some(oldest) = self.order.pop_front()
        {
            self.from.remove(&oldest);
        }
    }

    /// An executed block has this transaction, which ended with this code and counts for no identity.
    pub(super) fn not_counted(&mut self, transaction: &Bytes, code: u32, time: u64) {
        if let Some(from) = self.from.get(&self.state.hash_one(transaction)) {
            let counted = Counted { bytes: transaction.len() as u64, messages: 1 };
            let repeated = [Code::Duplicate, Code::Expired].iter().any(|late| u32::from(late.number()) == code);
            self.owed.entry(*from).or_default().count(if repeated { REPEATED } else { NOT_VALID }, time, counted);
        }
    }

    /// Time until what a node has forwarded and no identity is charged for is a burst at most, microseconds.
    pub(super) fn wait(&self, from: u64, clock: u64) -> u64 {
        self.owed.get(&from).map_or(0, |level| level.wait(clock))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: u64 = 1_000_000;
    const FORGED: u32 = Code::BadSignature.number() as u32;

    fn bytes(number: usize) -> Bytes {
        number.to_be_bytes().to_vec().into()
    }

    #[test]
    fn what_has_no_valid_signature_counts_for_the_node_that_forwarded_it_last() {
        let mut forwarders = Forwarders::default();
        let large = Bytes::from(vec![7; 1 << 20]);
        forwarders.forwarded(2, &bytes(1));
        forwarders.forwarded(3, &large);
        for _ in 0..5 {
            forwarders.not_counted(&large, FORGED, SECOND);
        }
        forwarders.not_counted(&bytes(9), FORGED, SECOND);
        assert_eq!([2, 3].map(|node| forwarders.wait(node, SECOND)), [0, SECOND]);
        assert_eq!(forwarders.wait(3, 2 * SECOND), 0, "it is paid in time");
    }

    #[test]
    fn what_comes_twice_or_late_counts_for_a_sixteenth() {
        let mut forwarders = Forwarders::default();
        let large = Bytes::from(vec![7; 1 << 20]);
        forwarders.forwarded(2, &large);
        for _ in 0..40 {
            forwarders.not_counted(&large, Code::Duplicate.number().into(), 0);
            forwarders.not_counted(&large, Code::Expired.number().into(), 0);
        }
        assert_eq!(forwarders.wait(2, 0), SECOND, "80 MiB, of which 64 are a burst");
    }

    #[test]
    fn the_memory_for_it_is_bounded() {
        let mut forwarders = Forwarders::default();
        for number in 0..REMEMBERED_MAX + 10 {
            forwarders.forwarded(2, &bytes(number));
            forwarders.forwarded(2, &bytes(number));
        }
        assert_eq!((forwarders.from.len(), forwarders.order.len()), (REMEMBERED_MAX, REMEMBERED_MAX));
        forwarders.not_counted(&bytes(0), FORGED, 0);
        assert!(forwarders.owed.is_empty(), "it was forgotten");
    }
}
