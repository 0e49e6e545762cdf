//! Reads datagrams.

mod inline_qos;
mod submessages;

use crate::guid::GuidPrefix;
use crate::limits::{DATAGRAM_BYTES_MAX, SUBMESSAGES_MAX};
use crate::time::Ticks;
use crate::wire::cursor::{ByteOrder, Cursor, Malformed};
use crate::wire::format::{MAGIC, VERSION, flag, kind};
use crate::wire::submessage::{Addressed, Submessage};
use bytes::Bytes;

/// The submessages of a datagram, as far as it can be read. A malformed submessage ends the datagram (§8.3.4.1); unknown submessages are
/// skipped. Payloads share the memory of the datagram.
pub fn submessages(datagram: &Bytes) -> DatagramReader {
    DatagramReader::new(datagram.clone())
}

/// Reads one submessage after the other, and keeps the state that INFO submessages set (§8.3.4).
#[derive(Debug)]
pub struct DatagramReader {
    /// None at the end.
    cursor: Option<Cursor>,
    is_malformed: bool,
    count: usize,
    source: GuidPrefix,
    destination: GuidPrefix,
    timestamp: Option<Ticks>,
}

/// One submessage, cut out.
struct Frame {
    kind: u8,
    flags: u8,
    body: Cursor,
}

impl DatagramReader {
    fn new(datagram: Bytes) -> Self {
        let mut reader = Self {
            cursor: None,
            is_malformed: true,
            count: 0,
            source: GuidPrefix::UNKNOWN,
            destination: GuidPrefix::UNKNOWN,
            timestamp: None,
        };
        if datagram.len() <= DATAGRAM_BYTES_MAX {
            let mut cursor = Cursor::new(datagram, ByteOrder::Little);
            reader.is_malformed = reader.read_header(&mut cursor).is_err();
            reader.cursor = (!reader.is_malformed).then_some(cursor);
        }
        reader
    }

    /// Did it end before the datagram, because the rest cannot be read or has too many submessages?
    pub fn is_malformed(&self) -> bool {
        self.is_malformed
    }

    fn read_header(&mut self, cursor: &mut Cursor) -> Result<(), Malformed> {
        if cursor.array()? != MAGIC {
            return Err(Malformed);
        }
        self.read_source(cursor)
    }

    /// Version, vendor and prefix, as in the header and in INFO_SRC. Other major versions are other protocols (§8.3.6.3).
    fn read_source(&mut self, cursor: &mut Cursor) -> Result<(), Malformed> {
        let [major, _minor] = cursor.array()?;
        let [major_of_ours, _] = VERSION;
        if major != major_of_ours {
            return Err(Malformed);
        }
        let _vendor: [u8; 2] = cursor.array()?;
        self.source = cursor.prefix()?;
        Ok(())
    }

    /// The next submessage of an endpoint. None at the end.
    fn read_next(&mut self, cursor: &mut Cursor) -> Result<Option<Addressed>, Malformed> {
        while self.count < SUBMESSAGES_MAX && cursor.remaining() > 0 {
            self.count += 1;
            let mut frame = Frame::read(cursor)?;
            if self.read_info(&mut frame)? {
                continue;
            }
            if let Some(submessage) = Submessage::read(frame.kind, frame.flags, frame.body)? {
                let &mut Self { source, destination, timestamp, .. } = self;
                return Ok(Some(Addressed { source, destination, timestamp, submessage }));
            }
        }
        if cursor.remaining() > 0 { Err(Malformed) } else { Ok(None) }
    }

    /// Applies an INFO submessage. False: it is another kind.
    fn read_info(&mut self, Frame { kind, flags, body }: &mut Frame) -> Result<bool, Malformed> {
        match *kind {
            kind::INFO_DST => self.destination = body.prefix()?,
            kind::INFO_TS if *flags & flag::NO_TIME != 0 => self.timestamp = None,
            kind::INFO_TS => self.timestamp = Some(body.ticks()?).filter(|time| *time != Ticks::INVALID),
            kind::INFO_SRC => {
                body.skip(4)?;
                self.read_source(body)?;
                self.timestamp = None;
            }
            _ => return Ok(false),
        }
        Ok(true)
    }
}

impl Iterator for DatagramReader {
    type Item = Addressed;

    fn next(&mut self) -> Option<Addressed> {
        let mut cursor = self.cursor.take()?;
        let next = self.read_next(&mut cursor);
        self.is_malformed = next.is_err();
        let next = next.ok().flatten()?;
        self.cursor = Some(cursor);
        Some(next)
    }
}

impl Frame {
    fn read(cursor: &mut Cursor) -> Result<Self, Malformed> {
        let [kind, flags] = cursor.array()?;
        cursor.set_order(if flags & flag::LITTLE_ENDIAN != 0 { ByteOrder::Little } else { ByteOrder::Big });
        let length = match usize::from(cursor.u16()?) {
            // The last submessage may leave its length open. Only these two kinds can be empty (§9.4.5.1.3).
            0 if !matches!(kind, kind::PAD | kind::INFO_TS) => cursor.remaining(),
            length => length,
        };
        Ok(Self { kind, flags, body: cursor.part(length)? })
    }
}
