//! A definition with everything that it contains.

use crate::definition::{Count, Primitive};
use crate::written::Written;
use std::collections::BTreeMap;
use std::sync::Arc;

/// A type of message that can be read and written: made by [`Library::message`](crate::Library::message). Cloning is
/// cheap.
#[derive(Clone, Debug)]
pub struct Message {
    pub(crate) structure: Arc<Structure>,
}

/// The fields of a message, each with its own.
#[derive(Debug)]
pub(crate) struct Structure {
    /// `geometry_msgs/msg/Twist`.
    pub(crate) name: String,
    /// In the order in which they are written.
    pub(crate) fields: Vec<Field>,
    /// How deep messages lie within it; 1 if there are none.
    pub(crate) depth: usize,
}

/// One field.
#[derive(Debug)]
pub(crate) struct Field {
    /// Shared with every value that is decoded.
    pub(crate) name: Arc<str>,
    pub(crate) element: Element,
    pub(crate) count: Count,
    /// Its default; zero, empty, or the fields' own defaults without it.
    pub(crate) default: Option<Written>,
}

/// One element of a field.
#[derive(Clone, Debug)]
pub(crate) enum Element {
    Primitive(Primitive),
    /// A string, and the most bytes that it may have.
    Text(Option<usize>),
    /// A string of UTF-16, and the most units that it may have.
    Wide(Option<usize>),
    Message(Arc<Structure>),
}

impl Message {
    /// Its full name, such as `geometry_msgs/msg/Twist`.
    pub fn name(&self) -> &str {
        &self.structure.name
    }

    /// Its fields as people would write them, such as `{linear: {x: 0.0, y: 0.0, z: 0.0}, …}`; the names alone if that
    /// would be long.
    pub fn shape(&self) -> String {
        /// Longest shape that is spelt out, in bytes.
        const SHAPE_BYTES_MAX: usize = 160;
        let mut text = String::new();
        if flow(&self.structure, &mut text, SHAPE_BYTES_MAX).is_some() {
            return text;
        }
        let names: Vec<_> = self.structure.fields.iter().map(|field| format!("{}: …", field.name)).collect();
        format!("{{{}}}", names.join(", "))
    }
}

impl Structure {
    /// The types within it, by name.
    pub(crate) fn collect<'a>(&'a self, inner: &mut BTreeMap<&'a str, &'a Structure>) {
        for field in &self.fields {
            if let Element::Message(message) = &field.element
                && inner.insert(&message.name, message).is_none()
            {
                message.collect(inner);
            }
        }
    }
}

impl Element {
    /// Its name in definitions.
    pub(crate) fn name(&self) -> &str {
        match self {
            Self::Primitive(primitive) => primitive.name(),
            Self::Text(_) => "string",
            Self::Wide(_) => "wstring",
            Self::Message(structure) => &structure.name,
        }
    }

    /// The fewest bytes that one takes, without what aligns it: no message takes none.
    pub(crate) fn bytes_min(&self) -> usize {
        match self {
            Self::Primitive(primitive) => primitive.bytes(),
            Self::Text(_) | Self::Wide(_) => 4,
            Self::Message(_) => 1,
        }
    }
}

/// Writes a message with its zeros in flow style; none if it becomes longer than `limit`.
fn flow(structure: &Structure, text: &mut String, limit: usize) -> Option<()> {
    text.push('{');
    for (index, field) in structure.fields.iter().enumerate() {
        if index > 0 {
            text.push_str(", ");
        }
        text.push_str(&field.name);
        text.push_str(": ");
        match (&field.element, field.count) {
            (_, Count::Sequence(_)) => text.push_str("[]"),
            (_, Count::Array(_)) => text.push_str("[…]"),
            (Element::Message(inner), Count::One) => flow(inner, text, limit)?,
            (Element::Text(_) | Element::Wide(_), Count::One) => text.push_str("''"),
            (Element::Primitive(primitive), Count::One) => text.push_str(match primitive {
                Primitive::Bool => "false",
                Primitive::F32 | Primitive::F64 => "0.0",
                _ => "0",
            }),
        }
        if text.len() > limit {
            return None;
        }
    }
    text.push('}');
    Some(())
}
