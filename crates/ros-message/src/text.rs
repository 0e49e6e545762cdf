//! A definition as text again, with everything that it contains: the form in which recordings carry it.

use crate::definition::Count;
use crate::message::{Element, Field, Message, Structure};
use std::collections::BTreeMap;
use std::fmt::Write;

/// Stands between the definitions of a text of several.
const LINE_BYTES: usize = 80;

impl Message {
    /// The fields of the type as a `.msg` file has them, and behind a line of `=` and `MSG: package/Name` those of each type within
    /// it. Readers of recordings call that `ros2msg`. Constants, defaults and comments are no part of the bytes, and are left out.
    pub fn definition(&self) -> String {
        let mut inner = BTreeMap::new();
        self.structure.collect(&mut inner);
        let mut text = fields(&self.structure);
        for structure in inner.values() {
            let name = structure.name.replace("/msg/", "/");
            // Writing to a string does not fail.
            let _written = write!(text, "{}\nMSG: {name}\n{}", "=".repeat(LINE_BYTES), fields(structure));
        }
        text
    }
}

fn fields(structure: &Structure) -> String {
    structure.fields.iter().map(|field| format!("{} {}\n", kind(field), field.name)).collect()
}

fn kind(field: &Field) -> String {
    let element = match &field.element {
        Element::Primitive(primitive) => primitive.name().to_owned(),
        Element::Text(None) => "string".to_owned(),
        Element::Text(Some(most)) => format!("string<={most}"),
        Element::Wide(None) => "wstring".to_owned(),
        Element::Wide(Some(most)) => format!("wstring<={most}"),
        Element::Message(structure) => structure.name.replace("/msg/", "/"),
    };
    match field.count {
        Count::One => element,
        Count::Array(count) => format!("{element}[{count}]"),
        Count::Sequence(None) => format!("{element}[]"),
        Count::Sequence(Some(most)) => format!("{element}[<={most}]"),
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use crate::Library;

    #[test]
    fn a_definition_that_was_written_is_read_as_the_same_type() {
        let known = include_str!("hash/jazzy.txt").lines().filter(|line| !line.starts_with('#'));
        for (name, hash) in known.map(|line| line.split_once(' ').unwrap()) {
            let text = Library::builtin().message(name).unwrap().definition();
            // Into an empty library: the text needs no other.
            let mut library = Library::default();
            library.add(name, &text).unwrap();
            assert_eq!(library.message(name).unwrap().type_hash(), hash, "{name}:\n{text}");
        }
    }

    #[test]
    fn bounds_and_types_of_other_packages_are_written() {
        let mut library = Library::builtin();
        let text = "geometry_msgs/Point[<=4] points\nstring<=10[2] names\nwstring<=4 wide\nwstring[] more\nfloat32[] raw\nbyte one\n";
        library.add("my_msgs/msg/Arm", text).unwrap();
        let written = library.message("my_msgs/msg/Arm").unwrap().definition();
        let line = "=".repeat(80);
        assert_eq!(written, format!("{text}{line}\nMSG: geometry_msgs/Point\nfloat64 x\nfloat64 y\nfloat64 z\n"));
    }
}
