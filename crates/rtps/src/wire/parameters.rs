//! Lists of parameters: identifier, length, value (§9.4.2.11).

use crate::limits::PARAMETERS_MAX;
use crate::wire::cursor::{Cursor, Malformed};
use crate::wire::encoder::Encoder;
use crate::wire::pid;

/// Bytes in front of the value of a parameter, and of the sentinel at the end of a list.
pub(crate) const PARAMETER_HEADER_BYTES: usize = 4;

/// Reads the parameters of a list, at most [`PARAMETERS_MAX`], up to its sentinel. Afterwards the cursor is behind the list.
pub(crate) struct ParameterReader<'a> {
    cursor: &'a mut Cursor,
    count: usize,
}

impl<'a> ParameterReader<'a> {
    pub(crate) fn new(cursor: &'a mut Cursor) -> Self {
        Self { cursor, count: 0 }
    }

    /// The next identifier, with its flags, and its value. None at the end of the list.
    pub(crate) fn next(&mut self) -> Result<Option<(u16, Cursor)>, Malformed> {
        while self.count < PARAMETERS_MAX {
            self.count += 1;
            let id = self.cursor.u16()?;
            let length = usize::from(self.cursor.u16()?);
            match id {
                // Its length has no meaning.
                pid::SENTINEL => return Ok(None),
                pid::PAD => self.skip(length)?,
                _ => {
                    let value = self.cursor.part(length)?;
                    self.skip_padding(length)?;
                    return Ok(Some((id, value)));
                }
            }
        }
        Err(Malformed)
    }

    fn skip(&mut self, length: usize) -> Result<(), Malformed> {
        self.cursor.skip(length)?;
        self.skip_padding(length)
    }

    /// Lengths are multiples of four. Fast DDS also accepts others, and aligns the next parameter.
    fn skip_padding(&mut self, length: usize) -> Result<(), Malformed> {
        self.cursor.skip(length.next_multiple_of(4) - length)
    }
}

/// Appends a list of parameters.
pub(crate) struct ParameterWriter<'a>(&'a mut Encoder);

impl<'a> ParameterWriter<'a> {
    pub(crate) fn new(encoder: &'a mut Encoder) -> Self {
        Self(encoder)
    }

    /// Appends a parameter. One whose value is longer than 65 532 bytes is left out: its length has 16 bits.
    pub(crate) fn add(&mut self, id: u16, write: impl FnOnce(&mut Encoder)) {
        let mut value = Encoder::new(self.0.order());
        write(&mut value);
        value.align();
        if let Ok(length) = u16::try_from(value.len()) {
            self.0.u16(id);
            self.0.u16(length);
            self.0.slice(&value.finish());
        }
    }

    /// Appends the sentinel.
    pub(crate) fn end(self) {
        self.0.u16(pid::SENTINEL);
        self.0.u16(0);
    }
}
