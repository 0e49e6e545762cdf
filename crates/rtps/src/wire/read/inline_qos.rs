//! Reads the parameters in front of a sample.

use crate::guid::SampleIdentity;
use crate::wire::cursor::{Cursor, Malformed};
use crate::wire::parameters::ParameterReader;
use crate::wire::pid;
use crate::wire::submessage::InlineQos;

impl InlineQos {
    /// Reads a list, up to its sentinel. Other parameters are skipped.
    pub(super) fn read(body: &mut Cursor) -> Result<Self, Malformed> {
        let mut qos = Self::default();
        let mut related_custom = None;
        let mut parameters = ParameterReader::new(body);
        while let Some((id, mut value)) = parameters.next()? {
            match id & !pid::MUST_UNDERSTAND {
                // Big endian, whatever the submessage is (§9.6.4.9).
                pid::STATUS_INFO => qos.status = u32::from_be_bytes(value.array()?),
                pid::KEY_HASH => qos.key_hash = Some(value.array()?),
                pid::RELATED_SAMPLE_IDENTITY => qos.related = Some(read_identity(&mut value)?),
                pid::RELATED_SAMPLE_IDENTITY_CUSTOM => related_custom = read_identity(&mut value).ok(),
                _ => {}
            }
        }
        qos.related = qos.related.or(related_custom);
        Ok(qos)
    }
}

fn read_identity(value: &mut Cursor) -> Result<SampleIdentity, Malformed> {
    Ok(SampleIdentity { writer: value.guid()?, sequence: value.sequence()? })
}
