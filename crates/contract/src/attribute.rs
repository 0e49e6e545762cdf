//! Attributes of robots and services: facts by which policies speak of capabilities and not of names.

use serde::{Deserialize, Deserializer, Serialize};
use std::collections::BTreeMap;
use std::fmt;

/// The value of an attribute. Its type is part of it: a policy that asks for a number finds no text.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Attribute {
    /// A whole number, such as a payload in kilograms.
    Number(i64),
    /// A text, such as a kind of robot.
    Text(String),
    /// Several texts without an order, such as zones. On the ledger they are sorted, each once.
    Set(Vec<String>),
}

/// The attributes of a robot or a service, by their names.
pub type Attributes = BTreeMap<String, Attribute>;

/// A change of attributes: those that are named get this value, or are removed.
pub type AttributeChanges = BTreeMap<String, Option<Attribute>>;

/// As people read it: `20`, `crane`, `a, b`.
impl fmt::Display for Attribute {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Number(number) => write!(f, "{number}"),
            Self::Text(text) => f.write_str(text),
            Self::Set(texts) => f.write_str(&texts.join(", ")),
        }
    }
}

/// A field that one may leave out: whoever names it has said something, whatever its value is.
pub(crate) fn named<'de, T: Deserialize<'de>, D: Deserializer<'de>>(from: D) -> Result<Option<T>, D::Error> {
    T::deserialize(from).map(Some)
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn the_json_of_a_value_says_its_type() {
        let json = r#"{"kind":"crane","payload_kg":-20,"zones":["a","b"]}"#;
        let read: Attributes = serde_json::from_str(json).unwrap();
        let shown: Vec<String> = read.values().map(ToString::to_string).collect();
        assert_eq!(shown, ["crane", "-20", "a, b"]);
        assert_eq!(serde_json::to_string(&read).unwrap(), json);
        for bad in ["1.5", "true", "null", "[1]", "{}", "9223372036854775808"] {
            assert!(serde_json::from_str::<Attribute>(bad).is_err(), "{bad}");
        }
    }
}
