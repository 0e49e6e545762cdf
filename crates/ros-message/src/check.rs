//! Whether bytes can be a message of a type, at the cost of looking at its lengths.

use crate::cdr::Reader;
use crate::definition::Count;
use crate::fault::Fault;
use crate::message::{Element, Message, Structure};

impl Message {
    /// Can these bytes, header included, be a message of this type? Only lengths are looked at, nothing is allocated: what
    /// the numbers mean is for the receiver. Bytes may follow: Fast DDS leaves some, and all listeners of ROS 2 ignore them.
    ///
    /// # Errors
    /// If there are too few bytes, or a length in them is beyond what the type or the bytes admit.
    pub fn check(&self, bytes: &[u8]) -> Result<(), Fault> {
        self.measure(bytes).map(drop)
    }

    /// The same for bytes that a person gives: there, bytes that follow are a slip.
    ///
    /// # Errors
    /// As [`Self::check`], and if more follows than fills up the last four bytes.
    pub fn check_whole(&self, bytes: &[u8]) -> Result<(), Fault> {
        self.measure(bytes)?.end().map_err(|fault| self.not_of_this_type(fault))
    }

    /// Reads over the bytes of a message.
    fn measure<'a>(&self, bytes: &'a [u8]) -> Result<Reader<'a>, Fault> {
        let mut reader = Reader::new(bytes)?;
        structure(&mut reader, &self.structure).map_err(|fault| self.not_of_this_type(fault))?;
        Ok(reader)
    }
}

fn structure(reader: &mut Reader<'_>, of: &Structure) -> Result<(), Fault> {
    if of.fields.is_empty() {
        reader.take(1, 1)?;
    }
    for field in &of.fields {
        elements(reader, &field.element, field.count).map_err(|fault| fault.within(&field.name))?;
    }
    Ok(())
}

fn elements(reader: &mut Reader<'_>, element: &Element, count: Count) -> Result<(), Fault> {
    let count = match count {
        Count::One => 1,
        Count::Array(count) => count,
        Count::Sequence(most) => reader.length(element.bytes_min(), most)?,
    };
    match element {
        // Behind an empty sequence nothing is aligned for elements that do not come.
        Element::Primitive(_) if count == 0 => Ok(()),
        Element::Primitive(primitive) => reader.take(primitive.bytes(), count).map(drop),
        // Every element takes a byte at least, so this ends with the bytes.
        Element::Text(most) => (0..count).try_for_each(|_| reader.text(*most).map(drop)),
        Element::Wide(most) => (0..count).try_for_each(|_| reader.wide(*most).map(drop)),
        Element::Message(inner) => (0..count).try_for_each(|_| structure(reader, inner)),
    }
}
