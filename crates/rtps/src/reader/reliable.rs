//! A matched writer with repair (§8.4.12): its samples are delivered in the order of their numbers, each once.

use super::NUMBER_MAX;
use super::content::Content;
use super::ranges::{DeliveredNumbers, NumberRanges};
use super::stale::StaleNumbers;
use super::store::Store;
use super::timing::Timing;
use crate::endpoint::{Delivered, Peer};
use crate::interface::LossReason;
use crate::limits::SAMPLE_BYTES_MAX;
use crate::wire::submessage::{Addressed, Data, DataFrag, Gap, Heartbeat, Submessage};

/// Most ranges of numbers ahead that will not come. The highest ones are dropped: the writer repeats them on request.
pub(super) const GAPS_MAX: usize = 64;
/// Time for which a writer that gave way is not asked for more, microseconds.
const TIGHT_MICROS: u64 = 100_000;

/// Which old samples a reader wants.
#[derive(Clone, Copy, Debug)]
pub(super) struct Options {
    /// Give up what a writer had before its first HEARTBEAT, except for what has come of it.
    pub(super) skips_old: bool,
    /// Not volatile.
    pub(super) is_durable: bool,
}

/// A writer whose samples are repaired.
///
/// Everything below `next` was delivered or given up, and nothing below it waits. Before the first HEARTBEAT nothing is delivered:
/// until then it is not known which number is the next one.
#[derive(Debug)]
pub(super) struct ReliableProxy {
    pub(super) peer: Peer,
    /// Give up what the writer had before its first HEARTBEAT, except for what has come of it.
    skips_old: bool,
    pub(super) is_synchronized: bool,
    pub(super) next: i64,
    /// The writer has nothing below.
    first: i64,
    /// Numbers below are from before the match: they are not asked for, and not missed.
    pub(super) start: i64,
    /// The newest number of the first HEARTBEAT. A GAP up to it says what was never for this reader, or was replaced before the match.
    joined: i64,
    /// Both sides keep samples: what the writer had before the match is missed.
    is_durable: bool,
    /// The newest number that can be asked for. It goes back where the writer says so: a wrong one would make Fast DDS ignore requests.
    pub(super) last: i64,
    pub(super) store: Store,
    /// Numbers from here on were dropped for want of room; they are not asked for before there is some.
    pub(super) room_until: i64,
    /// And until this moment, where other writers needed the room.
    pub(super) tight_until: u64,
    /// Numbers from `next` on that will not come.
    pub(super) gaps: NumberRanges,
    /// Numbers in `gaps` that were counted as lost.
    counted: NumberRanges,
    /// Numbers that a GAP named before a HEARTBEAT did. They are lost if the HEARTBEAT comes.
    unannounced: NumberRanges,
    pub(super) delivered: DeliveredNumbers,
    stale: StaleNumbers,
    pub(super) timing: Timing,
}

impl ReliableProxy {
    /// `is_durable`: the reader wants samples from before the match.
    pub(super) fn new(now: u64, peer: Peer, options: Options, count: i32, room: usize) -> Self {
        let Options { skips_old, is_durable } = options;
        Self {
            is_durable: is_durable && peer.is_durable,
            peer,
            skips_old,
            is_synchronized: false,
            next: 1,
            first: 1,
            start: 1,
            joined: 0,
            last: 0,
            store: Store::with_room(room),
            room_until: NUMBER_MAX,
            tight_until: 0,
            gaps: NumberRanges::default(),
            counted: NumberRanges::default(),
            unannounced: NumberRanges::default(),
            delivered: DeliveredNumbers::default(),
            stale: StaleNumbers::default(),
            timing: Timing::new(now, count),
        }
    }

    pub(super) fn set_peer(&mut self, peer: Peer) {
        self.peer = peer;
    }

    pub(super) fn receive(&mut self, now: u64, message: &Addressed, out: &mut Vec<Delivered>) {
        match &message.submessage {
            Submessage::Data(data) if self.is_wanted(data.sequence.0) => {
                let content = super::content_of(message, data);
                if self.is_synchronized && data.sequence.0 == self.next {
                    self.deliver(content, out);
                } else {
                    self.store.put(data.sequence.0, content);
                }
                self.after_sample(now, out);
            }
            Submessage::DataFrag(fragment) if self.is_wanted(fragment.sequence.0) => {
                self.fragment(now, message, fragment, out);
            }
            Submessage::Heartbeat(heartbeat) => self.heartbeat(now, heartbeat, out),
            // Fragments that the writer still has to send may be asked for too early by this; it ignores that.
            Submessage::HeartbeatFrag(heartbeat) if self.is_wanted(heartbeat.sequence.0) && self.is_synchronized => {
                self.last = self.last.max(heartbeat.sequence.0);
                self.timing.heartbeat(now, self.last >= self.next);
            }
            Submessage::Gap(gap) => self.gap(now, gap, out),
            Submessage::Data(Data { sequence, .. }) | Submessage::DataFrag(DataFrag { sequence, .. }) => {
                if self.begins_again(now, sequence.0, out) {
                    self.receive(now, message, out);
                }
            }
            Submessage::HeartbeatFrag(_) | Submessage::AckNack(_) | Submessage::NackFrag(_) => {}
        }
    }

    /// A sample has come that is not wanted. If the writer persists in numbers that were given up, they are its numbers: a HEARTBEAT
    /// is awaited as at the beginning. Returns whether it is so.
    fn begins_again(&mut self, now: u64, number: i64, out: &mut Vec<Delivered>) -> bool {
        let is_given_up = (1..self.next).contains(&number) && !self.delivered.contains(number);
        let begins_again = is_given_up && self.is_synchronized && self.stale.add(now, number);
        if begins_again {
            out.push(Delivered::Resynchronized { writer: self.peer.guid });
            self.begin(1, 0);
            self.is_synchronized = false;
            self.last = 0;
            self.store.clear();
            self.timing.restart(now);
        }
        begins_again
    }

    /// May this number still be delivered?
    fn is_wanted(&self, number: i64) -> bool {
        (self.next..=NUMBER_MAX).contains(&number) && !self.delivered.contains(number)
    }

    fn fragment(&mut self, now: u64, message: &Addressed, fragment: &DataFrag, out: &mut Vec<Delivered>) {
        let number = fragment.sequence.0;
        if usize::try_from(fragment.sample_bytes).is_ok_and(|bytes| bytes > SAMPLE_BYTES_MAX) {
            // It is counted once if the numbers that are counted do not have too many ranges.
            if self.gaps.end_of(number).is_none() && self.counted.len() < GAPS_MAX {
                self.pass_over(number, number);
                self.counted.insert(number, number);
                out.push(Delivered::Lost { writer: self.peer.guid, count: 1, reason: LossReason::TooLarge });
                self.advance(out);
            }
        } else if self.store.put_fragments(number, fragment, message.timestamp) {
            if number > self.last && self.store.is_assembling(number) {
                self.timing.fragment(now);
            }
            self.after_sample(now, out);
        }
    }

    fn after_sample(&mut self, now: u64, out: &mut Vec<Delivered>) {
        self.stale.clear();
        self.timing.sample(now, self.is_synchronized);
        self.advance(out);
        self.reopen(now);
        if let Some(dropped) = self.store.shrink_from_top(self.store.room()) {
            self.room_until = self.room_until.min(dropped);
        }
    }

    /// Drops samples that can be requested again until at most these bytes wait.
    pub(super) fn give_way(&mut self, now: u64, room: usize) {
        if let Some(dropped) = self.store.shrink_from_top(room) {
            self.room_until = self.room_until.min(dropped);
            self.tight_until = now.saturating_add(TIGHT_MICROS);
            self.timing.schedule(self.tight_until);
        }
    }

    /// Asks for what was dropped, if there is room again.
    pub(super) fn reopen(&mut self, now: u64) {
        if self.store.has_room() && now >= self.tight_until {
            self.room_until = NUMBER_MAX;
        }
    }

    /// HEARTBEAT (§8.3.8.6). Its count is ignored: a repeated or late one is harmless, and a forged count cannot mute the writer.
    fn heartbeat(&mut self, now: u64, heartbeat: &Heartbeat, out: &mut Vec<Delivered>) {
        let (first, last) = (heartbeat.first.0, heartbeat.last.0);
        if first < 1 || last < first.saturating_sub(1) || last > NUMBER_MAX {
            return;
        }
        if !self.is_synchronized {
            self.is_synchronized = true;
            self.begin(first, last);
        } else if last < self.next.saturating_sub(1) {
            if self.stale.add(now, last) {
                out.push(Delivered::Resynchronized { writer: self.peer.guid });
                self.begin(first, last);
            }
        } else {
            self.stale.clear();
        }
        self.first = self.first.max(first);
        self.last = last;
        let announced = self.unannounced.count_within(1, last);
        self.unannounced.forget_until(last);
        self.lose(announced, out);
        self.advance(out);
        self.reopen(now);
        if !heartbeat.is_final || self.last >= self.next {
            self.timing.heartbeat(now, self.last >= self.next);
        }
    }

    /// Starts from a HEARTBEAT. A sample that was delivered before is not delivered again.
    fn begin(&mut self, first: i64, last: i64) {
        self.stale.clear();
        self.gaps.clear();
        self.counted.clear();
        self.unannounced.clear();
        self.next = 1;
        self.first = first;
        self.joined = last;
        self.start = if self.skips_old { last.saturating_add(1) } else { first };
        self.room_until = NUMBER_MAX;
    }

    /// GAP (§8.3.8.4).
    fn gap(&mut self, now: u64, gap: &Gap, out: &mut Vec<Delivered>) {
        if gap.start.0 < 1 {
            return;
        }
        self.pass_over(gap.start.0, gap.list.base.saturating_sub(1));
        for number in gap.list.iter() {
            self.pass_over(number, number);
        }
        self.timing.sample(now, self.is_synchronized);
        self.advance(out);
        self.reopen(now);
    }

    /// These numbers will not come. The highest ones are forgotten where there are too many ranges: the lowest always find room.
    fn pass_over(&mut self, from: i64, to: i64) {
        let (from, to) = (from.max(self.next), to.min(NUMBER_MAX));
        self.gaps.insert(from, to);
        if self.gaps.len() > GAPS_MAX {
            self.gaps.forget_last();
        }
    }

    /// Delivers the sample with the number `next`.
    fn deliver(&mut self, content: Content, out: &mut Vec<Delivered>) {
        self.delivered.insert(self.next);
        content.deliver(self.peer.guid, self.next, out);
        self.next = self.next.saturating_add(1);
    }

    /// Delivers what can be delivered in order, and gives up what will not come.
    fn advance(&mut self, out: &mut Vec<Delivered>) {
        if !self.is_synchronized {
            return;
        }
        let mut lost: u64 = 0;
        loop {
            let next = self.next;
            if let Some(end) = self.delivered.end_of(next) {
                self.next = end.saturating_add(1);
            } else if let Some(content) = self.store.take(next) {
                self.deliver(content, out);
            } else if let Some(end) = self.gaps.end_of(next) {
                // A sample that came all the same is delivered.
                self.next = end.saturating_add(1).min(self.store.whole_from(next).unwrap_or(i64::MAX));
                lost = lost.saturating_add(self.passed_by_gap(next));
            } else {
                // What came in part is wanted, also if it is old, as long as the writer has it.
                let is_assembling = self.store.is_assembling(next);
                let limit = if is_assembling { self.first } else { self.first.max(self.start) };
                if next >= limit {
                    break;
                }
                let others = [self.store.above(next), self.gaps.start_above(next), self.delivered.start_above(next)];
                self.next = others.into_iter().flatten().fold(limit, i64::min);
                let missed = self.next.saturating_sub(next.max(self.missed_from()));
                lost = lost.saturating_add(u64::try_from(missed).unwrap_or(0));
            }
        }
        self.store.drop_below(self.next);
        self.gaps.forget_below(self.next);
        self.counted.forget_below(self.next);
        self.lose(lost, out);
    }

    /// The first number whose loss counts.
    fn missed_from(&self) -> i64 {
        if self.is_durable { self.start } else { self.start.max(self.joined.saturating_add(1)) }
    }

    /// How many samples a GAP has taken that the writer had announced, from this number to `next`. Those that it has not announced
    /// yet are counted when it does.
    fn passed_by_gap(&mut self, from: i64) -> u64 {
        let (from, to) = (from.max(self.joined.saturating_add(1)), self.next.saturating_sub(1));
        let announced = to.min(self.last);
        if self.unannounced.len() + self.counted.len() < GAPS_MAX {
            self.unannounced.insert_without(from.max(self.last.saturating_add(1)), to, &self.counted);
        }
        let passed = u64::try_from(announced.saturating_sub(from).saturating_add(1)).unwrap_or(0);
        passed.saturating_sub(self.counted.count_within(from, announced))
    }

    fn lose(&self, count: u64, out: &mut Vec<Delivered>) {
        if count > 0 {
            out.push(Delivered::Lost { writer: self.peer.guid, count, reason: LossReason::Gone });
        }
    }
}
