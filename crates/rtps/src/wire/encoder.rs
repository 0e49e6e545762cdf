//! Writes numbers and identifiers as bytes.

use crate::guid::{EntityId, Guid, GuidPrefix, SequenceNumber};
use crate::time::Ticks;
use crate::wire::cursor::ByteOrder;
use bytes::{BufMut, Bytes, BytesMut};

/// Appends to a buffer. The crate writes little endian; its tests write both.
#[derive(Debug)]
pub(crate) struct Encoder {
    bytes: BytesMut,
    order: ByteOrder,
}

impl Encoder {
    pub(crate) fn new(order: ByteOrder) -> Self {
        Self { bytes: BytesMut::new(), order }
    }

    pub(crate) fn order(&self) -> ByteOrder {
        self.order
    }

    pub(crate) fn len(&self) -> usize {
        self.bytes.len()
    }

    pub(crate) fn reserve(&mut self, bytes: usize) {
        self.bytes.reserve(bytes);
    }

    pub(crate) fn finish(self) -> Bytes {
        self.bytes.freeze()
    }

    pub(crate) fn slice(&mut self, bytes: &[u8]) {
        self.bytes.put_slice(bytes);
    }

    /// Zeros up to a multiple of four bytes.
    pub(crate) fn align(&mut self) {
        let length = self.len();
        self.bytes.put_bytes(0, length.next_multiple_of(4) - length);
    }

    pub(crate) fn u8(&mut self, number: u8) {
        self.bytes.put_u8(number);
    }

    pub(crate) fn u16(&mut self, number: u16) {
        match self.order {
            ByteOrder::Little => self.bytes.put_u16_le(number),
            ByteOrder::Big => self.bytes.put_u16(number),
        }
    }

    pub(crate) fn u32(&mut self, number: u32) {
        match self.order {
            ByteOrder::Little => self.bytes.put_u32_le(number),
            ByteOrder::Big => self.bytes.put_u32(number),
        }
    }

    pub(crate) fn i32(&mut self, number: i32) {
        self.u32(number.cast_unsigned());
    }

    /// The upper half first, in either byte order.
    fn halves(&mut self, number: u64) {
        let [a, b, c, d, e, f, g, h] = number.to_be_bytes();
        self.u32(u32::from_be_bytes([a, b, c, d]));
        self.u32(u32::from_be_bytes([e, f, g, h]));
    }

    pub(crate) fn sequence(&mut self, number: SequenceNumber) {
        self.halves(number.0.cast_unsigned());
    }

    pub(crate) fn ticks(&mut self, ticks: Ticks) {
        self.halves(ticks.0);
    }

    pub(crate) fn prefix(&mut self, prefix: GuidPrefix) {
        self.slice(&prefix.0);
    }

    pub(crate) fn entity(&mut self, entity: EntityId) {
        self.slice(&entity.0);
    }

    pub(crate) fn guid(&mut self, guid: Guid) {
        self.slice(&guid.to_bytes());
    }
}
