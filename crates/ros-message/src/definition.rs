//! The text format of `.msg` files.
//!
//! ```text
//! # a comment
//! uint8 LEVEL_MAX=3                 a constant
//! string<=16 NAME="left arm"        a constant of a bounded string
//! std_msgs/Header header            a field of a type of another package
//! Vector3 linear                    a field of a type of this package
//! float64 w 1                       a field with a default
//! float64[36] covariance            an array
//! float32[<=4] axes                 a sequence of at most 4
//! string<=10[] names [a, b]         a sequence of bounded strings, with a default
//! ```

use crate::fault::{Fault, quoted};
use crate::name;
use crate::written::Written;

/// Longest text of a definition that is read, in bytes.
const TEXT_BYTES_MAX: usize = 1024 * 1024;
/// Most fields of a message.
const FIELDS_MAX: usize = 1024;

/// A type that no definition explains.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Primitive {
    Bool,
    /// `uint8`, and the same under another name: `char`.
    U8,
    /// `byte`: a `uint8` with a number of its own in the hash of a type.
    Byte,
    I8,
    U16,
    I16,
    U32,
    I32,
    U64,
    I64,
    F32,
    F64,
}

impl Primitive {
    /// Bytes of one, which is its alignment as well.
    pub(crate) fn bytes(self) -> usize {
        match self {
            Self::Bool | Self::U8 | Self::Byte | Self::I8 => 1,
            Self::U16 | Self::I16 => 2,
            Self::U32 | Self::I32 | Self::F32 => 4,
            Self::U64 | Self::I64 | Self::F64 => 8,
        }
    }

    /// Its name in definitions.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Bool => "bool",
            Self::U8 => "uint8",
            Self::Byte => "byte",
            Self::I8 => "int8",
            Self::U16 => "uint16",
            Self::I16 => "int16",
            Self::U32 => "uint32",
            Self::I32 => "int32",
            Self::U64 => "uint64",
            Self::I64 => "int64",
            Self::F32 => "float32",
            Self::F64 => "float64",
        }
    }

    fn parse(text: &str) -> Option<Self> {
        Some(match text {
            "bool" => Self::Bool,
            "uint8" | "char" => Self::U8,
            "byte" => Self::Byte,
            "int8" => Self::I8,
            "uint16" => Self::U16,
            "int16" => Self::I16,
            "uint32" => Self::U32,
            "int32" => Self::I32,
            "uint64" => Self::U64,
            "int64" => Self::I64,
            "float32" => Self::F32,
            "float64" => Self::F64,
            _ => return None,
        })
    }
}

/// The type of one element, as it is written.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    Primitive(Primitive),
    /// A string, and the most bytes that it may have.
    Text(Option<usize>),
    /// Another message, by its full name.
    Message(String),
}

/// How many elements a field has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Count {
    One,
    /// Exactly so many.
    Array(usize),
    /// Any number, or at most so many.
    Sequence(Option<usize>),
}

/// A field, as it is written.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct FieldText {
    pub(crate) name: String,
    pub(crate) kind: Kind,
    pub(crate) count: Count,
    pub(crate) default: Option<Written>,
}

/// The fields of a `.msg` file in their order. Constants are no part of the bytes, and so are read over.
///
/// # Errors
/// Names the first line that is not understood.
pub(crate) fn parse(full_name: &str, text: &str) -> Result<Vec<FieldText>, Fault> {
    if text.len() > TEXT_BYTES_MAX {
        return Err(Fault::new(format!("the definition of {full_name} is too long"))
            .found(format!("{} bytes", text.len()))
            .wanted(format!("at most {TEXT_BYTES_MAX}")));
    }
    let mut fields: Vec<FieldText> = Vec::new();
    for (number, line) in text.lines().enumerate() {
        let fault = |what: &str| {
            Fault::new(format!("line {} of the definition of {full_name} is not understood: {what}", number + 1))
                .found(quoted(line.trim()))
                .wanted("TYPE NAME, TYPE NAME DEFAULT, TYPE NAME=CONSTANT, or a comment behind #")
        };
        let Some((kind, rest)) = words(line) else { continue };
        let (kind, count) = element(kind, name::package(full_name)).map_err(|what| fault(&what))?;
        let name_ends = rest.find(|c: char| c.is_whitespace() || c == '=' || c == '#').unwrap_or(rest.len());
        let (name, rest) = rest.split_at(name_ends);
        if !name::is_name(name) && !name.starts_with('_') {
            return Err(fault("the name of the field is missing or wrong"));
        }
        let rest = rest.trim_start();
        if rest.starts_with('=') {
            continue;
        }
        if fields.len() >= FIELDS_MAX {
            return Err(fault(&format!("a message has at most {FIELDS_MAX} fields")));
        }
        if fields.iter().any(|field| field.name == name) {
            return Err(fault(&format!("there is a field {name} already")));
        }
        let default = if rest.is_empty() || rest.starts_with('#') {
            None
        } else {
            Some(Written::parse(rest).map_err(|wrong| fault(&format!("the default: {}", wrong.message)))?)
        };
        fields.push(FieldText { name: name.to_owned(), kind, count, default });
    }
    Ok(fields)
}

/// The type and everything behind it; none for an empty line or a comment.
fn words(line: &str) -> Option<(&str, &str)> {
    let line = line.trim();
    // A line of `=` stands between the definitions of a text of several.
    if line.is_empty() || line.starts_with('#') || line.starts_with("====") {
        return None;
    }
    let end = line.find(char::is_whitespace).unwrap_or(line.len());
    let (kind, rest) = line.split_at(end);
    Some((kind, rest.trim_start()))
}

/// The type of a field: `float64`, `string<=10`, `Vector3[]`, `geometry_msgs/Point[<=4]`.
fn element(text: &str, package: &str) -> Result<(Kind, Count), String> {
    let (kind, count) = match text.split_once('[') {
        None => (text, Count::One),
        Some((kind, bound)) => {
            let bound = bound.strip_suffix(']').ok_or("an array ends with ]")?;
            let number = |digits: &str| digits.parse::<u32>().map_err(|_| format!("[{bound}] is no length"));
            let count = match bound.strip_prefix("<=") {
                Some(most) => Count::Sequence(Some(number(most)? as usize)),
                None if bound.is_empty() => Count::Sequence(None),
                None => Count::Array(number(bound)? as usize),
            };
            (kind, count)
        }
    };
    let kind = match kind.split_once("<=") {
        Some(("string", most)) => {
            Kind::Text(Some(most.parse::<u32>().map_err(|_| format!("<={most} is no length"))? as usize))
        }
        Some(_) => return Err("only strings and sequences are bounded by <=".to_owned()),
        None if kind == "string" => Kind::Text(None),
        None if kind == "wstring" => {
            return Err("wstring is not supported: every middleware writes it in another way".to_owned());
        }
        None => match Primitive::parse(kind) {
            Some(primitive) => Kind::Primitive(primitive),
            None => Kind::Message(name::full(kind, Some(package)).map_err(|wrong| wrong.message)?),
        },
    };
    Ok((kind, count))
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    fn fields(text: &str) -> Vec<FieldText> {
        parse("test_msgs/msg/Test", text).unwrap()
    }

    #[test]
    fn fields_are_read_in_their_order_and_constants_left_out() {
        let text = "# Two numbers\nuint8 MAX=3\nstring NAME= a # b\n\nfloat64   x   # metres\nVector3 v\r\nother_msgs/Point[<=4] points\n\
                    string<=10[] names\nint32[2] pair [1, 2]\nfloat64 w 1\n";
        let found: Vec<_> = fields(text).into_iter().map(|f| (f.name, f.kind, f.count, f.default.is_some())).collect();
        let message = |name: &str| Kind::Message(name.to_owned());
        let (float, int) = (Kind::Primitive(Primitive::F64), Kind::Primitive(Primitive::I32));
        assert_eq!(
            found,
            [
                ("x".to_owned(), float.clone(), Count::One, false),
                ("v".to_owned(), message("test_msgs/msg/Vector3"), Count::One, false),
                ("points".to_owned(), message("other_msgs/msg/Point"), Count::Sequence(Some(4)), false),
                ("names".to_owned(), Kind::Text(Some(10)), Count::Sequence(None), false),
                ("pair".to_owned(), int, Count::Array(2), true),
                ("w".to_owned(), float, Count::One, true),
            ]
        );
    }

    #[test]
    fn a_line_that_is_not_understood_is_named() {
        for (text, part) in [
            ("float64 x\nfloat64", "line 2"),
            ("float64 x\nfloat64 x", "there is a field x already"),
            ("wstring w", "wstring"),
            ("float64[ x", "ends with ]"),
            ("float64[-1] x", "no length"),
            ("float64[4294967296] x", "no length"),
            ("int32<=3 x", "only strings"),
            ("a/b/c/D x", "not the name of a message type"),
            ("int32 9x", "name of the field"),
            ("int32[] x [1", "the default"),
        ] {
            let fault = parse("test_msgs/msg/Test", text).unwrap_err();
            assert!(fault.message.contains(part), "{text:?}: {fault:?}");
        }
    }
}
