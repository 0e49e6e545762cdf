//! CDR: numbers aligned to their own size, counted from behind the header.
//!
//! ```text
//! 0      2      4
//! +------+------+--------
//! | id   | opts | body …     id 00 00: big endian; 00 01: little endian; opts: padding at the end, not read
//! +------+------+--------
//! ```
//!
//! A string is its length with its final NUL as `uint32`, its bytes, and the NUL. A sequence is the number of its elements
//! as `uint32`, and the elements; an array the elements alone. A message without fields is one byte.
//!
//! A `wstring` is the number of its units of UTF-16 as `uint32`, and each unit as another, without a NUL. Fast DDS and CycloneDDS of ROS 2
//! write it like this on Linux.
//!
//! Bytes may follow a message. Fast DDS leaves what was in its buffer there, and no listener of ROS 2 reads on.

use crate::fault::Fault;

/// Bytes of the header in front of every message.
pub(crate) const HEADER_BYTES: usize = 4;
/// Bytes of a unit of a `wstring`.
pub(crate) const WIDE_BYTES: usize = 4;
/// DDS fills what it carries up to a multiple of so many bytes.
const FILL_BYTES: usize = 4;

/// Which byte of a number comes first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ByteOrder {
    /// The least significant one: what ROS 2 sends on nearly all machines.
    Little,
    /// The most significant one.
    Big,
}

impl ByteOrder {
    pub(crate) fn header(self) -> [u8; HEADER_BYTES] {
        match self {
            Self::Big => [0, 0, 0, 0],
            Self::Little => [0, 1, 0, 0],
        }
    }
}

/// Reads a body. Never reads beyond its end.
pub(crate) struct Reader<'a> {
    body: &'a [u8],
    at: usize,
    order: ByteOrder,
}

impl<'a> Reader<'a> {
    /// Of a message with its header.
    pub(crate) fn new(bytes: &'a [u8]) -> Result<Self, Fault> {
        let Some((header, body)) = bytes.split_at_checked(HEADER_BYTES) else {
            return Err(Fault::new("this is too short for a message")
                .found(format!("{} bytes", bytes.len()))
                .wanted("a header of 4 bytes, such as 00 01 00 00, and the message behind it"));
        };
        let order = match header {
            [0, 0, ..] => ByteOrder::Big,
            [0, 1, ..] => ByteOrder::Little,
            [0, id @ (2 | 3 | 6..=11), ..] => {
                let name = match id {
                    2 | 3 => "parameter list CDR",
                    6 | 7 => "XCDR2",
                    8 | 9 => "XCDR2 of an appendable type",
                    _ => "XCDR2 of a mutable type",
                };
                return Err(Fault::new(format!("this message is {name}, which is passed on and not decoded"))
                    .found(format!("the header 00 {id:02x}"))
                    .wanted("the header 00 01 00 00 (CDR, little endian) or 00 00 00 00 (big endian)"));
            }
            _ => {
                let found: Vec<_> = header.iter().map(|byte| format!("{byte:02x}")).collect();
                return Err(Fault::new("these bytes do not begin as a message of ROS 2 does")
                    .found(found.join(" "))
                    .wanted("the header 00 01 00 00 (CDR, little endian) or 00 00 00 00 (big endian)"));
            }
        };
        Ok(Self { body, at: 0, order })
    }

    /// Bytes that were not read yet.
    pub(crate) fn left(&self) -> usize {
        self.body.len().saturating_sub(self.at)
    }

    /// The next `count` elements of `size` bytes, which is their alignment too.
    pub(crate) fn take(&mut self, size: usize, count: usize) -> Result<&'a [u8], Fault> {
        let start = self.at.next_multiple_of(size);
        let bytes = size.saturating_mul(count);
        let taken = start.checked_add(bytes).and_then(|end| self.body.get(start..end));
        match taken {
            Some(taken) => {
                self.at = start + bytes;
                Ok(taken)
            }
            None => Err(Fault::new("the message ends too early")
                .found(format!("{} bytes behind the header", self.body.len()))
                .wanted(format!("at least {}", start.saturating_add(bytes)))),
        }
    }

    /// A number of at most 8 bytes, as the bits of an unsigned one.
    pub(crate) fn number(&mut self, size: usize) -> Result<u64, Fault> {
        self.take(size, 1).map(|bytes| self.unsigned(bytes))
    }

    /// The bits of a number from its bytes.
    pub(crate) fn unsigned(&self, bytes: &[u8]) -> u64 {
        let fold = |value: u64, byte: &u8| value << 8 | u64::from(*byte);
        match self.order {
            ByteOrder::Big => bytes.iter().fold(0, fold),
            ByteOrder::Little => bytes.iter().rev().fold(0, fold),
        }
    }

    /// The length of a sequence whose elements take at least `bytes_min` each: never more than fit into what is left.
    pub(crate) fn length(&mut self, bytes_min: usize, most: Option<usize>) -> Result<usize, Fault> {
        let length = self.number(4)? as usize;
        if most.is_some_and(|most| length > most) {
            return Err(Fault::new("a sequence is longer than its type admits")
                .found(format!("{length} elements"))
                .wanted(format!("at most {}", most.unwrap_or_default())));
        }
        if length.saturating_mul(bytes_min) > self.left() {
            return Err(Fault::new("the message ends too early")
                .found(format!("{} bytes behind the length of a sequence", self.left()))
                .wanted(format!("at least {} for its {length} elements", length.saturating_mul(bytes_min))));
        }
        Ok(length)
    }

    /// The bytes of a string without its final NUL.
    pub(crate) fn text(&mut self, most: Option<usize>) -> Result<&'a [u8], Fault> {
        let length = self.length(1, most.map(|most| most.saturating_add(1)))?;
        let bytes = self.take(1, length)?;
        // An empty string of some middlewares has no NUL either.
        Ok(bytes.strip_suffix(&[0]).unwrap_or(bytes))
    }

    /// The bytes of a `wstring`.
    pub(crate) fn wide(&mut self, most: Option<usize>) -> Result<&'a [u8], Fault> {
        let length = self.length(WIDE_BYTES, most)?;
        self.take(WIDE_BYTES, length)
    }

    /// Nothing but what DDS fills up with may be left.
    pub(crate) fn end(&self) -> Result<(), Fault> {
        let (left, all) = (self.left(), self.body.len());
        if left == 0 || (left < FILL_BYTES && all.is_multiple_of(FILL_BYTES)) {
            return Ok(());
        }
        Err(Fault::new("the message is longer than its type")
            .found(format!("{all} bytes behind the header, {left} of them left over"))
            .wanted(format!("{} bytes behind the header", self.at)))
    }
}

/// Writes a body behind its header.
pub(crate) struct Writer {
    bytes: Vec<u8>,
    order: ByteOrder,
    limit: usize,
}

impl Writer {
    /// Of a message of at most `limit` bytes, header included.
    pub(crate) fn new(order: ByteOrder, limit: usize) -> Self {
        Self { bytes: order.header().to_vec(), order, limit }
    }

    fn room(&self, more: usize) -> Result<(), Fault> {
        if self.bytes.len().saturating_add(more) <= self.limit {
            return Ok(());
        }
        Err(Fault::new("the message is too long").wanted(format!("at most {} bytes", self.limit)))
    }

    /// The low `size` bytes of a number, aligned.
    pub(crate) fn number(&mut self, size: usize, bits: u64) -> Result<(), Fault> {
        self.room(2 * size)?;
        let body = self.bytes.len().saturating_sub(HEADER_BYTES);
        self.bytes.resize(body.next_multiple_of(size) + HEADER_BYTES, 0);
        let (little, big) = (bits.to_le_bytes(), bits.to_be_bytes());
        let bytes = match self.order {
            ByteOrder::Little => little.get(..size),
            ByteOrder::Big => big.get(big.len().saturating_sub(size)..),
        };
        self.bytes.extend_from_slice(bytes.unwrap_or_default());
        Ok(())
    }

    /// The length of a sequence.
    pub(crate) fn length(&mut self, length: usize) -> Result<(), Fault> {
        let length = u32::try_from(length).map_err(|_| Fault::new("a sequence is too long"))?;
        self.number(4, length.into())
    }

    /// A string.
    pub(crate) fn text(&mut self, text: &str) -> Result<(), Fault> {
        self.length(text.len().saturating_add(1))?;
        self.room(text.len().saturating_add(1))?;
        self.bytes.extend_from_slice(text.as_bytes());
        self.bytes.push(0);
        Ok(())
    }

    /// A `wstring`.
    pub(crate) fn wide(&mut self, text: &str) -> Result<(), Fault> {
        self.length(text.encode_utf16().count())?;
        text.encode_utf16().try_for_each(|unit| self.number(WIDE_BYTES, unit.into()))
    }

    pub(crate) fn finish(self) -> Vec<u8> {
        self.bytes
    }
}
