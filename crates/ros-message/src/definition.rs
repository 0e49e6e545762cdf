//! The text format of `.msg` files, as rosidl reads it.
//!
//! ```text
//! # a comment
//! uint8 LEVEL_MAX=3                 a constant
//! string NAME="left arm"            a constant of a string
//! std_msgs/Header header            a field of a type of another package
//! Vector3 linear                    a field of a type of this package
//! float64 w 1                       a field with a default
//! float64[36] covariance            an array
//! float32[<=4] axes                 a sequence of at most 4
//! string<=10[] names [a, "b c"]     a sequence of bounded strings, with a default
//! ```
//!
//! The only description of this format is `rosidl_adapter/parser.py`. A line begins with its type, without a space in front. A `#`
//! begins a comment also in quotes, and a `=` behind the type makes a constant of the line.

mod kinds;
mod lines;
mod numbers;
mod values;

pub(crate) use lines::lines;

use crate::fault::{Fault, quoted};
use crate::name;
use crate::written::Written;
use lines::{statement, trim_end, trim_start};

/// Longest text of a definition that is read, in bytes.
const TEXT_BYTES_MAX: usize = 1024 * 1024;
/// Longest line of one, in bytes.
const LINE_BYTES_MAX: usize = 64 * 1024;
/// Most fields of a message, and most constants.
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

    /// The least and the greatest value of a whole number.
    pub(crate) fn range(self) -> (i128, i128) {
        let bits = self.bytes() * 8;
        match self {
            Self::I8 | Self::I16 | Self::I32 | Self::I64 => (-(1 << (bits - 1)), (1 << (bits - 1)) - 1),
            _ => (0, (1 << bits) - 1),
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
    /// A string of UTF-16, and the most units that it may have.
    Wide(Option<usize>),
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

/// The fields of a `.msg` file in their order. Constants are no part of the bytes: they are checked and left out.
///
/// # Errors
/// Names the first line that is not understood.
pub(crate) fn parse(full_name: &str, text: &str) -> Result<Vec<FieldText>, Fault> {
    if text.len() > TEXT_BYTES_MAX {
        return Err(Fault::new(format!("the definition of {full_name} is too long"))
            .found(format!("{} bytes", text.len()))
            .wanted(format!("at most {TEXT_BYTES_MAX}")));
    }
    let text = text.replace('\t', " ");
    let mut fields: Vec<FieldText> = Vec::new();
    let mut constants: Vec<&str> = Vec::new();
    for (number, line) in lines(&text).into_iter().enumerate() {
        let fault = |what: String| {
            Fault::new(format!("line {} of the definition of {full_name} is not understood: {what}", number + 1))
                .found(quoted(trim_end(line)))
                .wanted("TYPE NAME, TYPE NAME DEFAULT, TYPE NAME=CONSTANT, or a comment behind #")
        };
        let Some(statement) = statement(line) else { continue };
        if statement.len() > LINE_BYTES_MAX {
            return Err(fault(format!("a line has at most {LINE_BYTES_MAX} bytes")));
        }
        let (kind, rest) = statement.split_once(' ').unwrap_or((statement, ""));
        if kind.is_empty() {
            return Err(fault("a line begins with its type, without a space in front".to_owned()));
        }
        let rest = trim_start(rest);
        let name = match rest.split_once('=') {
            Some((name, value)) => {
                let name = constant(kind, trim_end(name), trim_start(value)).map_err(fault)?;
                let is_new = !constants.contains(&name);
                constants.push(name);
                if is_new { None } else { Some(name) }
            }
            None => {
                let field = field(kind, rest, name::package(full_name)).map_err(fault)?;
                let is_new = !fields.iter().any(|known| known.name == field.name);
                fields.push(field);
                if is_new { None } else { rest.split(' ').next() }
            }
        };
        if let Some(name) = name {
            return Err(fault(format!("there is a field or a constant {name} already")));
        }
        if fields.len().max(constants.len()) > FIELDS_MAX {
            return Err(fault(format!("a message has at most {FIELDS_MAX} fields, and as many constants")));
        }
    }
    Ok(fields)
}

fn field(kind: &str, rest: &str, package: &str) -> Result<FieldText, String> {
    let (name, default) = rest.split_once(' ').unwrap_or((rest, ""));
    let (kind, count) = kinds::field(kind, package)?;
    if !name::is_field(name) {
        return Err(
            "the name of the field is missing or wrong: lower-case letters, digits, and single _ within".to_owned()
        );
    }
    let default = match trim_start(default) {
        "" => None,
        text => Some(values::field(&kind, count, text).map_err(|wrong| format!("the default: {wrong}"))?),
    };
    Ok(FieldText { name: name.to_owned(), kind, count, default })
}

/// The name of a constant whose value can be one.
fn constant<'a>(kind: &str, name: &'a str, value: &str) -> Result<&'a str, String> {
    let kind = kinds::constant(kind)?;
    if !name::is_constant(name) {
        return Err(
            "the name of the constant is missing or wrong: upper-case letters, digits, and single _ within".to_owned()
        );
    }
    values::element(&kind, value).map_err(|wrong| format!("the constant: {wrong}"))?;
    Ok(name)
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
            ("float64 x\nfloat64 x", "constant x already"),
            ("uint8 A=1\nuint8 A=1", "constant A already"),
            (" float64 x", "without a space in front"),
            ("wchar w", "wchar is a type of IDL only; .msg files have uint16"),
            ("long double d", "long is a type of IDL only; .msg files have int32, int64, or float64 for long double"),
            ("time t", "ROS 2 has builtin_interfaces/Time"),
            ("float64] x", "has a [ in front"),
            ("float64[-1] x", "no length"),
            ("float64[0] x", "no length"),
            ("string<=0 x", "no length"),
            ("int32<=3 x", "neither a type nor"),
            ("a/b/c/D x", "neither a type nor"),
            ("int32 9x", "name of the field"),
            ("int32 a=1", "name of the constant"),
            ("string<=3 A=abc", "not the type of a constant"),
            ("int32[] x [1", "stands in [ ]"),
            ("uint8 x 256", "from 0 to 255"),
            ("Vector3 v {}", "no default of its own"),
        ] {
            let fault = parse("test_msgs/msg/Test", text).unwrap_err();
            assert!(fault.message.contains(part), "{text:?}: {fault:?}");
        }
    }
}
