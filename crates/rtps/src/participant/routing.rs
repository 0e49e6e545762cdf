//! Which reader or writer a submessage is for.

use super::matching::Fit;
use super::{Participant, Role};
use crate::guid::{EntityId, Guid, GuidPrefix, PREFIX_BYTES};
use crate::interface::{Channel, Output};
use crate::time::Now;
use crate::wire::read;
use crate::wire::submessage::{Addressed, Submessage};
use bytes::Bytes;
use std::net::SocketAddrV4;

/// Where the GUID prefix of the sender stands in the header (§9.4.4): after "RTPS", a version and a vendor.
const SOURCE_AT: usize = 8;

impl Participant {
    /// Takes a datagram in. Nothing of it counts that names another source than its header (a relay), or another destination.
    pub(super) fn receive(
        &mut self,
        now: Now,
        from: SocketAddrV4,
        channel: Channel,
        bytes: &Bytes,
        out: &mut Vec<Output>,
    ) {
        let own = self.guid.prefix;
        let source = bytes.get(SOURCE_AT..).and_then(|rest| rest.first_chunk::<PREFIX_BYTES>());
        let Some(source) = source.copied().map(GuidPrefix).filter(|source| *source != GuidPrefix::UNKNOWN) else {
            self.counters.malformed += 1;
            return;
        };
        if source == own {
            return;
        }
        let mut events = Vec::new();
        let mut messages = read::submessages(bytes);
        for message in &mut messages {
            let is_for_us = message.destination == own || message.destination == GuidPrefix::UNKNOWN;
            if message.source != source || !is_for_us {
                continue;
            }
            let is_known = self.discovery.renew(now, source, &mut events);
            let (writer, reader) = ends(&message.submessage);
            if writer.is_builtin() || reader.is_builtin() {
                self.discovery.receive(now, from, channel, &message, &mut events);
                // At once: what follows in this datagram may be of an endpoint that was found by this.
                self.apply(now, std::mem::take(&mut events), out);
            } else if is_known {
                if asserts_its_writer(&message.submessage) {
                    self.discovery.wrote(now, Guid::new(source, writer), &mut events);
                }
                self.apply(now, std::mem::take(&mut events), out);
                self.receive_sample(now, channel, &message, writer, reader, out);
            }
        }
        self.apply(now, events, out);
        self.counters.malformed += u64::from(messages.is_malformed());
    }

    /// A submessage of an endpoint of an application: it counts only from one that matches.
    fn receive_sample(
        &mut self,
        now: Now,
        channel: Channel,
        message: &Addressed,
        writer: EntityId,
        reader: EntityId,
        out: &mut Vec<Output>,
    ) {
        let is_to_writer = matches!(message.submessage, Submessage::AckNack(_) | Submessage::NackFrag(_));
        let (from, to) = if is_to_writer { (reader, writer) } else { (writer, reader) };
        let is_meant = |own: EntityId| own == to || (to == EntityId::UNKNOWN && !is_to_writer);
        let matches = self.matches.get(&Guid::new(message.source, from));
        let own = matches.into_iter().flatten().filter(|(own, fit)| **fit == Fit::Matched && is_meant(**own));
        let own: Vec<EntityId> = own.map(|(entity, _)| *entity).collect();
        if own.is_empty() && is_sample(&message.submessage) && channel != Channel::DataMulticast {
            // By multicast it may be for others.
            self.counters.unknown_writers += 1;
        }
        for entity in own {
            match self.own.get_mut(&entity).map(|own| &mut own.role) {
                Some(Role::Writer { writer, .. }) => writer.receive(now, message.source, &message.submessage),
                Some(Role::Reader(reader)) => {
                    let (mut delivered, before) = (Vec::new(), reader.held());
                    reader.receive(now, message, &mut delivered);
                    self.held = self.held.saturating_sub(before).saturating_add(reader.held());
                    self.deliver(entity, delivered, out);
                    self.keep_limit(now, out);
                }
                None => {}
            }
            self.timers.set(entity, Some(now.steady));
        }
    }
}

fn is_sample(submessage: &Submessage) -> bool {
    matches!(submessage, Submessage::Data(_) | Submessage::DataFrag(_))
}

/// Does it show that its writer is alive?
fn asserts_its_writer(submessage: &Submessage) -> bool {
    is_sample(submessage) || matches!(submessage, Submessage::Heartbeat(heartbeat) if heartbeat.is_alive)
}

/// The writer and the reader of a submessage.
fn ends(submessage: &Submessage) -> (EntityId, EntityId) {
    match submessage {
        Submessage::Data(data) => (data.writer, data.reader),
        Submessage::DataFrag(fragment) => (fragment.writer, fragment.reader),
        Submessage::Heartbeat(heartbeat) => (heartbeat.writer, heartbeat.reader),
        Submessage::HeartbeatFrag(heartbeat) => (heartbeat.writer, heartbeat.reader),
        Submessage::AckNack(acknack) => (acknack.writer, acknack.reader),
        Submessage::NackFrag(nack) => (nack.writer, nack.reader),
        Submessage::Gap(gap) => (gap.writer, gap.reader),
    }
}
