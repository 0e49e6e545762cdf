//! Keeps the newest samples of an own writer, sends them, and repairs them for each matched reader (§8.4.9).
//!
//! A write waits for no reader. [`Writer::poll`] sends new samples once, to all matched readers together; large ones in bursts. Repairs
//! go to one reader, on its request. HEARTBEATs announce what can be requested.
//!
//! Memory: a writer keeps at most its depth of samples and [`HISTORY_BYTES_MAX`](crate::limits::HISTORY_BYTES_MAX), and the sample that
//! it is sending. A matched reader costs at most 1 KiB in addition to its addresses, whatever was written or requested.

mod history;
mod message;
mod reader_proxy;
mod repair;
#[cfg(test)]
mod tests;

use crate::endpoint::{Outgoing, Peer};
use crate::guid::{EntityId, Guid, GuidPrefix, SequenceNumber};
use crate::interface::{OutgoingSample, WriterLosses};
use crate::limits::{BURST_BYTES, BURST_PAUSE_MICROS, FRAGMENT_BYTES, FRAGMENT_BYTES_LOCAL};
use crate::qos::{Durability, Qos, Reliability};
use crate::time::{Now, Ticks};
use crate::wire::submessage::{Heartbeat, InlineQos, Payload, Submessage};
use history::{Excess, History, Sample};
use message::Audience;
use reader_proxy::{ReaderProxy, Replay};
use std::collections::{BTreeMap, VecDeque};

/// Time from the newest sample to the first repeated HEARTBEAT, and least time between two that go to all, microseconds. A lost
/// sample is found about this late.
const HEARTBEAT_MICROS: u64 = 10_000;
/// Longest time between two HEARTBEATs while something is unacknowledged, microseconds. A reader that stands still costs one small
/// datagram in this time until discovery gives it up. One that comes back is repaired within it.
const HEARTBEAT_MICROS_MAX: u64 = 1_000_000;
/// Time from a request to its answer, microseconds: what is requested twice meanwhile is sent once.
const ANSWER_DELAY_MICROS: u64 = 1000;

/// An own writer.
#[derive(Debug)]
pub(crate) struct Writer {
    entity: EntityId,
    is_reliable: bool,
    is_durable: bool,
    /// Microseconds.
    lifespan: Option<u64>,
    history: History,
    readers: BTreeMap<Guid, ReaderProxy>,
    /// Everything up to this number went out once, or will not. HEARTBEATs announce nothing above.
    pushed: i64,
    push: Option<Push>,
    burst: Burst,
    heartbeats: i32,
    /// When the last HEARTBEAT for all went out.
    heartbeat_sent: Option<u64>,
    /// When the next one is due, and the time to the one behind it. Some while a reliable reader lacks something that was pushed.
    heartbeat_due: Option<(u64, u64)>,
    /// Readers that get an answer, in this order, and when.
    queue: VecDeque<Guid>,
    answer_due: Option<u64>,
    /// Its liveliness is to be asserted.
    asserts: bool,
    losses: WriterLosses,
}

/// A sample that is being sent for the first time. It is sent to its end, also if newer ones have replaced it: otherwise a writer of
/// large samples with a depth of 1 might never finish one.
#[derive(Debug)]
struct Push {
    sample: Sample,
    audience: Audience,
    fragment_bytes: u16,
    /// The next fragment.
    next: u32,
}

/// The bytes of the current burst.
#[derive(Debug, Default)]
struct Burst {
    began: Option<u64>,
    bytes: usize,
}

impl Burst {
    /// Is there room at this moment?
    fn has_room(&mut self, now: u64) -> bool {
        if self.began.is_none_or(|began| now.saturating_sub(began) >= BURST_PAUSE_MICROS) {
            *self = Self { began: Some(now), bytes: 0 };
        }
        self.bytes < BURST_BYTES
    }

    /// When there is room again.
    fn room_at(&self) -> u64 {
        match self.began {
            Some(began) if self.bytes >= BURST_BYTES => began.saturating_add(BURST_PAUSE_MICROS),
            _ => 0,
        }
    }
}

impl Writer {
    pub(crate) fn new(entity: EntityId, qos: &Qos) -> Self {
        Self {
            entity,
            is_reliable: qos.reliability == Reliability::Reliable,
            is_durable: qos.durability != Durability::Volatile,
            // Bridges mark their writers by a lifespan above 31 years: nothing gets that old here.
            lifespan: qos.lifespan.to_micros(),
            history: History::new(qos.history),
            readers: BTreeMap::new(),
            pushed: 0,
            push: None,
            burst: Burst::default(),
            heartbeats: 0,
            heartbeat_sent: None,
            heartbeat_due: None,
            queue: VecDeque::new(),
            answer_due: None,
            asserts: false,
            losses: WriterLosses::default(),
        }
    }

    /// Writes a sample; it waits for no reader.
    pub(crate) fn write(&mut self, now: Now, sample: OutgoingSample) -> SequenceNumber {
        let inline_qos = InlineQos { related: sample.related, ..InlineQos::default() };
        self.push(now, sample.timestamp, inline_qos, Payload::Data(sample.payload))
    }

    fn push(&mut self, now: Now, timestamp: Option<Ticks>, inline_qos: InlineQos, payload: Payload) -> SequenceNumber {
        let sequence = self.history.push(now.steady, timestamp, inline_qos, payload);
        let mut needed_above = None;
        while let Some((oldest, excess)) = self.history.pop_excess() {
            // What is being pushed goes out to its end.
            let sent = self.push.as_ref().map_or(self.pushed, |push| push.sample.sequence);
            if oldest > *needed_above.get_or_insert_with(|| self.acknowledged_of(sent)) {
                let count = match excess {
                    Excess::Depth => &mut self.losses.replaced,
                    Excess::Room => &mut self.losses.pushed_out,
                };
                *count = count.saturating_add(1);
            }
        }
        SequenceNumber(sequence)
    }

    /// Samples that it has dropped before all reliable readers had them.
    pub(crate) fn losses(&self) -> WriterLosses {
        self.losses
    }

    /// Asserts that it is alive, by a HEARTBEAT to all readers (§8.4.13.5).
    pub(crate) fn assert_liveliness(&mut self) {
        self.asserts = !self.readers.is_empty();
    }

    /// Writes the end of an instance: `status` as in PID_STATUS_INFO. Keeps it until its reliable readers have it.
    pub(crate) fn dispose(&mut self, now: Now, key: Payload, key_hash: [u8; 16], status: u32) -> SequenceNumber {
        let inline_qos = InlineQos { related: None, status, key_hash: Some(key_hash) };
        self.push(now, None, inline_qos, key)
    }

    /// Forgets a sample: what it announced is over. Readers learn by GAP or HEARTBEAT that it will not come.
    pub(crate) fn forget(&mut self, sequence: SequenceNumber) {
        self.history.remove(sequence.0);
        if self.push.as_ref().is_some_and(|push| push.sample.sequence == sequence.0) {
            self.push = None;
            self.pushed = sequence.0;
        }
    }

    /// A reader matches, or its address has changed.
    pub(crate) fn add_reader(&mut self, now: Now, reader: Peer) {
        if let Some(proxy) = self.readers.get_mut(&reader.guid) {
            // The size of its fragments stays: it may have some.
            let is_local = proxy.peer.is_local;
            proxy.peer = Peer { is_local, ..reader };
            return;
        }
        let guid = reader.guid;
        let keeps_history = self.is_durable && reader.is_durable;
        let mut proxy = ReaderProxy::new(reader, if keeps_history { 0 } else { self.history.last() });
        if self.serves(&proxy) {
            proxy.wants_heartbeat = true;
        } else if keeps_history {
            // What is being pushed goes to the readers from before.
            let until = self.push.as_ref().map_or(self.pushed, |push| push.sample.sequence);
            proxy.replay = Some(Replay { next: self.history.first(), fragment: 1, until });
        }
        self.readers.insert(guid, proxy);
        self.enqueue(guid, now.steady);
    }

    pub(crate) fn remove_reader(&mut self, reader: Guid) {
        self.readers.remove(&reader);
        self.queue.retain(|queued| *queued != reader);
        self.release();
    }

    /// ACKNACK and NACK_FRAG of a reader of this participant. Others than matched readers are ignored.
    pub(crate) fn receive(&mut self, now: Now, from: GuidPrefix, submessage: &Submessage) {
        let now = now.steady;
        let reader = match submessage {
            Submessage::AckNack(acknack) if acknack.writer == self.entity => Guid::new(from, acknack.reader),
            Submessage::NackFrag(nack) if nack.writer == self.entity => Guid::new(from, nack.reader),
            _ => return,
        };
        let (pushed, is_reliable) = (self.pushed, self.is_reliable);
        let Some(proxy) = self.readers.get_mut(&reader).filter(|proxy| is_reliable && proxy.peer.is_reliable) else {
            return;
        };
        let is_taken = match submessage {
            Submessage::AckNack(acknack) => {
                proxy.take_acknack(now, acknack.count, &acknack.missing, acknack.is_final, pushed)
            }
            Submessage::NackFrag(nack) => proxy.take_nack_frag(now, nack.count, nack.sequence.0, &nack.missing),
            _ => false,
        };
        if !is_taken {
            return;
        }
        if proxy.wants_heartbeat || proxy.requested.is_some() || !proxy.fragments.is_empty() {
            self.enqueue(reader, now.saturating_add(ANSWER_DELAY_MICROS));
        }
        self.expect_acknowledgement(now);
        self.release();
    }

    /// Puts out what is due: new samples, repairs, heartbeats.
    pub(crate) fn poll(&mut self, now: Now, out: &mut Vec<Outgoing>) {
        let now = now.steady;
        if self.deadline().is_none_or(|due| due > now) {
            return;
        }
        if let Some(lifespan) = self.lifespan {
            self.history.remove_older_than(now.saturating_sub(lifespan));
        }
        if self.answer_due.is_some_and(|due| due <= now) {
            self.answer(now, out);
        }
        self.push_new(now, out);
        if std::mem::take(&mut self.asserts) {
            self.send_assertion(out);
        }
        if self.heartbeat_due.is_some_and(|(due, _)| due <= now) {
            self.repeat_heartbeat(now, out);
        }
        self.release();
    }

    /// When [`Writer::poll`] has something to do next, by the steady clock.
    pub(crate) fn deadline(&self) -> Option<u64> {
        let is_pushing = self.push.is_some() || self.pushed < self.history.last();
        let push = is_pushing.then(|| self.burst.room_at());
        let assertion = self.asserts.then_some(0);
        [push, assertion, self.answer_due, self.heartbeat_due.map(|(due, _)| due)].into_iter().flatten().min()
    }

    /// Have all reliable readers everything that was written?
    pub(crate) fn is_acknowledged(&self) -> bool {
        self.acknowledged() >= self.history.last()
    }

    /// Bytes from the oldest sample that a reliable reader lacks, or that was not sent yet, to the newest one.
    pub(crate) fn unacknowledged_bytes(&self) -> usize {
        self.history.bytes_behind(self.acknowledged())
    }

    /// Does the reader get HEARTBEATs and repairs?
    fn serves(&self, proxy: &ReaderProxy) -> bool {
        self.is_reliable && proxy.peer.is_reliable
    }

    /// The newest number up to which everything was pushed and acknowledged by all reliable readers.
    fn acknowledged(&self) -> i64 {
        self.acknowledged_of(self.pushed)
    }

    /// The same, of the numbers up to this one.
    fn acknowledged_of(&self, last: i64) -> i64 {
        let readers = self.readers.values().filter(|proxy| self.serves(proxy));
        readers.map(|proxy| proxy.acknowledged).fold(last, i64::min)
    }

    /// Forgets what no reader needs: a volatile writer everything that all reliable readers have, a durable one the ends of instances.
    fn release(&mut self) {
        let acknowledged = self.acknowledged();
        if !self.is_durable {
            // A reader that has given up what is older than the history does not hold back the rest.
            self.history.remove_until(acknowledged);
        }
        self.history.remove_ends_until(acknowledged);
        if acknowledged >= self.pushed {
            self.heartbeat_due = None;
        }
    }

    fn push_new(&mut self, now: u64, out: &mut Vec<Outgoing>) {
        let (before, messages) = (self.pushed, out.len());
        while self.burst.has_room(now) && self.begin_push() {
            self.send_burst(out);
        }
        if self.pushed == before || !self.readers.values().any(|proxy| self.serves(proxy)) {
            return;
        }
        // The HEARTBEAT behind the newest sample; at most one in this time, so that a fast writer does not get an ACKNACK for each.
        let is_early = self.heartbeat_sent.is_some_and(|sent| now.saturating_sub(sent) < HEARTBEAT_MICROS);
        let is_behind = self.push.is_none() && self.pushed == self.history.last();
        if is_early || !is_behind {
            let due = self.heartbeat_sent.unwrap_or(now).saturating_add(HEARTBEAT_MICROS);
            let due = self.heartbeat_due.map_or(due, |(other, _)| due.min(other));
            self.heartbeat_due = Some((due, HEARTBEAT_MICROS));
            return;
        }
        let Some(newest) = out.get_mut(messages..).and_then(<[Outgoing]>::last_mut) else { return };
        newest.submessages.push(self.heartbeat_for_all(now, EntityId::UNKNOWN));
        self.heartbeat_due = Some((now.saturating_add(HEARTBEAT_MICROS), HEARTBEAT_MICROS.saturating_mul(2)));
    }

    /// Takes the next sample that was never sent. False if there is none.
    fn begin_push(&mut self) -> bool {
        while self.push.is_none() {
            let Some(sample) = self.history.at_or_after(self.pushed.saturating_add(1)) else {
                self.pushed = self.history.last();
                return false;
            };
            let sequence = sample.sequence;
            // Readers that matched after it was written do not get it here.
            let readers = || self.readers.values().filter(|proxy| proxy.start < sequence).map(|proxy| &proxy.peer);
            let audience = Audience::of(readers());
            let all_are_local = readers().all(|reader| reader.is_local);
            let fragment_bytes = if all_are_local { FRAGMENT_BYTES_LOCAL } else { FRAGMENT_BYTES };
            if audience.is_empty() {
                self.pushed = sequence;
                continue;
            }
            self.push = Some(Push { sample: sample.clone(), audience, fragment_bytes, next: 1 });
            self.pushed = sequence.saturating_sub(1);
            self.history.set_fragment_bytes(sequence, fragment_bytes);
        }
        true
    }

    /// Sends the sample that is being pushed, as far as the burst goes.
    fn send_burst(&mut self, out: &mut Vec<Outgoing>) {
        let Some(push) = &mut self.push else { return };
        let reader = push.audience.reader();
        let mut submessages = Vec::new();
        let mut is_complete = false;
        while self.burst.bytes < BURST_BYTES {
            match message::submessage(&push.sample, self.entity, reader, push.fragment_bytes, push.next) {
                Some(submessage) => {
                    self.burst.bytes = self.burst.bytes.saturating_add(message::bytes_of(&submessage));
                    submessages.push(submessage);
                    push.next = push.next.saturating_add(1);
                }
                None => {
                    is_complete = true;
                    break;
                }
            }
        }
        if !submessages.is_empty() {
            out.push(push.audience.message(Some(&push.sample), submessages));
        }
        if is_complete {
            self.pushed = push.sample.sequence;
            self.push = None;
        }
    }

    /// Sends a HEARTBEAT to the readers that lack something.
    fn repeat_heartbeat(&mut self, now: u64, out: &mut Vec<Outgoing>) {
        let behind = self.readers.values().filter(|proxy| self.serves(proxy) && proxy.acknowledged < self.pushed);
        let audience = Audience::of(behind.map(|proxy| &proxy.peer));
        let Some((_, interval)) = self.heartbeat_due.take().filter(|_| !audience.is_empty()) else { return };
        let heartbeat = self.heartbeat_for_all(now, audience.reader());
        out.push(audience.message(None, vec![heartbeat]));
        let next = interval.saturating_mul(2).min(HEARTBEAT_MICROS_MAX);
        self.heartbeat_due = Some((now.saturating_add(interval), next));
    }

    fn send_assertion(&mut self, out: &mut Vec<Outgoing>) {
        let audience = Audience::of(self.readers.values().map(|proxy| &proxy.peer));
        if let Submessage::Heartbeat(heartbeat) = self.heartbeat(audience.reader()) {
            let heartbeat = Heartbeat { is_alive: true, is_final: true, ..heartbeat };
            out.push(audience.message(None, vec![Submessage::Heartbeat(heartbeat)]));
        }
    }

    /// Begins to repeat HEARTBEATs, unless they are being repeated.
    fn expect_acknowledgement(&mut self, now: u64) {
        if self.heartbeat_due.is_none() {
            self.heartbeat_due = Some((now.saturating_add(HEARTBEAT_MICROS), HEARTBEAT_MICROS.saturating_mul(2)));
        }
    }

    fn heartbeat_for_all(&mut self, now: u64, reader: EntityId) -> Submessage {
        self.heartbeat_sent = Some(now);
        self.heartbeat(reader)
    }

    /// The numbers that can be requested. Without samples, and while only the first one is being pushed, `first` is the number behind `last` (§8.3.8.6).
    /// It requires an ACKNACK, so that this writer can release samples.
    fn heartbeat(&mut self, reader: EntityId) -> Submessage {
        // Fast DDS and CycloneDDS compare counts so that they may wrap around.
        self.heartbeats = self.heartbeats.wrapping_add(1);
        let last = self.pushed;
        Submessage::Heartbeat(Heartbeat {
            reader,
            writer: self.entity,
            first: SequenceNumber(self.history.first().min(last.saturating_add(1))),
            last: SequenceNumber(last),
            count: self.heartbeats,
            is_final: false,
            is_alive: false,
        })
    }
}
