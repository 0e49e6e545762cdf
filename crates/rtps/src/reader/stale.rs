//! Detects a writer whose numbers stay below the watermark of the reader.
//!
//! A forged HEARTBEAT, GAP or sample can lift the watermark above the numbers of the writer. Without this, nothing of it would be
//! delivered until the writer restarts.

/// This many growing numbers in a row, all below.
const STALE_NUMBERS: u32 = 3;
/// And over this time, microseconds. Delayed datagrams arrive within it; if not, still nothing is delivered twice.
const STALE_MICROS: u64 = 100_000;

/// The numbers of a writer that came below those that were passed, since one came above.
#[derive(Debug, Default)]
pub(super) struct StaleNumbers {
    count: u32,
    since: u64,
    last: i64,
}

impl StaleNumbers {
    /// A number came below. True if there is enough evidence.
    pub(super) fn add(&mut self, now: u64, number: i64) -> bool {
        if self.count > 0 && number == self.last {
            return false;
        }
        if self.count == 0 || number < self.last {
            (self.count, self.since) = (0, now);
        }
        self.last = number;
        self.count = self.count.saturating_add(1);
        self.count >= STALE_NUMBERS && now.saturating_sub(self.since) >= STALE_MICROS
    }

    /// A number came that is not below.
    pub(super) fn clear(&mut self) {
        self.count = 0;
    }
}
