//! Writes datagrams.

mod submessages;

use crate::guid::{GuidPrefix, VendorId};
use crate::time::Ticks;
use crate::wire::cursor::ByteOrder;
use crate::wire::encoder::Encoder;
use crate::wire::format::{MAGIC, SUBMESSAGE_HEADER_BYTES, VERSION, flag, kind};
use crate::wire::submessage::Submessage;
use bytes::Bytes;

/// A datagram under construction, little endian.
#[derive(Debug)]
pub struct DatagramBuilder {
    encoder: Encoder,
    /// The last INFO_DST.
    destination: GuidPrefix,
    /// The last INFO_TS.
    timestamp: Option<Ticks>,
}

impl DatagramBuilder {
    /// Begins with the RTPS header of this participant.
    pub fn new(source: GuidPrefix) -> Self {
        Self::in_order(ByteOrder::Little, source)
    }

    /// In either byte order, for tests.
    pub(crate) fn in_order(order: ByteOrder, source: GuidPrefix) -> Self {
        let mut encoder = Encoder::new(order);
        encoder.slice(&MAGIC);
        encoder.slice(&VERSION);
        encoder.slice(&VendorId::OWN.0);
        encoder.prefix(source);
        Self { encoder, destination: GuidPrefix::UNKNOWN, timestamp: None }
    }

    /// INFO_DST: what follows is for this participant. Nothing is written if it is so already.
    pub fn destination(&mut self, destination: GuidPrefix) {
        if self.destination != destination {
            self.destination = destination;
            self.header(kind::INFO_DST, 0, 12);
            self.encoder.prefix(destination);
        }
    }

    /// INFO_TS: what follows was made at this time, or has no time. Nothing is written if it is so already.
    pub fn timestamp(&mut self, timestamp: Option<Ticks>) {
        if self.timestamp == timestamp {
            return;
        }
        self.timestamp = timestamp;
        match timestamp {
            Some(time) => {
                self.header(kind::INFO_TS, 0, 8);
                self.encoder.ticks(time);
            }
            None => self.header(kind::INFO_TS, flag::NO_TIME, 0),
        }
    }

    /// Adds a submessage. A payload is padded with zeros to a multiple of four bytes.
    pub fn push(&mut self, submessage: &Submessage) {
        let bytes = Self::bytes_of(submessage);
        self.encoder.reserve(bytes);
        let (kind, flags) = submessage.kind_and_flags();
        self.header(kind, flags, bytes - SUBMESSAGE_HEADER_BYTES);
        submessage.write_body(&mut self.encoder);
        self.encoder.align();
    }

    /// Bytes that a submessage would add.
    pub fn bytes_of(submessage: &Submessage) -> usize {
        (SUBMESSAGE_HEADER_BYTES + submessage.body_bytes()).next_multiple_of(4)
    }

    /// Bytes so far.
    pub fn bytes(&self) -> usize {
        self.encoder.len()
    }

    /// The datagram.
    pub fn finish(self) -> Bytes {
        self.encoder.finish()
    }

    /// A length that needs more than 16 bits is left open: then the submessage is the last one of its datagram.
    fn header(&mut self, kind: u8, flags: u8, length: usize) {
        let little = if self.encoder.order() == ByteOrder::Little { flag::LITTLE_ENDIAN } else { 0 };
        self.encoder.u8(kind);
        self.encoder.u8(flags | little);
        self.encoder.u16(u16::try_from(length).unwrap_or(0));
    }
}
