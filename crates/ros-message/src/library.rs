//! Definitions by the names of their types.

use crate::definition::{FieldText, Kind};
use crate::fault::{Fault, quoted};
use crate::interface;
use crate::message::{Element, Field, Message, Structure};
use crate::name;
use std::collections::BTreeMap;
use std::sync::Arc;

/// The definitions of the common types, one below the other.
const BUILTIN: &str = include_str!("builtin.msgs");
/// Begins the definition of the next type in a text of several, as `.msg` texts of recordings have it.
const NEXT: &str = "MSG: ";
/// Shortest line of `=` in front of it.
const RULE_BYTES_MIN: usize = 4;
/// How deep messages may lie within each other.
const DEPTH_MAX: usize = 32;
/// Most definitions of a library.
const DEFINITIONS_MAX: usize = 4096;

/// Definitions, from which messages are made.
#[derive(Debug, Default)]
pub struct Library {
    /// Those that were not understood, too, with the reason.
    definitions: BTreeMap<String, Result<Vec<FieldText>, Fault>>,
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

    /// Adds the definition of a message, a service or an action, or replaces the one of this name. Messages of the same text are added too:
    /// they follow lines of `=` and `MSG: package/Name`, as recordings have them.
    ///
    /// # Errors
    /// If the name is none, or a line is not understood. The library works on for all other types. Asked for a type whose definition is
    /// faulty, it repeats the fault.
    pub fn add(&mut self, type_name: &str, text: &str) -> Result<(), Fault> {
        let full = name::full(type_name)?;
        let (own, others) = split(text);
        let added = self.insert(full, own);
        others.into_iter().map(|(name, own)| self.insert(name::full(name)?, own)).fold(added, Result::and)
    }

    /// The full name of a type that can be defined.
    ///
    /// # Errors
    /// If there can be no definition of that name.
    pub fn full_name(type_name: &str) -> Result<String, Fault> {
        let full = name::full(type_name)?;
        name::definable(&full)?;
        Ok(full)
    }

    /// The name that a path such as `…/geometry_msgs/msg/Twist.msg` stands for.
    ///
    /// # Errors
    /// If the path does not end like that.
    pub fn name_of_path(path: &str) -> Result<String, Fault> {
        let parts: Vec<&str> = path.trim_end_matches('/').split('/').collect();
        if let [.., package, kind @ ("msg" | "srv" | "action"), file] = parts.as_slice()
            && let Some((name, ending)) = file.rsplit_once('.')
        {
            if ending == *kind {
                return name::full(&format!("{package}/{kind}/{name}"));
            }
            if ending == "idl" {
                return Err(Fault::new(format!("{package}/{kind}/{name} is defined in IDL, which is not read"))
                    .found(quoted(path))
                    .wanted(format!("{package}/{kind}/{name}.{kind}"))
                    .next("types that exist in IDL only, such as long double and wchar, have no other definition"));
            }
        }
        Err(Fault::new("the path does not name the type that is defined there")
            .found(quoted(path))
            .wanted("a path that ends with package/msg/Name.msg")
            .next("give the name: package/msg/Name=FILE"))
    }

    /// The type of this name, with everything that it contains.
    ///
    /// # Errors
    /// If it, or a type within it, is not defined, has a faulty definition, contains itself, or is nested too deep.
    pub fn message(&mut self, type_name: &str) -> Result<Message, Fault> {
        let full = name::full(type_name)?;
        Ok(Message { structure: self.structure(&full, 1)? })
    }

    fn add_all(&mut self, mut text: &str) -> Result<(), Fault> {
        while let Some(at) = next_heading(text) {
            let after = text.get(at..).unwrap_or_default();
            let (heading, rest) = after.split_once('\n').unwrap_or((after, ""));
            let end = next_heading(rest).unwrap_or(rest.len());
            let (own, others) = rest.split_at(end);
            self.insert(name::full(heading.trim_start_matches(NEXT).trim())?, own)?;
            text = others;
        }
        Ok(())
    }

    fn insert(&mut self, full: String, text: &str) -> Result<(), Fault> {
        if self.definitions.len() >= DEFINITIONS_MAX {
            return Err(Fault::new("there are too many definitions").wanted(format!("at most {DEFINITIONS_MAX}")));
        }
        // Types that contained the old one are made again.
        self.made.clear();
        match interface::parse(&full, text) {
            Ok(parts) => self.definitions.extend(parts.into_iter().map(|(name, fields)| (name, Ok(fields)))),
            Err(fault) => {
                self.definitions.insert(full, Err(fault.clone()));
                return Err(fault);
            }
        }
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
        let texts = self.definitions.get(full).cloned().unwrap_or_else(|| Err(self.undefined(full)))?;
        let mut fields = Vec::with_capacity(texts.len());
        let mut inner_depth = 0;
        for FieldText { name, kind, count, default } in texts {
            let element = match kind {
                Kind::Primitive(primitive) => Element::Primitive(primitive),
                Kind::Text(most) => Element::Text(most),
                Kind::Wide(most) => Element::Wide(most),
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
            .wanted("one of the common types, or a type with a .msg file: types that exist in IDL only are not read")
            .next(ledger_base::nearest::did_you_mean(full, known, ""))
    }
}

/// Where the next line `MSG: …` begins.
fn next_heading(text: &str) -> Option<usize> {
    if text.starts_with(NEXT) { Some(0) } else { text.find(&format!("\n{NEXT}")).map(|at| at + 1) }
}

/// The first definition of a text, and the others behind lines of `=` with the names of their types.
fn split(text: &str) -> (&str, Vec<(&str, &str)>) {
    let is_rule = |line: &str| line.len() >= RULE_BYTES_MIN && line.bytes().all(|b| b == b'=');
    let mut own = text;
    let mut others: Vec<(&str, &str)> = Vec::new();
    let (mut begin, mut end, mut at) = (0, 0, 0);
    let mut is_behind_rule = false;
    for line in text.split_inclusive('\n') {
        let bare = line.trim_end();
        if let Some(name) = bare.strip_prefix(NEXT).filter(|_| is_behind_rule) {
            finish(text.get(begin..end).unwrap_or_default(), &mut own, &mut others);
            others.push((name.trim(), ""));
            begin = at + line.len();
        }
        is_behind_rule = is_rule(bare);
        at += line.len();
        // A rule belongs to what follows it, if that is a heading.
        end = if is_behind_rule { at - line.len() } else { at };
    }
    finish(text.get(begin..).unwrap_or_default(), &mut own, &mut others);
    (own, others)
}

/// Puts the text of the definition that ends here in its place.
fn finish<'a>(definition: &'a str, own: &mut &'a str, others: &mut [(&'a str, &'a str)]) {
    match others.last_mut() {
        Some((_, text)) => *text = definition,
        None => *own = definition,
    }
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
    fn a_faulty_definition_is_named_when_it_is_needed_and_harms_no_other_type() {
        let mut library = Library::builtin();
        let fault = library.add("my_msgs/msg/Bad", "int32 x\nint32 X\n").unwrap_err();
        assert!(fault.message.contains("line 2 of the definition of my_msgs/msg/Bad"), "{fault:?}");
        library.add("my_msgs/msg/Good", "int32 x\n").unwrap();
        library.add("my_msgs/msg/Around", "Good good\nBad bad\n").unwrap();
        assert!(library.message("my_msgs/msg/Good").is_ok() && library.message("std_msgs/msg/String").is_ok());
        for name in ["my_msgs/msg/Bad", "my_msgs/msg/Around"] {
            assert_eq!(library.message(name).unwrap_err(), fault, "{name}");
        }
        assert!(library.add("std_msgs/msg/String", "text data").is_err());
        assert!(library.message("std_msgs/msg/String").is_err(), "the built-in one is not used instead");
        library.add("my_msgs/msg/Bad", "int32 y\n").unwrap();
        assert_eq!(library.message("my_msgs/msg/Around").unwrap().shape(), "{good: {x: 0}, bad: {y: 0}}");
    }

    #[test]
    fn a_faulty_definition_among_several_of_one_text_is_named() {
        let line = "=".repeat(80);
        let mut library = Library::default();
        let text = format!("Bad bad\n{line}\nMSG: a_msgs/Bad\nint32\n{line}\nMSG: a_msgs/Good\nbool y\n");
        assert!(library.add("a_msgs/msg/Outer", &text).unwrap_err().message.contains("a_msgs/msg/Bad"));
        assert!(library.message("a_msgs/msg/Good").is_ok());
        assert!(
            library
                .message("a_msgs/msg/Outer")
                .unwrap_err()
                .message
                .contains("line 1 of the definition of a_msgs/msg/Bad")
        );
    }

    #[test]
    fn a_rule_or_a_heading_alone_is_no_line_of_a_definition() {
        let mut library = Library::default();
        for text in ["int32 x\n====\nint32 y\n", "int32 x\nMSG: a_msgs/B\nint32 y\n", "int32 x\n====\n"] {
            assert!(library.add("a_msgs/msg/A", text).is_err(), "{text}");
        }
    }

    #[test]
    fn a_service_and_an_action_are_several_messages() {
        let mut library = Library::builtin();
        library.add("a_msgs/srv/Open", "bool wide\n---\nstring why\n").unwrap();
        assert_eq!(library.message("a_msgs/srv/Open_Request").unwrap().shape(), "{wide: false}");
        assert_eq!(library.message("a_msgs/srv/Open_Response").unwrap().shape(), "{why: ''}");
        library.add("a_msgs/action/Go", "int32 far\n---\n---\nint32 left\n").unwrap();
        assert_eq!(library.message("a_msgs/action/Go_Feedback").unwrap().shape(), "{left: 0}");
        for (name, text) in [
            ("a_msgs/srv/Bad", "bool wide\n"),
            ("a_msgs/srv/Bad", "---\n---\n"),
            ("a_msgs/srv/Bad", "bool wide\n --- \nbool x\n"),
            ("a_msgs/action/Bad", "---\n"),
        ] {
            assert!(library.add(name, text).is_err(), "{name} {text:?}");
            assert!(library.message(name).is_err());
        }
    }

    #[test]
    fn a_path_names_its_type() {
        assert_eq!(Library::name_of_path("/opt/ros/share/my_msgs/msg/Arm.msg").unwrap(), "my_msgs/msg/Arm");
        assert_eq!(Library::name_of_path("my_msgs/msg/Arm.msg").unwrap(), "my_msgs/msg/Arm");
        assert_eq!(Library::name_of_path("my_msgs/srv/Arm.srv").unwrap(), "my_msgs/srv/Arm");
        assert_eq!(Library::name_of_path("my_msgs/action/Arm.action").unwrap(), "my_msgs/action/Arm");
        let idl = Library::name_of_path("share/my_msgs/msg/Exact.idl").unwrap_err();
        assert!(idl.message.contains("my_msgs/msg/Exact is defined in IDL"), "{idl:?}");
        for path in ["Arm.msg", "msg/Arm.msg", "my_msgs/srv/Arm.msg", "my_msgs/msg/Arm.txt", ""] {
            assert!(Library::name_of_path(path).is_err(), "{path}");
        }
        assert_eq!(
            Library::builtin().message("geometry_msgs/msg/Twist").unwrap().shape().get(..9).unwrap(),
            "{linear: "
        );
    }
}
