//! Parts that announcements of participants and endpoints share: encapsulation, texts, USER_DATA.

use super::AnnouncementError;
use crate::limits::{NAME_BYTES_MAX, USER_DATA_BYTES_MAX};
use crate::time::Ticks;
use crate::wire::cursor::{ByteOrder, Cursor, Malformed};
use crate::wire::encoder::Encoder;
use crate::wire::parameters::ParameterWriter;
use bytes::Bytes;

/// Encapsulation of a parameter list, big endian (§10.5).
const PL_CDR_BE: [u8; 2] = [0, 2];
/// Encapsulation of a parameter list, little endian.
const PL_CDR_LE: [u8; 2] = [0, 3];

/// A parameter list with its encapsulation header, little endian.
pub(super) fn write(parameters: impl FnOnce(&mut ParameterWriter<'_>)) -> Bytes {
    write_in_order(ByteOrder::Little, parameters)
}

/// The same in either byte order.
pub(super) fn write_in_order(order: ByteOrder, parameters: impl FnOnce(&mut ParameterWriter<'_>)) -> Bytes {
    let mut encoder = Encoder::new(order);
    encoder.slice(if order == ByteOrder::Little { &PL_CDR_LE } else { &PL_CDR_BE });
    encoder.slice(&[0, 0]);
    let mut list = ParameterWriter::new(&mut encoder);
    parameters(&mut list);
    list.end();
    encoder.finish()
}

/// Behind the encapsulation header, in the byte order that it names.
pub(super) fn open(payload: &Bytes) -> Result<Cursor, AnnouncementError> {
    let mut cursor = Cursor::new(payload.clone(), ByteOrder::Little);
    let order = match cursor.array()? {
        PL_CDR_LE => ByteOrder::Little,
        PL_CDR_BE => ByteOrder::Big,
        _ => return Err(AnnouncementError("not a parameter list")),
    };
    let _options: [u8; 2] = cursor.array()?;
    Ok(Cursor::new(cursor.into_rest(), order))
}

/// A text of CDR: its length with the zero at its end, and its bytes.
pub(super) fn write_text(text: &str, value: &mut Encoder) {
    value.u32(u32::try_from(text.len().saturating_add(1)).unwrap_or(u32::MAX));
    value.slice(text.as_bytes());
    value.u8(0);
}

/// A text of CDR. None if it is longer than [`NAME_BYTES_MAX`].
pub(super) fn read_text(value: &mut Cursor) -> Result<Option<String>, Malformed> {
    let bytes = read_bytes(value)?;
    let text = bytes.strip_suffix(&[0]).unwrap_or(&bytes);
    if text.len() > NAME_BYTES_MAX {
        return Ok(None);
    }
    String::from_utf8(text.to_vec()).map(Some).map_err(|_| Malformed)
}

/// The name of a topic or a type.
pub(super) fn read_name(value: &mut Cursor) -> Result<String, AnnouncementError> {
    read_text(value)?.ok_or(AnnouncementError("a name is too long"))
}

/// A sequence of bytes of CDR.
pub(super) fn write_user_data(data: &[u8], value: &mut Encoder) {
    value.u32(u32::try_from(data.len()).unwrap_or(u32::MAX));
    value.slice(data);
}

/// Of USER_DATA above [`USER_DATA_BYTES_MAX`] nothing is kept. Copied, as announcements outlive their datagrams.
pub(super) fn read_user_data(value: &mut Cursor) -> Result<Bytes, Malformed> {
    let data = read_bytes(value)?;
    Ok(if data.len() <= USER_DATA_BYTES_MAX { Bytes::copy_from_slice(&data) } else { Bytes::new() })
}

fn read_bytes(value: &mut Cursor) -> Result<Bytes, Malformed> {
    let length = usize::try_from(value.u32()?).map_err(|_| Malformed)?;
    value.take(length)
}

/// A duration. Everything from 0x7fffffff seconds on is infinite: implementations write different fractions.
pub(super) fn read_duration(value: &mut Cursor) -> Result<Ticks, Malformed> {
    let ticks = value.ticks()?;
    match ticks.0 >> 32 {
        0..0x7fff_ffff => Ok(ticks),
        0x7fff_ffff => Ok(Ticks::INFINITE),
        _ => Err(Malformed),
    }
}
