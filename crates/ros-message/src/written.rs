//! The text of a person for a message, before its type is known.
//!
//! `1`, `yes` and `left` are texts here: what they mean is for the field that they are written for. So `data: yes` is a text
//! in a `std_msgs/msg/String` and true in a `std_msgs/msg/Bool`.

use crate::fault::quoted;

/// A text, a list, or names with values.
#[derive(Clone, Debug, PartialEq)]
pub enum Written {
    /// Nothing, as in `{stamp: }` or `null`: the default.
    Nothing,
    /// A number, a word, a text.
    Text(String),
    /// `[1, 2]`, or lines that begin with `-`.
    List(Vec<Written>),
    /// `{x: 1}`, or lines with a colon. No name stands twice.
    Map(Vec<(String, Written)>),
}

impl Written {
    /// Its kind, for people.
    pub(crate) fn shown(&self) -> String {
        match self {
            Self::Nothing => "nothing".to_owned(),
            Self::Text(text) => quoted(text),
            Self::List(list) => format!("a list of {}", list.len()),
            Self::Map(map) => {
                let names: Vec<_> = map.iter().take(8).map(|(name, _)| name.as_str()).collect();
                quoted(&format!("{{{}}}", names.join(", ")))
            }
        }
    }
}
