//! Data of writers and readers (§8.5.4.4, §9.6.3).

use super::locator::{self, Locator};
use super::payload::{self, read_name, read_user_data, write_text, write_user_data};
use super::{AnnouncementError, EndpointData};
use crate::guid::{EntityId, Guid, VendorId};
use crate::interface::TopicDescription;
use crate::qos::Qos;
use crate::wire::VERSION;
use crate::wire::cursor::{ByteOrder, Cursor};
use crate::wire::parameters::{ParameterReader, ParameterWriter};
use crate::wire::pid;
use bytes::Bytes;
use std::net::SocketAddrV4;

impl EndpointData {
    /// As the payload of a sample, with encapsulation header (PL_CDR_LE).
    pub fn to_payload(&self) -> Bytes {
        self.to_payload_in(ByteOrder::Little)
    }

    /// The same in either byte order.
    pub fn to_payload_in(&self, order: ByteOrder) -> Bytes {
        payload::write_in_order(order, |list| self.write(list))
    }

    fn write(&self, list: &mut ParameterWriter<'_>) {
        list.add(pid::PROTOCOL_VERSION, |value| value.slice(&VERSION));
        list.add(pid::VENDOR_ID, |value| value.slice(&VendorId::OWN.0));
        list.add(pid::ENDPOINT_GUID, |value| value.guid(self.guid));
        list.add(pid::PARTICIPANT_GUID, |value| value.guid(Guid::new(self.guid.prefix, EntityId::PARTICIPANT)));
        list.add(pid::TOPIC_NAME, |value| write_text(&self.topic.name, value));
        list.add(pid::TYPE_NAME, |value| write_text(&self.topic.type_name, value));
        self.qos.write(list);
        list.add(pid::USER_DATA, |value| write_user_data(&self.user_data, value));
        locator::write(pid::UNICAST_LOCATOR, &self.unicast, list);
        locator::write(pid::MULTICAST_LOCATOR, &self.multicast, list);
    }

    /// From the payload of a sample, in either byte order.
    ///
    /// # Errors
    /// If it is malformed, lacks what identifies it, or must not be taken without an understanding of all of it.
    pub fn from_payload(payload: &Bytes) -> Result<Self, AnnouncementError> {
        let mut cursor = payload::open(payload)?;
        let mut draft = Draft::default();
        let mut list = ParameterReader::new(&mut cursor);
        while let Some((id, value)) = list.next()? {
            draft.read(id, value)?;
        }
        draft.finish()
    }
}

/// The parameters that were read so far.
#[derive(Default)]
struct Draft {
    guid: Option<Guid>,
    topic: Option<String>,
    type_name: Option<String>,
    /// Its reliability has a default that depends on the kind of the endpoint.
    qos: Qos,
    has_reliability: bool,
    user_data: Bytes,
    unicast: Vec<SocketAddrV4>,
    multicast: Vec<SocketAddrV4>,
    has_other_locators: bool,
}

impl Draft {
    fn read(&mut self, id: u16, mut value: Cursor) -> Result<(), AnnouncementError> {
        match id & !pid::MUST_UNDERSTAND {
            pid::ENDPOINT_GUID => self.guid = Some(value.guid()?),
            pid::TOPIC_NAME => self.topic = Some(read_name(&mut value)?),
            pid::TYPE_NAME => self.type_name = Some(read_name(&mut value)?),
            pid::USER_DATA => self.user_data = read_user_data(&mut value)?,
            pid::UNICAST_LOCATOR => self.locator(&mut value)?.add_unicast(&mut self.unicast),
            pid::MULTICAST_LOCATOR => self.locator(&mut value)?.add_multicast(&mut self.multicast),
            // The GUID of the endpoint contains the participant, which announces its version and vendor itself.
            pid::PARTICIPANT_GUID | pid::KEY_HASH | pid::PROTOCOL_VERSION | pid::VENDOR_ID => {}
            policy => {
                let is_known = self.qos.read(policy, &mut value)?;
                self.has_reliability |= policy == pid::RELIABILITY;
                if !is_known && pid::rejects(id) {
                    return Err(AnnouncementError("a parameter that must be understood"));
                }
            }
        }
        Ok(())
    }

    fn locator(&mut self, value: &mut Cursor) -> Result<Locator, AnnouncementError> {
        let locator = Locator::read(value)?;
        self.has_other_locators |= matches!(locator, Locator::Other);
        Ok(locator)
    }

    fn finish(mut self) -> Result<EndpointData, AnnouncementError> {
        let guid = self.guid.ok_or(AnnouncementError("no endpoint GUID"))?;
        if !guid.entity.is_writer() && !guid.entity.is_reader() {
            return Err(AnnouncementError("neither a writer nor a reader"));
        }
        if !self.has_reliability {
            self.qos.reliability = Qos::default_reliability(guid.entity.is_writer());
        }
        let topic = TopicDescription {
            name: self.topic.ok_or(AnnouncementError("no topic"))?,
            type_name: self.type_name.ok_or(AnnouncementError("no type"))?,
            keyed: guid.entity.is_keyed(),
        };
        let Self { qos, user_data, unicast, multicast, has_other_locators, .. } = self;
        Ok(EndpointData { guid, topic, qos, user_data, unicast, multicast, has_other_locators })
    }
}
