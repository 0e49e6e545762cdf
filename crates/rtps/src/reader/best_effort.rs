//! A matched writer without repair (§8.4.11): samples that are newer than the last one are delivered.

use super::NUMBER_MAX;
use super::content::Content;
use super::ranges::{DeliveredNumbers, NumberRanges};
use super::stale::StaleNumbers;
use super::store::Store;
use crate::endpoint::Delivered;
use crate::guid::Guid;
use crate::interface::LossReason;
use crate::limits::{ASSEMBLY_MICROS_MAX, SAMPLE_BYTES_MAX};
use crate::wire::submessage::{Addressed, DataFrag, Submessage};

/// Most ranges of numbers that were given up and are not delivered all the same.
const GIVEN_UP_MAX: usize = 64;

/// A writer from which samples come without repair.
#[derive(Debug)]
pub(super) struct BestEffortProxy {
    writer: Guid,
    /// The number of the newest sample that was delivered.
    highest: Option<i64>,
    delivered: DeliveredNumbers,
    stale: StaleNumbers,
    pub(super) store: Store,
    /// Numbers above `highest` that were given up, and counted as lost. Their fragments are ignored.
    given_up: NumberRanges,
    /// When the last fragment came.
    fragment_at: u64,
}

impl BestEffortProxy {
    pub(super) fn new(writer: Guid, room: usize) -> Self {
        Self {
            writer,
            highest: None,
            delivered: DeliveredNumbers::default(),
            stale: StaleNumbers::default(),
            store: Store::with_room(room),
            given_up: NumberRanges::default(),
            fragment_at: 0,
        }
    }

    /// DATA and DATA_FRAG. Nothing is asked for, so HEARTBEAT and GAP do not matter.
    pub(super) fn receive(&mut self, now: u64, message: &Addressed, out: &mut Vec<Delivered>) {
        match &message.submessage {
            Submessage::Data(data) if self.is_new(now, data.sequence.0, out) => {
                self.deliver(data.sequence.0, super::content_of(message, data), out);
            }
            Submessage::DataFrag(fragment) if self.is_new(now, fragment.sequence.0, out) => {
                self.assemble(now, message, fragment, out);
            }
            _ => {}
        }
    }

    /// Is it newer than the last sample? If the writer persists in older numbers that were never delivered, they are its numbers.
    fn is_new(&mut self, now: u64, number: i64, out: &mut Vec<Delivered>) -> bool {
        // Also what is newer may have been delivered, before the numbers went back.
        if !(1..=NUMBER_MAX).contains(&number) || self.delivered.contains(number) {
            return false;
        }
        if self.highest.is_none_or(|highest| number > highest) {
            self.stale.clear();
            return true;
        }
        if !self.stale.add(now, number) {
            return false;
        }
        self.stale.clear();
        self.store.clear();
        self.given_up.clear();
        self.highest = Some(number.saturating_sub(1));
        out.push(Delivered::Resynchronized { writer: self.writer });
        true
    }

    fn assemble(&mut self, now: u64, message: &Addressed, fragment: &DataFrag, out: &mut Vec<Delivered>) {
        let number = fragment.sequence.0;
        if self.given_up.end_of(number).is_some() {
            return;
        }
        if usize::try_from(fragment.sample_bytes).is_ok_and(|bytes| bytes > SAMPLE_BYTES_MAX) {
            self.give_up(&[number], LossReason::TooLarge, out);
            return;
        }
        if self.store.put_fragments(number, fragment, message.timestamp) {
            self.fragment_at = now;
        }
        if let Some(content) = self.store.take(number) {
            self.deliver(number, content, out);
        }
        self.give_way(self.store.room(), out);
    }

    /// Drops the oldest samples until at most these bytes wait.
    pub(super) fn give_way(&mut self, room: usize, out: &mut Vec<Delivered>) {
        let dropped = self.store.shrink_from_bottom(room);
        self.give_up(&dropped, LossReason::NoRoom, out);
    }

    /// When what is in assembly is given up.
    pub(super) fn due(&self) -> Option<u64> {
        (!self.store.is_empty()).then(|| self.fragment_at.saturating_add(ASSEMBLY_MICROS_MAX))
    }

    /// Gives up what did not come whole in time. Returns whether there was any.
    pub(super) fn poll(&mut self, now: u64, out: &mut Vec<Delivered>) -> bool {
        let is_due = self.due().is_some_and(|due| due <= now);
        if is_due {
            let dropped = self.store.clear();
            self.give_up(&dropped, LossReason::Incomplete, out);
        }
        is_due
    }

    /// These samples will not be delivered.
    fn give_up(&mut self, numbers: &[i64], reason: LossReason, out: &mut Vec<Delivered>) {
        let count = u64::try_from(numbers.len()).unwrap_or(u64::MAX);
        if count == 0 {
            return;
        }
        for number in numbers {
            self.given_up.insert(*number, *number);
        }
        while self.given_up.len() > GIVEN_UP_MAX {
            self.given_up.forget_first();
        }
        out.push(Delivered::Lost { writer: self.writer, count, reason });
    }

    /// Delivers a sample and gives up older ones that have not come, or not whole.
    fn deliver(&mut self, number: i64, content: Content, out: &mut Vec<Delivered>) {
        // Before the first delivery it is not known which samples were missed, except for those that came in part.
        let incomplete = self.store.assemblies_below(number);
        let passed = self.highest.map_or(0, |highest| {
            let (from, to) = (highest.saturating_add(1), number.saturating_sub(1));
            let passed = u64::try_from(to.saturating_sub(highest)).unwrap_or(0);
            passed
                .saturating_sub(self.given_up.count_within(from, to))
                .saturating_sub(self.delivered.count_within(from, to))
        });
        for (count, reason) in
            [(incomplete, LossReason::Incomplete), (passed.saturating_sub(incomplete), LossReason::BestEffort)]
        {
            if count > 0 {
                out.push(Delivered::Lost { writer: self.writer, count, reason });
            }
        }
        self.highest = Some(number);
        self.delivered.insert(number);
        self.store.drop_below(number.saturating_add(1));
        self.given_up.forget_below(number);
        content.deliver(self.writer, number, out);
    }
}
