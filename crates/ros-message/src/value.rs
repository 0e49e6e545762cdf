//! A decoded message: as JSON through `serde`, as YAML as `ros2 topic echo` prints it.

use serde::ser::{Serialize, SerializeMap, SerializeSeq, Serializer};
use std::fmt::Write;
use std::sync::Arc;

/// A message, or a part of one.
#[derive(Clone, Debug, PartialEq)]
pub enum Value {
    /// `bool`.
    Bool(bool),
    /// A signed number.
    Signed(i64),
    /// An unsigned number.
    Unsigned(u64),
    /// `float32`. In JSON, numbers that JSON does not know are `"NaN"`, `"Infinity"` and `"-Infinity"`.
    Single(f32),
    /// `float64`; in JSON as [`Value::Single`].
    Double(f64),
    /// `string`. Bytes that are no UTF-8 are replaced by U+FFFD.
    Text(String),
    /// Many `uint8`.
    Bytes(Vec<u8>),
    /// Elements of an array or a sequence.
    List(Vec<Value>),
    /// The fields of a message in their order.
    Fields(Vec<(Arc<str>, Value)>),
}

impl Serialize for Value {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Bool(value) => serializer.serialize_bool(*value),
            Self::Signed(value) => serializer.serialize_i64(*value),
            Self::Unsigned(value) => serializer.serialize_u64(*value),
            Self::Single(value) if value.is_finite() => serializer.serialize_f32(*value),
            Self::Double(value) if value.is_finite() => serializer.serialize_f64(*value),
            Self::Single(value) => serializer.serialize_str(not_finite(f64::from(*value))),
            Self::Double(value) => serializer.serialize_str(not_finite(*value)),
            Self::Text(text) => serializer.serialize_str(text),
            Self::Bytes(bytes) => serializer.collect_seq(bytes),
            Self::List(list) => {
                let mut elements = serializer.serialize_seq(Some(list.len()))?;
                list.iter().try_for_each(|element| elements.serialize_element(element))?;
                elements.end()
            }
            Self::Fields(fields) => {
                let mut map = serializer.serialize_map(Some(fields.len()))?;
                fields.iter().try_for_each(|(name, value)| map.serialize_entry(&**name, value))?;
                map.end()
            }
        }
    }
}

fn not_finite(value: f64) -> &'static str {
    if value.is_nan() {
        "NaN"
    } else if value > 0.0 {
        "Infinity"
    } else {
        "-Infinity"
    }
}

impl Value {
    /// YAML in block style, each line ended. Of strings, arrays and sequences at most `length_max` characters or
    /// elements are written, and `...` behind them.
    pub fn to_yaml(&self, length_max: Option<usize>) -> String {
        let mut yaml = Yaml { text: String::new(), length_max: length_max.unwrap_or(usize::MAX) };
        match self {
            Self::Fields(fields) if !fields.is_empty() => yaml.fields(fields, 0, false),
            other => {
                yaml.scalar(other);
                yaml.text.push('\n');
            }
        }
        yaml.text
    }
}

/// YAML that is being written.
struct Yaml {
    text: String,
    length_max: usize,
}

impl Yaml {
    /// The fields of a message; the first of them on the line that is there already if `begun`.
    fn fields(&mut self, fields: &[(Arc<str>, Value)], indent: usize, mut begun: bool) {
        for (name, value) in fields {
            self.indent(indent, begun);
            begun = false;
            self.text.push_str(name);
            self.text.push(':');
            match value {
                Value::Fields(inner) if !inner.is_empty() => {
                    self.text.push('\n');
                    self.fields(inner, indent + 2, false);
                }
                Value::List(list) if !list.is_empty() => {
                    self.text.push('\n');
                    self.list(list.iter(), list.len(), indent);
                }
                Value::Bytes(bytes) if !bytes.is_empty() => {
                    self.text.push('\n');
                    let bytes = bytes.iter().map(|byte| Value::Unsigned((*byte).into()));
                    let length = bytes.len();
                    self.list(bytes.collect::<Vec<_>>().iter().take(self.length_max), length, indent);
                }
                scalar => {
                    self.text.push(' ');
                    self.scalar(scalar);
                    self.text.push('\n');
                }
            }
        }
    }

    fn list<'a>(&mut self, elements: impl Iterator<Item = &'a Value>, length: usize, indent: usize) {
        for element in elements.take(self.length_max) {
            self.indent(indent, false);
            self.text.push_str("- ");
            match element {
                Value::Fields(fields) if !fields.is_empty() => self.fields(fields, indent + 2, true),
                scalar => {
                    self.scalar(scalar);
                    self.text.push('\n');
                }
            }
        }
        if length > self.length_max {
            self.indent(indent, false);
            self.text.push_str("- '...'\n");
        }
    }

    fn indent(&mut self, indent: usize, begun: bool) {
        if !begun {
            self.text.extend(std::iter::repeat_n(' ', indent));
        }
    }

    fn scalar(&mut self, value: &Value) {
        let _infallible = match value {
            Value::Bool(value) => write!(self.text, "{value}"),
            Value::Signed(value) => write!(self.text, "{value}"),
            Value::Unsigned(value) => write!(self.text, "{value}"),
            Value::Single(value) if value.is_finite() => write!(self.text, "{value:?}"),
            Value::Double(value) if value.is_finite() => write!(self.text, "{value:?}"),
            Value::Single(value) => write!(self.text, "{}", yaml_not_finite(f64::from(*value))),
            Value::Double(value) => write!(self.text, "{}", yaml_not_finite(*value)),
            Value::Text(text) => {
                self.quoted(text);
                Ok(())
            }
            Value::Bytes(_) | Value::List(_) => write!(self.text, "[]"),
            Value::Fields(_) => write!(self.text, "{{}}"),
        };
    }

    /// Text so that it is read as the same text, and moves no terminal's cursor.
    fn quoted(&mut self, text: &str) {
        let cut = match text.char_indices().nth(self.length_max) {
            Some((end, _)) => format!("{}...", text.get(..end).unwrap_or_default()),
            None => text.to_owned(),
        };
        if is_plain(&cut) {
            self.text.push_str(&cut);
        } else if cut.chars().any(is_escaped) {
            self.text.push('"');
            for c in cut.chars() {
                match c {
                    '"' | '\\' => self.text.extend(['\\', c]),
                    '\n' => self.text.push_str("\\n"),
                    '\t' => self.text.push_str("\\t"),
                    '\0' => self.text.push_str("\\0"),
                    c if is_escaped(c) => {
                        let _infallible = write!(self.text, "\\u{:04x}", u32::from(c));
                    }
                    c => self.text.push(c),
                }
            }
            self.text.push('"');
        } else {
            self.text.push('\'');
            self.text.push_str(&cut.replace('\'', "''"));
            self.text.push('\'');
        }
    }
}

/// Has this character an escape? Readers of YAML 1.1 or 1.2 reject it, take it for the end of a line, or drop it. All of them have at
/// most 16 bits.
fn is_escaped(c: char) -> bool {
    c.is_control() || matches!(c, '\u{2028}' | '\u{2029}' | '\u{feff}' | '\u{fffe}' | '\u{ffff}')
}

fn yaml_not_finite(value: f64) -> &'static str {
    if value.is_nan() {
        ".nan"
    } else if value > 0.0 {
        ".inf"
    } else {
        "-.inf"
    }
}

/// May the text stand without quotes? Only where no reader of YAML takes it for something else.
fn is_plain(text: &str) -> bool {
    /// Texts that readers of YAML 1.1 take for a boolean or for nothing.
    const WORDS: [&str; 11] = ["true", "false", "yes", "no", "on", "off", "null", "y", "n", "nan", "inf"];
    let inner = |c: char| c.is_alphanumeric() || matches!(c, '_' | '/' | '-' | '.' | ' ');
    text.starts_with(|c: char| c.is_alphabetic() || matches!(c, '_' | '/'))
        && text.chars().all(inner)
        && !text.ends_with(' ')
        && !WORDS.contains(&text.to_lowercase().as_str())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn text(text: &str) -> String {
        Value::Text(text.to_owned()).to_yaml(None).trim_end().to_owned()
    }

    #[test]
    fn text_is_quoted_where_it_would_be_read_as_something_else() {
        assert_eq!(text("base_link"), "base_link");
        assert_eq!(text("Hello World"), "Hello World");
        for quoted in
            ["", "true", "No", "1", "1.5", ".5", "-", "- a", "a: b", "a #b", "a ", "{a}", "null", "NaN", "0x1"]
        {
            assert_eq!(text(quoted), format!("'{quoted}'"), "{quoted}");
        }
        assert_eq!(text("it's"), "'it''s'");
        assert_eq!(text("a\0b\u{1b}[2J\n\u{9b}"), r#""a\0b\u001b[2J\n\u009b""#);
        assert_eq!(text("\u{feff}a\u{2028}\u{2029}\u{85}\u{ffff}"), r#""\ufeffa\u2028\u2029\u0085\uffff""#);
    }

    #[test]
    fn blocks_are_laid_out_as_ros2_topic_echo_does() {
        let field = |name: &str, value| (Arc::from(name), value);
        let point = |x| Value::Fields(vec![field("x", Value::Double(x)), field("y", Value::Single(0.1))]);
        let value = Value::Fields(vec![
            field("points", Value::List(vec![point(1.0), point(f64::NAN)])),
            field("none", Value::List(vec![])),
            field("data", Value::Bytes(vec![1, 2])),
            field(
                "inner",
                Value::Fields(vec![field("name", Value::Text("a".into())), field("e", Value::Fields(vec![]))]),
            ),
        ]);
        let wanted =
            "points:\n- x: 1.0\n  y: 0.1\n- x: .nan\n  y: 0.1\nnone: []\ndata:\n- 1\n- 2\ninner:\n  name: a\n  e: {}\n";
        assert_eq!(value.to_yaml(None), wanted);
        let cut = value.to_yaml(Some(1));
        assert!(cut.starts_with("points:\n- x: 1.0\n  y: 0.1\n- '...'\nnone"), "{cut}");
        assert!(cut.contains("data:\n- 1\n- '...'\n"), "{cut}");
        assert_eq!(Value::Text("abc".into()).to_yaml(Some(2)), "'ab...'\n".replace('\'', ""));
    }

    #[test]
    fn json_has_every_number_and_the_order_of_the_fields() {
        let field = |name: &str, value| (Arc::from(name), value);
        let value = Value::Fields(vec![
            field("z", Value::Unsigned(u64::MAX)),
            field("a", Value::Single(0.1)),
            field("n", Value::List(vec![Value::Double(f64::NAN), Value::Double(f64::NEG_INFINITY)])),
        ]);
        let json = serde_json::to_string(&value).unwrap_or_default();
        assert_eq!(json, r#"{"z":18446744073709551615,"a":0.1,"n":["NaN","-Infinity"]}"#);
    }
}
