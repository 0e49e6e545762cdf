//! The hash of a type, by which ROS 2 nodes see that both have the same definition (REP 2016, version `RIHS01`).
//!
//! It is SHA-256 over the definition and those of all types within it, written as JSON in one prescribed way. Names of
//! constants, defaults and comments do not count.

use crate::definition::{Count, Primitive};
use crate::message::{Element, Field, Message, Structure};
use ring::digest::{SHA256, digest};
use std::collections::BTreeMap;
use std::fmt::Write;

/// Of `type_description_interfaces/msg/FieldType`: added to the number of an element's type.
const ARRAY: u8 = 48;
const BOUNDED_SEQUENCE: u8 = 96;
const UNBOUNDED_SEQUENCE: u8 = 144;

impl Message {
    /// The hash of the type as ROS 2 writes it, `RIHS01_` and 64 hexadecimal digits.
    pub fn type_hash(&self) -> String {
        let mut inner = BTreeMap::new();
        self.structure.collect(&mut inner);
        let referenced: Vec<_> = inner.values().map(|structure| description(structure)).collect();
        let text = format!(
            "{{\"type_description\": {}, \"referenced_type_descriptions\": [{}]}}",
            description(&self.structure),
            referenced.join(", ")
        );
        let mut hash = "RIHS01_".to_owned();
        for byte in digest(&SHA256, text.as_bytes()).as_ref() {
            // Writing to a string does not fail.
            let _written = write!(hash, "{byte:02x}");
        }
        hash
    }
}

fn description(structure: &Structure) -> String {
    let mut fields: Vec<_> = structure.fields.iter().map(field).collect();
    if fields.is_empty() {
        // IDL knows no empty structure.
        fields.push(written("structure_needs_at_least_one_member", number(Primitive::U8), 0, 0, ""));
    }
    format!("{{\"type_name\": \"{}\", \"fields\": [{}]}}", structure.name, fields.join(", "))
}

fn field(field: &Field) -> String {
    let (element, string_capacity, nested) = match &field.element {
        Element::Primitive(primitive) => (number(*primitive), 0, ""),
        Element::Text(None) => (17, 0, ""),
        Element::Text(Some(most)) => (21, *most, ""),
        Element::Wide(None) => (18, 0, ""),
        Element::Wide(Some(most)) => (22, *most, ""),
        Element::Message(message) => (1, 0, message.name.as_str()),
    };
    let (kind, capacity) = match field.count {
        Count::One => (element, 0),
        Count::Array(length) => (element + ARRAY, length),
        Count::Sequence(Some(most)) => (element + BOUNDED_SEQUENCE, most),
        Count::Sequence(None) => (element + UNBOUNDED_SEQUENCE, 0),
    };
    written(&field.name, kind, capacity, string_capacity, nested)
}

fn written(name: &str, kind: u8, capacity: usize, string_capacity: usize, nested: &str) -> String {
    format!(
        "{{\"name\": \"{name}\", \"type\": {{\"type_id\": {kind}, \"capacity\": {capacity}, \
         \"string_capacity\": {string_capacity}, \"nested_type_name\": \"{nested}\"}}}}"
    )
}

/// The number of a type without a definition.
fn number(primitive: Primitive) -> u8 {
    match primitive {
        Primitive::I8 => 2,
        Primitive::U8 => 3,
        Primitive::I16 => 4,
        Primitive::U16 => 5,
        Primitive::I32 => 6,
        Primitive::U32 => 7,
        Primitive::I64 => 8,
        Primitive::U64 => 9,
        Primitive::F32 => 10,
        Primitive::F64 => 11,
        Primitive::Bool => 15,
        Primitive::Byte => 16,
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use crate::Library;

    #[test]
    fn every_built_in_type_has_the_hash_of_ros_jazzy() {
        let mut library = Library::builtin();
        let known = include_str!("hash/jazzy.txt").lines().filter(|line| !line.starts_with('#'));
        let known: Vec<_> = known.map(|line| line.split_once(' ').unwrap()).collect();
        assert!(known.len() > 90, "{}", known.len());
        for (name, hash) in known {
            assert_eq!(library.message(name).unwrap().type_hash(), hash, "{name}");
        }
    }

    #[test]
    fn bounds_count_and_defaults_do_not() {
        let hash = |text: &str| {
            let mut library = Library::builtin();
            library.add("a_msgs/msg/A", text).unwrap();
            library.message("a_msgs/msg/A").unwrap().type_hash()
        };
        assert_eq!(hash("int32 x"), hash("# a comment\nint32 MOST=3\nint32 x 7\n"));
        for other in ["int32[] x", "int32[<=4] x", "int32[4] x", "int32 y", "uint32 x"] {
            assert_ne!(hash("int32 x"), hash(other), "{other}");
        }
        assert_ne!(hash("string x"), hash("string<=4 x"));
    }
}
