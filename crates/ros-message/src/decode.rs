//! CDR to a value.

use crate::cdr::{Reader, WIDE_BYTES};
use crate::definition::{Count, Primitive};
use crate::fault::Fault;
use crate::message::{Element, Field, Message, Structure};
use crate::value::Value;
use std::sync::Arc;

/// Most numbers, strings and messages of one message, bytes of many `uint8` not counted: each costs far more memory than
/// the byte that may stand for it.
const VALUES_MAX: usize = 1024 * 1024;

impl Message {
    /// Reads a message with its header. Bytes may follow, as in [`Self::check`].
    ///
    /// # Errors
    /// If the bytes cannot be a message of this type, with the field at which that shows.
    pub fn decode(&self, bytes: &[u8]) -> Result<Value, Fault> {
        let mut decoder = Decoder { reader: Reader::new(bytes)?, left: VALUES_MAX };
        decoder.structure(&self.structure).map_err(|fault| self.not_of_this_type(fault))
    }

    /// A fault of the bytes, with the name of the type.
    pub(crate) fn not_of_this_type(&self, fault: Fault) -> Fault {
        let message = format!("this is no {}: {}", self.name(), fault.message);
        Fault { message, ..fault }
    }
}

struct Decoder<'a> {
    reader: Reader<'a>,
    /// How many values may still be made.
    left: usize,
}

impl Decoder<'_> {
    fn structure(&mut self, structure: &Structure) -> Result<Value, Fault> {
        if structure.fields.is_empty() {
            self.reader.take(1, 1)?;
        }
        let mut fields = Vec::with_capacity(structure.fields.len());
        for field in &structure.fields {
            let value = self.field(field).map_err(|fault| fault.within(&field.name))?;
            fields.push((Arc::clone(&field.name), value));
        }
        Ok(Value::Fields(fields))
    }

    fn field(&mut self, field: &Field) -> Result<Value, Fault> {
        let count = match field.count {
            Count::One => return self.element(&field.element),
            Count::Array(count) => count,
            Count::Sequence(most) => self.reader.length(field.element.bytes_min(), most)?,
        };
        if let Element::Primitive(Primitive::U8 | Primitive::Byte) = field.element {
            return Ok(Value::Bytes(self.reader.take(1, count)?.to_vec()));
        }
        if count.saturating_mul(field.element.bytes_min()) > self.reader.left() {
            return Err(Fault::new("the message ends too early")
                .found(format!("{} bytes left", self.reader.left()))
                .wanted(format!("{count} elements")));
        }
        if count > self.left {
            return Err(too_many());
        }
        let mut elements = Vec::with_capacity(count);
        for _ in 0..count {
            elements.push(self.element(&field.element)?);
        }
        Ok(Value::List(elements))
    }

    fn element(&mut self, element: &Element) -> Result<Value, Fault> {
        self.left = self.left.checked_sub(1).ok_or_else(too_many)?;
        match element {
            Element::Primitive(primitive) => self.reader.number(primitive.bytes()).map(|bits| read(*primitive, bits)),
            Element::Text(most) => {
                self.reader.text(*most).map(|bytes| Value::Text(String::from_utf8_lossy(bytes).into_owned()))
            }
            Element::Wide(most) => self.reader.wide(*most).map(|bytes| Value::Text(self.wide(bytes))),
            Element::Message(structure) => self.structure(structure),
        }
    }
}

impl Decoder<'_> {
    /// Text of units of UTF-16. Some writers have a whole character in one; others than these two are replaced by U+FFFD.
    fn wide(&self, bytes: &[u8]) -> String {
        let mut units = Vec::with_capacity(bytes.len() / WIDE_BYTES);
        for unit in bytes.chunks_exact(WIDE_BYTES).map(|unit| self.reader.unsigned(unit) as u32) {
            match u16::try_from(unit) {
                Ok(unit) => units.push(unit),
                Err(_) => {
                    let c = char::from_u32(unit).unwrap_or(char::REPLACEMENT_CHARACTER);
                    units.extend_from_slice(c.encode_utf16(&mut [0; 2]));
                }
            }
        }
        String::from_utf16_lossy(&units)
    }
}

fn too_many() -> Fault {
    Fault::new("the message has too many parts to be shown").wanted(format!("at most {VALUES_MAX}"))
}

/// A number from its bits.
fn read(primitive: Primitive, bits: u64) -> Value {
    match primitive {
        Primitive::Bool => Value::Bool(bits != 0),
        Primitive::U8 | Primitive::Byte | Primitive::U16 | Primitive::U32 | Primitive::U64 => Value::Unsigned(bits),
        Primitive::I8 => Value::Signed((bits as u8).cast_signed().into()),
        Primitive::I16 => Value::Signed((bits as u16).cast_signed().into()),
        Primitive::I32 => Value::Signed((bits as u32).cast_signed().into()),
        Primitive::I64 => Value::Signed(bits.cast_signed()),
        Primitive::F32 => Value::Single(f32::from_bits(bits as u32)),
        Primitive::F64 => Value::Double(f64::from_bits(bits)),
    }
}
