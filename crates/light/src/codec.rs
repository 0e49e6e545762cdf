//! Bytes in one form only: numbers are big-endian, and a part of variable length carries its length.

use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};

/// Appends a part with its length, `u32` BE.
pub fn put(to: &mut Vec<u8>, part: &[u8]) {
    to.extend_from_slice(&(part.len() as u32).to_be_bytes());
    to.extend_from_slice(part);
}

/// Reads bytes that may be hostile. Nothing is allocated for a length that the bytes do not have.
pub struct Reader<'a> {
    what: &'static str,
    length: usize,
    rest: &'a [u8],
}

impl<'a> Reader<'a> {
    /// Of a thing with this name, which has at most so many bytes and begins with these.
    ///
    /// # Errors
    /// [`Code::TooLarge`], [`Code::Malformed`].
    pub fn new(what: &'static str, max: usize, begins: &[u8], bytes: &'a [u8]) -> Result<Self, Rejection> {
        if bytes.len() > max {
            return Err(Rejection::new(Code::TooLarge, format!("{what} is too large"))
                .found(format!("{} bytes", bytes.len()))
                .wanted(format!("at most {max} bytes"))
                .next("ask another node for it"));
        }
        let mut reader = Self { what, length: bytes.len(), rest: bytes };
        if reader.take(begins.len())? != begins {
            return Err(reader.malformed("other first bytes", "those of its kind and version"));
        }
        Ok(reader)
    }

    /// So many bytes.
    ///
    /// # Errors
    /// [`Code::Malformed`] if there are fewer, as of all that follows.
    pub fn take(&mut self, count: usize) -> Result<&'a [u8], Rejection> {
        let Some((part, rest)) = self.rest.split_at_checked(count) else {
            return Err(self.malformed("too few bytes", &format!("{count} more")));
        };
        self.rest = rest;
        Ok(part)
    }

    /// So many bytes, as an array.
    ///
    /// # Errors
    /// [`Code::Malformed`].
    pub fn array<const N: usize>(&mut self) -> Result<[u8; N], Rejection> {
        let part = self.take(N)?;
        part.try_into().map_err(|_| self.malformed("too few bytes", &format!("{N} more")))
    }

    /// One byte.
    ///
    /// # Errors
    /// [`Code::Malformed`].
    pub fn byte(&mut self) -> Result<u8, Rejection> {
        self.array::<1>().map(|[byte]| byte)
    }

    /// A number, BE.
    ///
    /// # Errors
    /// [`Code::Malformed`].
    pub fn u32(&mut self) -> Result<u32, Rejection> {
        self.array().map(u32::from_be_bytes)
    }

    /// A number, BE.
    ///
    /// # Errors
    /// [`Code::Malformed`].
    pub fn u64(&mut self) -> Result<u64, Rejection> {
        self.array().map(u64::from_be_bytes)
    }

    /// A hash.
    ///
    /// # Errors
    /// [`Code::Malformed`].
    pub fn hash(&mut self) -> Result<Hash, Rejection> {
        self.array().map(Hash)
    }

    /// A part with its length.
    ///
    /// # Errors
    /// [`Code::Malformed`] if it is longer than `max`, or than what is left.
    pub fn part(&mut self, max: usize) -> Result<&'a [u8], Rejection> {
        let length = self.u32()? as usize;
        if length > max {
            return Err(self.malformed(&format!("a part of {length} bytes"), &format!("at most {max}")));
        }
        self.take(length)
    }

    /// A part that is UTF-8.
    ///
    /// # Errors
    /// [`Code::Malformed`].
    pub fn text(&mut self, max: usize) -> Result<&'a str, Rejection> {
        let part = self.part(max)?;
        std::str::from_utf8(part).map_err(|error| self.malformed(&error.to_string(), "UTF-8"))
    }

    /// A part, on its own.
    ///
    /// # Errors
    /// [`Code::Malformed`].
    pub fn part_owned(&mut self, max: usize) -> Result<Bytes, Rejection> {
        self.part(max).map(Bytes::copy_from_slice)
    }

    /// Nothing may be left.
    ///
    /// # Errors
    /// [`Code::Malformed`] if something is.
    pub fn end(self) -> Result<(), Rejection> {
        match self.rest.len() {
            0 => Ok(()),
            more => Err(self.malformed(&format!("{more} bytes too many"), "its end")),
        }
    }

    /// A refusal of what was found at the place that is reached.
    pub fn malformed(&self, found: &str, wanted: &str) -> Rejection {
        let at = self.length - self.rest.len();
        Rejection::new(Code::Malformed, format!("{} cannot be read", self.what))
            .found(format!("{found} at byte {at}"))
            .wanted(wanted)
            .next("ask another node for it")
    }
}
