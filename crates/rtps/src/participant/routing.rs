//! Which reader or writer a submessage is for.

use super::matching::Fit;
use super::{Participant, Role, deliver};
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
        let is_other = |source: &GuidPrefix| *source != own && *source != GuidPrefix::UNKNOWN;
        let Some(source) = source.copied().map(GuidPrefix).filter(is_other) else { return };
        let mut events = Vec::new();
        for message in read::submessages(bytes) {
            let is_for_us = message.destination == own || message.destination == GuidPrefix::UNKNOWN;
            if message.source != source || !is_for_us {
                continue;
            }
            let is_known = self.discovery.renew(now, source);
            let (writer, reader) = ends(&message.submessage);
            if writer.is_builtin() || reader.is_builtin() {
                self.discovery.receive(now, from, channel, &message, &mut events);
                // At once: what follows in this datagram may be of an endpoint that was found by this.
                self.apply(now, std::mem::take(&mut events), out);
            } else if is_known {
                self.receive_sample(now, &message, writer, reader, out);
            }
        }
    }

    /// A submessage of an endpoint of an application: it counts only from one that matches.
    fn receive_sample(
        &mut self,
        now: Now,
        message: &Addressed,
        writer: EntityId,
        reader: EntityId,
        out: &mut Vec<Output>,
    ) {
        let is_to_writer = matches!(message.submessage, Submessage::AckNack(_) | Submessage::NackFrag(_));
        let (from, to) = if is_to_writer { (reader, writer) } else { (writer, reader) };
        let Some(matches) = self.matches.get(&Guid::new(message.source, from)) else { return };
        let is_meant = |own: EntityId| own == to || (to == EntityId::UNKNOWN && !is_to_writer);
        for (entity, _) in matches.iter().filter(|(own, fit)| **fit == Fit::Matched && is_meant(**own)) {
            let Some(own) = self.own.get_mut(entity) else { continue };
            match &mut own.role {
                Role::Writer { writer, .. } => writer.receive(now, message.source, &message.submessage),
                Role::Reader(reader) => {
                    let mut delivered = Vec::new();
                    reader.receive(now, message, &mut delivered);
                    deliver(*entity, delivered, out);
                }
            }
            self.timers.set(*entity, Some(now.steady));
        }
    }
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
