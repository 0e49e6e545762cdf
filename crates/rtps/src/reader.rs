//! Orders, repairs and reassembles what the matched writers of an own reader send (§8.4.12).
//!
//! A reliable reader delivers each sample once and in order, asks for what it lacks, and passes over what a writer no longer has. A
//! best-effort reader delivers what is newer than the last sample.
//!
//! Memory: samples that wait take at most [`ASSEMBLY_BYTES_MAX`] and [`ASSEMBLY_SAMPLES_MAX`](crate::limits::ASSEMBLY_SAMPLES_MAX) for
//! each matched writer, and [`READER_BYTES_MAX`] for all. Writers share that fairly: see `budget`. A matched writer takes at most
//! [`MATCHED_WRITER_BYTES_MAX`] besides. Submessages with any numbers cost bounded time: ranges are never walked number by number.

mod acknowledgement;
mod assembly;
mod best_effort;
mod budget;
mod content;
mod deadline;
mod ranges;
mod reliable;
#[cfg(test)]
mod simulation;
mod stale;
mod store;
#[cfg(test)]
mod tests;
mod timing;

use crate::endpoint::{Delivered, Outgoing, Peer};
use crate::guid::{EntityId, Guid};
use crate::limits::{ASSEMBLY_BYTES_MAX, LOCATORS_MAX, READER_BYTES_MAX};
use crate::qos::{Durability, Qos, Reliability};
use crate::time::Now;
use crate::wire::submessage::{Addressed, Data, Submessage};
use best_effort::BestEffortProxy;
use budget::Holding;
pub(crate) use budget::share;
use content::Content;
use deadline::Deadline;
use reliable::{GAPS_MAX, Options, ReliableProxy};
use std::collections::BTreeMap;
use std::net::SocketAddrV4;
use store::{STORE_BYTES, Store};

/// Numbers above are ignored: no writer gets there, and the arithmetic with those below cannot overflow.
const NUMBER_MAX: i64 = 1 << 62;

/// Most bytes that a matched writer takes besides the samples that wait: addresses, ranges of numbers, maps.
pub(crate) const MATCHED_WRITER_BYTES_MAX: usize = 12 * 1024;
/// A vector of ranges may have twice the room that it needs; there are three sets.
const RANGES_BYTES: usize = 3 * 2 * (GAPS_MAX + 1) * size_of::<(i64, i64)>();
const _: () = assert!(
    MATCHED_WRITER_BYTES_MAX
        >= size_of::<ReliableProxy>()
            + size_of::<BestEffortProxy>()
            + 2 * size_of::<(Guid, Matched)>()
            + 2 * LOCATORS_MAX * size_of::<SocketAddrV4>()
            + RANGES_BYTES
            + STORE_BYTES
);

/// An own reader.
#[derive(Debug)]
pub(crate) struct Reader {
    entity: EntityId,
    is_reliable: bool,
    options: Options,
    /// Bytes of samples that may wait for each writer.
    writer_room: usize,
    /// And for all.
    room: usize,
    writers: BTreeMap<Guid, Matched>,
    /// Invariant: the sum of what the writers hold.
    held: usize,
    deadline: Deadline,
    /// The highest count of the writers that were removed. One that matches again may remember it.
    count: i32,
    /// Not later than anything that is due for a writer.
    due: Option<u64>,
}

/// A matched writer.
#[derive(Debug)]
struct Matched {
    proxy: WriterProxy,
    holding: Holding,
}

/// The state of the reader for one matched writer (§8.4.12.2).
#[derive(Debug)]
enum WriterProxy {
    Reliable(Box<ReliableProxy>),
    BestEffort(Box<BestEffortProxy>),
}

impl WriterProxy {
    fn store(&self) -> &Store {
        match self {
            Self::Reliable(proxy) => &proxy.store,
            Self::BestEffort(proxy) => &proxy.store,
        }
    }

    /// When it has something to do next.
    fn due(&self) -> Option<u64> {
        match self {
            Self::Reliable(proxy) => proxy.due(),
            Self::BestEffort(proxy) => proxy.due(),
        }
    }
}

impl Reader {
    pub(crate) fn new(entity: EntityId, qos: &Qos, without_history: bool) -> Self {
        Self {
            entity,
            is_reliable: qos.reliability == Reliability::Reliable,
            options: Options { skips_old: without_history, is_durable: qos.durability != Durability::Volatile },
            writer_room: ASSEMBLY_BYTES_MAX,
            room: READER_BYTES_MAX,
            writers: BTreeMap::new(),
            held: 0,
            deadline: Deadline::new(qos.deadline.to_micros()),
            count: 0,
            due: None,
        }
    }

    /// With less room for samples that wait, for each writer and for all. The first must be enough for the largest sample.
    pub(crate) fn with_room(self, writer_room: usize, room: usize) -> Self {
        Self { writer_room, room, ..self }
    }

    /// A writer matches, or its address has changed.
    pub(crate) fn add_writer(&mut self, now: Now, writer: Peer) {
        match self.writers.get_mut(&writer.guid).map(|matched| &mut matched.proxy) {
            Some(WriterProxy::Reliable(proxy)) => proxy.set_peer(writer),
            Some(WriterProxy::BestEffort(_)) => {}
            None => {
                let guid = writer.guid;
                let proxy = if self.is_reliable && writer.is_reliable {
                    self.due = Some(now.steady);
                    let proxy = ReliableProxy::new(now.steady, writer, self.options, self.count, self.writer_room);
                    WriterProxy::Reliable(Box::new(proxy))
                } else {
                    WriterProxy::BestEffort(Box::new(BestEffortProxy::new(guid, self.writer_room)))
                };
                self.writers.insert(guid, Matched { proxy, holding: Holding::default() });
            }
        }
    }

    pub(crate) fn remove_writer(&mut self, writer: Guid) {
        let Some(Matched { proxy, holding }) = self.writers.remove(&writer) else { return };
        self.held = self.held.saturating_sub(holding.bytes());
        if let WriterProxy::Reliable(proxy) = proxy {
            self.count = self.count.max(proxy.count());
        }
        if self.writers.is_empty() {
            self.deadline.stop();
        }
    }

    /// DATA, DATA_FRAG, HEARTBEAT, HEARTBEAT_FRAG, GAP. Others than matched writers are ignored.
    pub(crate) fn receive(&mut self, now: Now, message: &Addressed, out: &mut Vec<Delivered>) {
        let (reader, writer) = match &message.submessage {
            Submessage::Data(data) => (data.reader, data.writer),
            Submessage::DataFrag(fragment) => (fragment.reader, fragment.writer),
            Submessage::Heartbeat(heartbeat) => (heartbeat.reader, heartbeat.writer),
            Submessage::HeartbeatFrag(heartbeat) => (heartbeat.reader, heartbeat.writer),
            Submessage::Gap(gap) => (gap.reader, gap.writer),
            Submessage::AckNack(_) | Submessage::NackFrag(_) => return,
        };
        if reader != self.entity && reader != EntityId::UNKNOWN {
            return;
        }
        let guid = Guid::new(message.source, writer);
        let Some(matched) = self.writers.get_mut(&guid) else { return };
        let begin = out.len();
        match &mut matched.proxy {
            WriterProxy::Reliable(proxy) => proxy.receive(now.steady, message, out),
            WriterProxy::BestEffort(proxy) => proxy.receive(now.steady, message, out),
        }
        self.due = self.due.into_iter().chain(matched.proxy.due()).min();
        if out.iter().skip(begin).any(|delivered| matches!(delivered, Delivered::Sample(_))) {
            self.deadline.start(now.steady);
        }
        self.account(now.steady, guid);
        self.keep_limit(now.steady, out);
    }

    /// Puts out what is due: ACKNACK and NACK_FRAG, and samples that are given up.
    pub(crate) fn poll(&mut self, now: Now, out: &mut Vec<Outgoing>, delivered: &mut Vec<Delivered>) {
        if let Some(count) = self.deadline.missed(now.steady) {
            delivered.push(Delivered::DeadlineMissed { count });
        }
        if self.due.is_none_or(|due| due > now.steady) {
            return;
        }
        self.due = None;
        let mut changed = Vec::new();
        for (guid, matched) in &mut self.writers {
            match &mut matched.proxy {
                WriterProxy::Reliable(proxy) => proxy.poll(now.steady, self.entity, out),
                WriterProxy::BestEffort(proxy) => {
                    if proxy.poll(now.steady, delivered) {
                        changed.push(*guid);
                    }
                }
            }
            self.due = self.due.into_iter().chain(matched.proxy.due()).min();
        }
        changed.into_iter().for_each(|guid| self.account(now.steady, guid));
    }

    /// When [`Reader::poll`] has something to do next, by the steady clock.
    pub(crate) fn deadline(&self) -> Option<u64> {
        self.due.into_iter().chain(self.deadline.due()).min()
    }
}

/// The content of a DATA.
fn content_of(message: &Addressed, data: &Data) -> Content {
    Content { timestamp: message.timestamp, inline_qos: data.inline_qos.clone(), payload: data.payload.clone() }
}
