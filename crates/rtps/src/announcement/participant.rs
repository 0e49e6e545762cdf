//! Data of participants (§8.5.3.2, §9.6.3).

use super::locator::{self, Locator};
use super::payload::{self, read_duration, read_text, read_user_data, write_text, write_user_data};
use super::{AnnouncementError, ParticipantData};
use crate::guid::{EntityId, Guid, GuidPrefix, VendorId};
use crate::time::Ticks;
use crate::wire::VERSION;
use crate::wire::cursor::{ByteOrder, Cursor};
use crate::wire::parameters::{ParameterReader, ParameterWriter};
use crate::wire::pid;
use bytes::Bytes;
use std::time::Duration;

/// `PID_PARTICIPANT_LEASE_DURATION` where it is absent (§9.6.3).
const LEASE_DEFAULT: Duration = Duration::from_secs(100);

impl ParticipantData {
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
        list.add(pid::VENDOR_ID, |value| value.slice(&self.vendor.0));
        list.add(pid::PARTICIPANT_GUID, |value| value.guid(Guid::new(self.prefix, EntityId::PARTICIPANT)));
        if let Some(domain) = self.domain {
            list.add(pid::DOMAIN_ID, |value| value.u32(domain));
        }
        list.add(pid::PARTICIPANT_LEASE_DURATION, |value| value.ticks(ticks_of(self.lease)));
        list.add(pid::BUILTIN_ENDPOINT_SET, |value| value.u32(self.builtin_endpoints));
        locator::write(pid::METATRAFFIC_UNICAST_LOCATOR, &self.discovery_unicast, list);
        locator::write(pid::METATRAFFIC_MULTICAST_LOCATOR, &self.discovery_multicast, list);
        locator::write(pid::DEFAULT_UNICAST_LOCATOR, &self.data_unicast, list);
        locator::write(pid::DEFAULT_MULTICAST_LOCATOR, &self.data_multicast, list);
        list.add(pid::ENTITY_NAME, |value| write_text(&self.name, value));
        list.add(pid::USER_DATA, |value| write_user_data(&self.user_data, value));
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
        let data = Self {
            prefix: draft.guid.ok_or(AnnouncementError("no participant GUID"))?.prefix,
            builtin_endpoints: draft.builtin_endpoints.ok_or(AnnouncementError("no set of builtin endpoints"))?,
            ..draft.data
        };
        if data.prefix == GuidPrefix::UNKNOWN || draft.guid.is_some_and(|guid| guid.entity != EntityId::PARTICIPANT) {
            return Err(AnnouncementError("not the GUID of a participant"));
        }
        Ok(data)
    }
}

/// The parameters that were read so far.
struct Draft {
    guid: Option<Guid>,
    builtin_endpoints: Option<u32>,
    data: ParticipantData,
}

impl Default for Draft {
    fn default() -> Self {
        let data = ParticipantData {
            prefix: GuidPrefix::UNKNOWN,
            vendor: VendorId::UNKNOWN,
            domain: None,
            lease: LEASE_DEFAULT,
            discovery_unicast: Vec::new(),
            discovery_multicast: Vec::new(),
            data_unicast: Vec::new(),
            data_multicast: Vec::new(),
            builtin_endpoints: 0,
            name: String::new(),
            user_data: Bytes::new(),
        };
        Self { guid: None, builtin_endpoints: None, data }
    }
}

impl Draft {
    fn read(&mut self, id: u16, mut value: Cursor) -> Result<(), AnnouncementError> {
        let value = &mut value;
        let data = &mut self.data;
        if id == pid::DOMAIN_TAG {
            // Participants with different tags do not discover each other (§8.5.3.2). The tag here is empty.
            let tag = read_text(value)?;
            return if tag.is_some_and(|tag| tag.is_empty()) { Ok(()) } else { Err(AnnouncementError("a domain tag")) };
        }
        match id & !pid::MUST_UNDERSTAND {
            pid::PROTOCOL_VERSION => {
                let [major, _minor] = value.array()?;
                if major != VERSION[0] {
                    return Err(AnnouncementError("another major version of the protocol"));
                }
            }
            pid::VENDOR_ID => data.vendor = VendorId(value.array()?),
            pid::PARTICIPANT_GUID => self.guid = Some(value.guid()?),
            pid::DOMAIN_ID => data.domain = Some(value.u32()?),
            pid::PARTICIPANT_LEASE_DURATION => data.lease = duration_of(read_duration(value)?),
            pid::BUILTIN_ENDPOINT_SET => self.builtin_endpoints = Some(value.u32()?),
            pid::METATRAFFIC_UNICAST_LOCATOR => Locator::read(value)?.add_unicast(&mut data.discovery_unicast),
            pid::METATRAFFIC_MULTICAST_LOCATOR => Locator::read(value)?.add_multicast(&mut data.discovery_multicast),
            pid::DEFAULT_UNICAST_LOCATOR => Locator::read(value)?.add_unicast(&mut data.data_unicast),
            pid::DEFAULT_MULTICAST_LOCATOR => Locator::read(value)?.add_multicast(&mut data.data_multicast),
            pid::ENTITY_NAME => data.name = read_text(value)?.unwrap_or_default(),
            pid::USER_DATA => data.user_data = read_user_data(value)?,
            _ if pid::rejects(id) => return Err(AnnouncementError("a parameter that must be understood")),
            _ => {}
        }
        Ok(())
    }
}

fn ticks_of(duration: Duration) -> Ticks {
    u64::try_from(duration.as_nanos()).map_or(Ticks::INFINITE, Ticks::from_nanos)
}

fn duration_of(ticks: Ticks) -> Duration {
    ticks.to_nanos().map_or(Duration::MAX, Duration::from_nanos)
}
