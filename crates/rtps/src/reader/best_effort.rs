//! A matched writer without repair (§8.4.11): what is newer than the last sample is delivered.

use super::NUMBER_MAX;
use super::content::Content;
use super::ranges::DeliveredNumbers;
use super::stale::StaleNumbers;
use super::store::Store;
use crate::endpoint::Delivered;
use crate::guid::Guid;
use crate::interface::LossReason;
use crate::limits::SAMPLE_BYTES_MAX;
use crate::wire::submessage::{Addressed, DataFrag, Submessage};

/// A writer from which samples come without repair.
#[derive(Debug)]
pub(super) struct BestEffortProxy {
    writer: Guid,
    /// The number of the newest sample that was delivered.
    highest: Option<i64>,
    delivered: DeliveredNumbers,
    stale: StaleNumbers,
    store: Store,
    /// The newest sample that was passed over because of its size.
    too_large: i64,
}

impl BestEffortProxy {
    pub(super) fn new(writer: Guid) -> Self {
        Self {
            writer,
            highest: None,
            delivered: DeliveredNumbers::default(),
            stale: StaleNumbers::default(),
            store: Store::default(),
            too_large: 0,
        }
    }

    /// DATA and DATA_FRAG. Nothing is asked for, so HEARTBEAT and GAP do not matter.
    pub(super) fn receive(&mut self, now: u64, message: &Addressed, out: &mut Vec<Delivered>) {
        match &message.submessage {
            Submessage::Data(data) if self.is_new(now, data.sequence.0, out) => {
                self.deliver(data.sequence.0, super::content_of(message, data), out);
            }
            Submessage::DataFrag(fragment) if self.is_new(now, fragment.sequence.0, out) => {
                self.assemble(message, fragment, out);
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
        self.store = Store::default();
        self.highest = Some(number.saturating_sub(1));
        out.push(Delivered::Resynchronized { writer: self.writer });
        true
    }

    fn assemble(&mut self, message: &Addressed, fragment: &DataFrag, out: &mut Vec<Delivered>) {
        let number = fragment.sequence.0;
        if usize::try_from(fragment.sample_bytes).is_ok_and(|bytes| bytes > SAMPLE_BYTES_MAX) {
            if number > self.too_large {
                self.too_large = number;
                out.push(Delivered::Lost { writer: self.writer, count: 1, reason: LossReason::TooLarge });
            }
            return;
        }
        self.store.put_fragments(number, fragment, message.timestamp);
        if let Some(content) = self.store.take(number) {
            self.deliver(number, content, out);
        }
        let dropped = self.store.shrink_from_bottom();
        if dropped > 0 {
            out.push(Delivered::Lost { writer: self.writer, count: dropped, reason: LossReason::NoRoom });
        }
    }

    /// Delivers a sample and gives up older ones that have not come, or not whole.
    fn deliver(&mut self, number: i64, content: Content, out: &mut Vec<Delivered>) {
        let lost = self.highest.map_or(0, |highest| number.saturating_sub(highest).saturating_sub(1));
        if let Some(count) = u64::try_from(lost).ok().filter(|count| *count > 0) {
            out.push(Delivered::Lost { writer: self.writer, count, reason: LossReason::BestEffort });
        }
        self.highest = Some(number);
        self.delivered.insert(number);
        self.store.drop_below(number.saturating_add(1));
        content.deliver(self.writer, number, out);
    }

    #[cfg(test)]
    pub(super) fn bytes(&self) -> usize {
        self.store.bytes()
    }
}
