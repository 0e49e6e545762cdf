//! Definitions by the names of their types.

use crate::definition::{self, FieldText, Kind};
use crate::fault::{Fault, quoted};
use crate::message::{Element, Field, Message, Structure};
use crate::name;
use std::collections::BTreeMap;
use std::sync::Arc;

/// The definitions of the common types, one below the other.
const BUILTIN: &str = include_str!("builtin.msgs");
/// Begins the definition of the next type in a text of several, as `.msg` texts of recordings have it.
const NEXT: &str = "MSG: ";
/// How deep messages may lie within each other.
const DEPTH_MAX: usize = 32;
/// Most definitions of a library.
const DEFINITIONS_MAX: usize = 4096;

/// Definitions, from which messages are made.
#[derive(Debug, Default)]
pub struct Library {
    definitions: BTreeMap<String, Vec<FieldText>>,
    made: BTreeMap<String, Arc<Structure>>,
}

impl Library {
    /// With the common types of `std_msgs`, `geometry_msgs`, `sensor_msgs`, `nav_msgs` and others.
    pub fn builtin() -> Self {
        let mut library = Self::default();
        // That every one of them is understood is a test's business.
        let _understood = library.add_all(BUILTIN);
        library
    }

    /// Adds a definition, or replaces the one of this name. Types of the same text behind lines `MSG: package/Name`, as
    /// recordings have them, are added too.
    ///
    /// # Errors
    /// If the name is none, or a line is not understood.
    pub fn add(&mut self, type_name: &str, text: &str) -> Result<(), Fault> {
        let own_ends = next_definition(text).unwrap_or(text.len());
        let (own, others) = text.split_at(own_ends);
        self.insert(name::full(type_name, None)?, own)?;
        self.add_all(others)
    }

    /// The name that a path such as `…/geometry_msgs/msg/Twist.msg` stands for.
    ///
    /// # Errors
    /// If the path does not end like that.
    pub fn name_of_path(path: &str) -> Result<String, Fault> {
        let parts: Vec<&str> = path.trim_end_matches('/').split('/').collect();
        match parts.as_slice() {
            [.., package, "msg", file] if file.ends_with(".msg") => {
                name::full(&format!("{package}/msg/{}", file.trim_end_matches(".msg")), None)
            }
            _ => Err(Fault::new("the path does not say which type is defined there")
                .found(quoted(path))
                .wanted("a path that ends with package/msg/Name.msg")
                .next("say the name: package/msg/Name=FILE")),
        }
    }

    /// The type of this name, with everything that it contains.
    ///
    /// # Errors
    /// If it, or a type within it, is not defined, contains itself, or is nested too deep.
    pub fn message(&mut self, type_name: &str) -> Result<Message, Fault> {
        let full = name::full(type_name, None)?;
        Ok(Message { structure: self.structure(&full, 1)? })
    }

    fn add_all(&mut self, mut text: &str) -> Result<(), Fault> {
        while let Some(at) = next_definition(text) {
            let after = text.get(at..).unwrap_or_default();
            let (heading, rest) = after.split_once('\n').unwrap_or((after, ""));
            let end = next_definition(rest).unwrap_or(rest.len());
            let (own, others) = rest.split_at(end);
            self.insert(name::full(heading.trim_start_matches(NEXT).trim(), None)?, own)?;
            text = others;
        }
        Ok(())
    }

    fn insert(&mut self, full: String, text: &str) -> Result<(), Fault> {
        if self.definitions.len() >= DEFINITIONS_MAX {
            return Err(Fault::new("there are too many definitions").wanted(format!("at most {DEFINITIONS_MAX}")));
        }
        let fields = definition::parse(&full, text)?;
        self.definitions.insert(full, fields);
        // Whatever contained the old one is made anew.
        self.made.clear();
        Ok(())
    }

    fn structure(&mut self, full: &str, depth: usize) -> Result<Arc<Structure>, Fault> {
        if depth > DEPTH_MAX {
            return Err(Fault::new(format!("{full} contains itself, or lies too deep within others"))
                .wanted(format!("at most {DEPTH_MAX} messages within each other")));
        }
        if let Some(made) = self.made.get(full).filter(|made| made.depth + depth <= DEPTH_MAX + 1) {
            return Ok(Arc::clone(made));
        }
        let Some(texts) = self.definitions.get(full).cloned() else {
            return Err(self.undefined(full));
        };
        let mut fields = Vec::with_capacity(texts.len());
        let mut inner_depth = 0;
        for FieldText { name, kind, count, default } in texts {
            let element = match kind {
                Kind::Primitive(primitive) => Element::Primitive(primitive),
                Kind::Text(most) => Element::Text(most),
                Kind::Message(inner) => {
                    let inner = self.structure(&inner, depth + 1)?;
                    inner_depth = inner_depth.max(inner.depth);
                    Element::Message(inner)
                }
            };
            fields.push(Field { name: name.into(), element, count, default });
        }
        let structure = Arc::new(Structure { name: full.to_owned(), fields, depth: inner_depth + 1 });
        self.made.insert(full.to_owned(), Arc::clone(&structure));
        Ok(structure)
    }

    fn undefined(&self, full: &str) -> Fault {
        let known = self.definitions.keys().map(String::as_str);
        Fault::new(format!("the definition of {full} is not known"))
            .found(format!("no definition of {full}"))
            .wanted("one of the common types, or its .msg file")
            .next(ledger_base::nearest::did_you_mean(full, known, ""))
    }
}

/// Where the next line `MSG: …` begins.
fn next_definition(text: &str) -> Option<usize> {
    if text.starts_with(NEXT) { Some(0) } else { text.find(&format!("\n{NEXT}")).map(|at| at + 1) }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn every_built_in_definition_is_understood_and_whole() {
        let mut library = Library::default();
        library.add_all(BUILTIN).unwrap();
        let names: Vec<_> = library.definitions.keys().cloned().collect();
        assert_eq!(names.len(), BUILTIN.matches("MSG: ").count(), "none stands twice");
        for name in names {
            library.message(&name).unwrap();
        }
        for name in ["Twist", "TwistStamped", "Pose", "PoseStamped"] {
            library.message(&format!("geometry_msgs/msg/{name}")).unwrap();
        }
        for name in ["std_msgs/msg/String", "sensor_msgs/msg/Joy", "nav_msgs/msg/Odometry", "std_msgs/Empty"] {
            library.message(name).unwrap();
        }
    }

    #[test]
    fn a_definition_that_is_missing_is_named_and_a_near_one_suggested() {
        let mut library = Library::builtin();
        let fault = library.message("geometry_msgs/msg/Twits").unwrap_err();
        assert!(fault.next.contains("geometry_msgs/msg/Twist"), "{fault:?}");
        library.add("my_msgs/msg/Arm", "my_msgs/Hand left\n").unwrap();
        assert!(library.message("my_msgs/msg/Arm").unwrap_err().message.contains("my_msgs/msg/Hand"));
        library.add("my_msgs/msg/Hand", "float32 grip\n").unwrap();
        assert_eq!(library.message("my_msgs/msg/Arm").unwrap().shape(), "{left: {grip: 0.0}}");
    }

    #[test]
    fn a_message_within_itself_is_refused() {
        let mut library = Library::builtin();
        library.add("my_msgs/msg/A", "B b\n").unwrap();
        library.add("my_msgs/msg/B", "A[] a\n").unwrap();
        assert!(library.message("my_msgs/msg/A").unwrap_err().message.contains("contains itself"));
    }

    #[test]
    fn nesting_is_bounded_whichever_message_is_made_first() {
        let mut library = Library::default();
        for depth in 0..40 {
            let text = if depth == 0 { "int32 x\n".to_owned() } else { format!("M{} m\n", depth - 1) };
            library.add(&format!("deep_msgs/msg/M{depth}"), &text).unwrap();
        }
        assert!(library.message("deep_msgs/msg/M31").is_ok(), "32 within each other");
        assert!(library.message("deep_msgs/msg/M32").is_err());
        for depth in 0..40 {
            assert_eq!(library.message(&format!("deep_msgs/msg/M{depth}")).is_ok(), depth < 32, "{depth}");
        }
    }

    #[test]
    fn several_definitions_of_one_text_are_added() {
        let mut library = Library::default();
        let line = "=".repeat(80);
        let text =
            format!("a_msgs/Inner inner\n{line}\nMSG: a_msgs/Inner\nint32 x\n{line}\nMSG: a_msgs/msg/Other\nbool y\n");
        library.add("a_msgs/msg/Outer", &text).unwrap();
        assert_eq!(library.message("a_msgs/msg/Outer").unwrap().shape(), "{inner: {x: 0}}");
        assert!(library.message("a_msgs/msg/Other").is_ok());
    }

    #[test]
    fn a_path_names_its_type() {
        assert_eq!(Library::name_of_path("/opt/ros/share/my_msgs/msg/Arm.msg").unwrap(), "my_msgs/msg/Arm");
        assert_eq!(Library::name_of_path("my_msgs/msg/Arm.msg").unwrap(), "my_msgs/msg/Arm");
        for path in ["Arm.msg", "msg/Arm.msg", "my_msgs/srv/Arm.msg", "my_msgs/msg/Arm.txt", ""] {
            assert!(Library::name_of_path(path).is_err(), "{path}");
        }
        assert_eq!(
            Library::builtin().message("geometry_msgs/msg/Twist").unwrap().shape().get(..9).unwrap(),
            "{linear: "
        );
    }
}
