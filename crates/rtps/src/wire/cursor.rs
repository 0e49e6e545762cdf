//! Checked reading of bytes in either byte order.

use crate::guid::{EntityId, Guid, GuidPrefix, SequenceNumber};
use crate::time::Ticks;
use bytes::{Buf, Bytes};

/// The bytes are not what the protocol demands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("malformed bytes")]
pub(crate) struct Malformed;

/// Order of the bytes of a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ByteOrder {
    /// The least significant byte first.
    Little,
    /// The most significant byte first.
    Big,
}

/// Reads from the front. Its parts share memory with the whole.
#[derive(Clone, Debug)]
pub(crate) struct Cursor {
    rest: Bytes,
    order: ByteOrder,
    /// Bytes that were read, to which alignment refers.
    position: usize,
}

impl Cursor {
    pub(crate) fn new(bytes: Bytes, order: ByteOrder) -> Self {
        Self { rest: bytes, order, position: 0 }
    }

    /// The byte order of what follows.
    pub(crate) fn set_order(&mut self, order: ByteOrder) {
        self.order = order;
    }

    pub(crate) fn remaining(&self) -> usize {
        self.rest.len()
    }

    /// All that is left.
    pub(crate) fn into_rest(self) -> Bytes {
        self.rest
    }

    pub(crate) fn take(&mut self, bytes: usize) -> Result<Bytes, Malformed> {
        if bytes > self.rest.len() {
            return Err(Malformed);
        }
        self.position += bytes;
        Ok(self.rest.split_to(bytes))
    }

    /// The next bytes as a cursor of their own.
    pub(crate) fn part(&mut self, bytes: usize) -> Result<Self, Malformed> {
        let order = self.order;
        self.take(bytes).map(|part| Self::new(part, order))
    }

    pub(crate) fn skip(&mut self, bytes: usize) -> Result<(), Malformed> {
        if bytes > self.rest.len() {
            return Err(Malformed);
        }
        self.position += bytes;
        self.rest.advance(bytes);
        Ok(())
    }

    /// Skips the padding in front of a number of four bytes.
    pub(crate) fn align(&mut self) -> Result<(), Malformed> {
        self.skip(self.position.next_multiple_of(4) - self.position)
    }

    pub(crate) fn array<const N: usize>(&mut self) -> Result<[u8; N], Malformed> {
        let array = *self.rest.first_chunk().ok_or(Malformed)?;
        self.skip(N)?;
        Ok(array)
    }

    pub(crate) fn u16(&mut self) -> Result<u16, Malformed> {
        let bytes = self.array()?;
        Ok(match self.order {
            ByteOrder::Little => u16::from_le_bytes(bytes),
            ByteOrder::Big => u16::from_be_bytes(bytes),
        })
    }

    pub(crate) fn i16(&mut self) -> Result<i16, Malformed> {
        self.u16().map(u16::cast_signed)
    }

    pub(crate) fn u32(&mut self) -> Result<u32, Malformed> {
        let bytes = self.array()?;
        Ok(match self.order {
            ByteOrder::Little => u32::from_le_bytes(bytes),
            ByteOrder::Big => u32::from_be_bytes(bytes),
        })
    }

    pub(crate) fn i32(&mut self) -> Result<i32, Malformed> {
        self.u32().map(u32::cast_signed)
    }

    /// A number of eight bytes whose upper half comes first in either byte order: `SequenceNumber_t`, `Time_t`, `Duration_t`.
    fn halves(&mut self) -> Result<u64, Malformed> {
        let upper = self.u32()?;
        Ok(u64::from(upper) << 32 | u64::from(self.u32()?))
    }

    pub(crate) fn sequence(&mut self) -> Result<SequenceNumber, Malformed> {
        self.halves().map(|number| SequenceNumber(number.cast_signed()))
    }

    pub(crate) fn ticks(&mut self) -> Result<Ticks, Malformed> {
        self.halves().map(Ticks)
    }

    pub(crate) fn prefix(&mut self) -> Result<GuidPrefix, Malformed> {
        self.array().map(GuidPrefix)
    }

    pub(crate) fn entity(&mut self) -> Result<EntityId, Malformed> {
        self.array().map(EntityId)
    }

    pub(crate) fn guid(&mut self) -> Result<Guid, Malformed> {
        self.array().map(Guid::from_bytes)
    }
}
