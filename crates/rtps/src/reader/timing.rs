//! When a reader answers a writer.

/// Time from a HEARTBEAT to the ACKNACK, microseconds: what is on its way meanwhile is not asked for.
const ANSWER_DELAY_MICROS: u64 = 1000;
/// Time without a new fragment after which a sample is requested that no HEARTBEAT has announced, microseconds.
pub(super) const STALLED_MICROS: u64 = 100_000;
/// Time between two ACKNACKs that ask for the first HEARTBEAT, microseconds. Fast DDS may need several: it knows this reader later.
pub(super) const FIRST_HEARTBEAT_MICROS: u64 = 5_000_000;
/// Time to the first of them where a sample waits for the HEARTBEAT, microseconds.
const FIRST_HEARTBEAT_MICROS_MIN: u64 = 10_000;

/// When a writer gets an answer.
#[derive(Debug)]
pub(super) struct Timing {
    /// Grows with each ACKNACK and NACK_FRAG. Fast DDS ignores 0, and what does not grow.
    pub(super) count: i32,
    pub(super) due: Option<u64>,
    /// A HEARTBEAT wants an answer.
    pub(super) is_asked: bool,
    /// Samples, fragments and gaps that came.
    pub(super) came: u64,
    /// When the last fragment came.
    pub(super) fragment_at: u64,
    pub(super) interval: u64,
    /// The last request.
    pub(super) request: Option<Request>,
}

/// When something was requested, and where the reader stood.
#[derive(Clone, Copy, Debug)]
pub(super) struct Request {
    pub(super) at: u64,
    pub(super) next: i64,
    pub(super) came: u64,
}

impl Timing {
    /// The first ACKNACK is due at once: it makes the writer send a HEARTBEAT.
    pub(super) fn new(now: u64, count: i32) -> Self {
        let interval = FIRST_HEARTBEAT_MICROS_MIN;
        Self { count, due: Some(now), is_asked: false, came: 0, fragment_at: 0, interval, request: None }
    }

    /// All begins again. The count goes on.
    pub(super) fn restart(&mut self, now: u64) {
        *self = Self::new(now, self.count);
    }

    /// A sample, a fragment or a GAP has come.
    pub(super) fn sample(&mut self, now: u64, is_synchronized: bool) {
        if !is_synchronized && self.came == 0 {
            self.schedule(now.saturating_add(FIRST_HEARTBEAT_MICROS_MIN));
        }
        self.came = self.came.saturating_add(1);
    }

    /// A fragment has come of a sample that no HEARTBEAT has announced.
    pub(super) fn fragment(&mut self, now: u64) {
        self.fragment_at = now;
        self.schedule(now.saturating_add(STALLED_MICROS));
    }

    /// A HEARTBEAT has come that requires an answer, or announces something that is missing.
    pub(super) fn heartbeat(&mut self, now: u64, is_missing: bool) {
        self.is_asked = true;
        self.schedule(now.saturating_add(ANSWER_DELAY_MICROS));
        if !is_missing {
            self.request = None;
        }
    }

    pub(super) fn schedule(&mut self, at: u64) {
        self.due = Some(self.due.map_or(at, |due| due.min(at)));
    }

    pub(super) fn next_count(&mut self) -> i32 {
        self.count = self.count.wrapping_add(1);
        self.count
    }
}
