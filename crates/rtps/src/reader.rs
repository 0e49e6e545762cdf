//! Orders, repairs and reassembles what the matched writers of an own reader send (§8.4.12).
//!
//! A reliable reader delivers each sample once and in order, asks for what it lacks, and passes over what a writer no longer has. A
//! best-effort reader delivers what is newer than the last sample.
//!
//! Memory: for each matched writer at most [`ASSEMBLY_BYTES_MAX`] and
//! [`ASSEMBLY_SAMPLES_MAX`](crate::limits::ASSEMBLY_SAMPLES_MAX) of samples that wait, and at most 8 KiB of ranges of numbers.
//! Submessages with any numbers cost bounded time: ranges are never walked number by number.

mod acknowledgement;
mod assembly;
mod best_effort;
mod content;
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
use crate::limits::ASSEMBLY_BYTES_MAX;
use crate::qos::{Qos, Reliability};
use crate::time::Now;
use crate::wire::submessage::{Addressed, Data, Submessage};
use best_effort::BestEffortProxy;
use content::Content;
use reliable::ReliableProxy;
use std::collections::BTreeMap;

/// Numbers above are ignored: no writer gets there, and the arithmetic with those below cannot overflow.
const NUMBER_MAX: i64 = 1 << 62;

/// An own reader.
#[derive(Debug)]
pub(crate) struct Reader {
    entity: EntityId,
    is_reliable: bool,
    without_history: bool,
    /// Bytes of samples that may wait for each writer.
    room: usize,
    writers: BTreeMap<Guid, WriterProxy>,
    /// The highest count of the writers that were removed. One that matches again may remember it.
    count: i32,
    /// Not later than anything that is due for a writer.
    due: Option<u64>,
}

/// The state of the reader for one matched writer (§8.4.12.2).
#[derive(Debug)]
enum WriterProxy {
    Reliable(Box<ReliableProxy>),
    BestEffort(Box<BestEffortProxy>),
}

impl Reader {
    pub(crate) fn new(entity: EntityId, qos: &Qos, without_history: bool) -> Self {
        Self {
            entity,
            is_reliable: qos.reliability == Reliability::Reliable,
            without_history,
            room: ASSEMBLY_BYTES_MAX,
            writers: BTreeMap::new(),
            count: 0,
            due: None,
        }
    }

    /// With less room for samples that wait, for each writer. It must be enough for the largest sample.
    pub(crate) fn with_room(self, room: usize) -> Self {
        Self { room, ..self }
    }

    /// A writer matches, or its address has changed.
    pub(crate) fn add_writer(&mut self, now: Now, writer: Peer) {
        match self.writers.get_mut(&writer.guid) {
            Some(WriterProxy::Reliable(proxy)) => proxy.set_peer(writer),
            Some(WriterProxy::BestEffort(_)) => {}
            None if self.is_reliable && writer.is_reliable => {
                let guid = writer.guid;
                let proxy = ReliableProxy::new(now.steady, writer, self.without_history, self.count, self.room);
                self.writers.insert(guid, WriterProxy::Reliable(Box::new(proxy)));
                self.due = Some(now.steady);
            }
            None => {
                let proxy = BestEffortProxy::new(writer.guid);
                self.writers.insert(writer.guid, WriterProxy::BestEffort(Box::new(proxy)));
            }
        }
    }

    pub(crate) fn remove_writer(&mut self, writer: Guid) {
        if let Some(WriterProxy::Reliable(proxy)) = self.writers.remove(&writer) {
            self.count = self.count.max(proxy.count());
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
        match self.writers.get_mut(&Guid::new(message.source, writer)) {
            Some(WriterProxy::Reliable(proxy)) => {
                proxy.receive(now.steady, message, out);
                self.due = self.due.into_iter().chain(proxy.due()).min();
            }
            Some(WriterProxy::BestEffort(proxy)) => proxy.receive(now.steady, message, out),
            None => {}
        }
    }

    /// Puts out what is due: ACKNACK and NACK_FRAG.
    pub(crate) fn poll(&mut self, now: Now, out: &mut Vec<Outgoing>) {
        if self.due.is_none_or(|due| due > now.steady) {
            return;
        }
        self.due = None;
        for proxy in self.writers.values_mut() {
            if let WriterProxy::Reliable(proxy) = proxy {
                proxy.poll(now.steady, self.entity, out);
                self.due = self.due.into_iter().chain(proxy.due()).min();
            }
        }
    }

    /// When [`Reader::poll`] has something to do next, by the steady clock.
    pub(crate) fn deadline(&self) -> Option<u64> {
        self.due
    }
}

/// The content of a DATA.
fn content_of(message: &Addressed, data: &Data) -> Content {
    Content { timestamp: message.timestamp, inline_qos: data.inline_qos.clone(), payload: data.payload.clone() }
}
