//! Answers to one reader: repairs, GAP and HEARTBEAT.

use super::Writer;
use super::history::{History, Sample};
use super::message;
use super::message::Audience;
use super::reader_proxy::{ReaderProxy, Replay};
use crate::endpoint::Outgoing;
use crate::guid::{EntityId, Guid, SequenceNumber};
use crate::limits::{BURST_PAUSE_MICROS, FRAGMENT_BYTES, FRAGMENT_BYTES_LOCAL, REPAIR_BYTES};
use crate::wire::submessage::{Gap, NumberSet, Submessage};

impl Writer {
    /// Queues an answer.
    pub(super) fn enqueue(&mut self, reader: Guid, due: u64) {
        if let Some(proxy) = self.readers.get_mut(&reader)
            && !proxy.is_queued
        {
            proxy.is_queued = true;
            self.queue.push_back(reader);
        }
        self.answer_due = Some(self.answer_due.map_or(due, |other| other.min(due)));
    }

    /// Answers the readers in the queue, up to [`REPAIR_BYTES`] at once. The rest of a request follows after a pause, and a HEARTBEAT
    /// behind it. CycloneDDS requests again only every 100 ms, so dropping the rest would make repairs slow.
    pub(super) fn answer(&mut self, now: u64, out: &mut Vec<Outgoing>) {
        let mut left = REPAIR_BYTES;
        while left > 0
            && let Some(guid) = self.queue.pop_front()
        {
            let is_served = self.readers.get(&guid).is_some_and(|proxy| self.serves(proxy));
            let Some(proxy) = self.readers.get_mut(&guid) else { continue };
            proxy.is_queued = false;
            let mut repair = Repair {
                writer: self.entity,
                history: &self.history,
                reader: guid.entity,
                audience: Audience::of(std::iter::once(&proxy.peer)),
                is_local: proxy.peer.is_local,
                left,
                out,
            };
            repair.replay(proxy);
            repair.fragments(proxy, self.pushed);
            repair.samples(proxy, self.pushed);
            left = repair.left;
            let is_answered = proxy.replay.is_none() && proxy.requested.is_none() && proxy.fragments.is_empty();
            if !is_answered {
                proxy.is_queued = true;
                self.queue.push_back(guid);
            }
            let lacks = proxy.acknowledged < self.pushed;
            let audience = repair.audience;
            if is_served && is_answered && std::mem::take(&mut proxy.wants_heartbeat) {
                let heartbeat = self.heartbeat(guid.entity);
                out.push(audience.message(None, vec![heartbeat]));
                if lacks {
                    self.expect_acknowledgement(now);
                }
            }
        }
        self.answer_due = (!self.queue.is_empty()).then(|| now.saturating_add(BURST_PAUSE_MICROS));
    }
}

/// An answer to one reader.
struct Repair<'a> {
    writer: EntityId,
    history: &'a History,
    reader: EntityId,
    audience: Audience,
    is_local: bool,
    /// Bytes that may still go out.
    left: usize,
    out: &'a mut Vec<Outgoing>,
}

impl Repair<'_> {
    /// Sends kept samples to a late best-effort reader.
    fn replay(&mut self, proxy: &mut ReaderProxy) {
        while self.left > 0
            && let Some(replay) = proxy.replay
        {
            let Some(sample) = self.history.at_or_after(replay.next).filter(|sample| sample.sequence <= replay.until)
            else {
                proxy.replay = None;
                break;
            };
            let from = if sample.sequence == replay.next { replay.fragment } else { 1 };
            let fragment = self.send(sample, from..=self.fragments_of(sample));
            proxy.replay = Some(match fragment {
                Some(fragment) => Replay { next: sample.sequence, fragment, ..replay },
                None => Replay { next: sample.sequence.saturating_add(1), fragment: 1, ..replay },
            });
        }
    }

    /// Sends requested fragments. The HEARTBEAT that follows announces that a sample is gone.
    fn fragments(&mut self, proxy: &mut ReaderProxy, pushed: i64) {
        for (sequence, missing) in std::mem::take(&mut proxy.fragments) {
            proxy.wants_heartbeat = true;
            let Some(sample) = self.history.get(sequence).filter(|_| sequence <= pushed && sequence > proxy.start)
            else {
                continue;
            };
            let count = self.fragments_of(sample);
            let numbers = missing.iter().filter_map(|number| u32::try_from(number).ok());
            if let Some(rest) = self.send(sample, numbers.filter(|number| (1..=count).contains(number))) {
                proxy.fragments.push((sequence, missing.tail(i64::from(rest))));
            }
        }
    }

    /// Sends requested samples, as far as they exist, and a GAP for those that will not come.
    fn samples(&mut self, proxy: &mut ReaderProxy, pushed: i64) {
        // A volatile reader that matches gets a GAP for what is not for it.
        let first = self.history.first();
        let is_new = proxy.wants_heartbeat && proxy.acknowledged == proxy.start && proxy.start >= first;
        let requested = proxy.requested.take();
        if requested.is_none() && !is_new {
            return;
        }
        proxy.wants_heartbeat = true;
        let requested = requested.unwrap_or_else(|| {
            let mut set = NumberSet::new(proxy.start);
            set.insert(proxy.start);
            set
        });
        let mut holes = Vec::new();
        for number in requested.iter().filter(|number| (first..=pushed).contains(number)) {
            match self.history.get(number).filter(|_| number > proxy.start) {
                Some(sample) => {
                    let resumed = proxy.resumed.take_if(|(of, _)| *of == number);
                    let from = resumed.map_or(1, |(_, fragment)| fragment);
                    if let Some(fragment) = self.send(sample, from..=self.fragments_of(sample)) {
                        proxy.resumed = Some((number, fragment));
                        proxy.requested = Some(requested.tail(number));
                        break;
                    }
                }
                None => holes.push(number),
            }
        }
        self.gap(&holes, first, proxy.start, pushed);
    }

    /// Sends a GAP: from the first number up to a sample that exists, and the others one by one. Numbers below the history are covered by
    /// the HEARTBEAT.
    fn gap(&mut self, holes: &[i64], first: i64, start: i64, pushed: i64) {
        let Some(hole) = holes.first().copied() else { return };
        let (from, end) = if hole <= start {
            (first, start.saturating_add(1))
        } else {
            let next = self.history.at_or_after(hole).map_or(i64::MAX, |sample| sample.sequence);
            (hole, next.min(pushed.saturating_add(1)))
        };
        let mut list = NumberSet::new(end);
        for hole in holes {
            list.insert(*hole);
        }
        let gap = Gap { reader: self.reader, writer: self.writer, start: SequenceNumber(from), list };
        self.out.push(self.audience.message(None, vec![Submessage::Gap(gap)]));
    }

    /// Sends these fragments of a sample as far as the bytes go. The first one that did not go, if any.
    fn send(&mut self, sample: &Sample, numbers: impl Iterator<Item = u32>) -> Option<u32> {
        let fragment_bytes = self.fragment_bytes(sample);
        let mut submessages = Vec::new();
        let mut stopped = None;
        for number in numbers {
            if self.left == 0 {
                stopped = Some(number);
                break;
            }
            if let Some(submessage) = message::submessage(sample, self.writer, self.reader, fragment_bytes, number) {
                self.left = self.left.saturating_sub(message::bytes_of(&submessage));
                submessages.push(submessage);
            }
        }
        if !submessages.is_empty() {
            self.out.push(self.audience.message(Some(sample), submessages));
        }
        stopped
    }

    fn fragments_of(&self, sample: &Sample) -> u32 {
        message::fragments_of(sample, self.fragment_bytes(sample))
    }

    /// As the sample was pushed. A remote reader never got the large fragments.
    fn fragment_bytes(&self, sample: &Sample) -> u16 {
        match sample.fragment_bytes {
            _ if !self.is_local => FRAGMENT_BYTES,
            0 => FRAGMENT_BYTES_LOCAL,
            bytes => bytes,
        }
    }
}
