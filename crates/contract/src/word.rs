//! Enums that are words in JSON, and words of which this program does not know the meaning.

use serde::{Deserialize, Deserializer, Serialize};
use std::fmt;

/// An enum whose values are words in JSON.
pub trait Word: Copy + Eq + 'static {
    /// Every value.
    const ALL: &'static [Self];

    /// The word of a value.
    fn word(self) -> &'static str;

    /// The value of a word; none if this program does not know it.
    fn of(word: &str) -> Option<Self> {
        Self::ALL.iter().copied().find(|value| value.word() == word)
    }
}

/// Declares enums with the word of each value.
macro_rules! words {
    ($($(#[$of_enum:meta])* pub enum $name:ident { $($(#[$of_value:meta])* $value:ident = $word:literal,)* })*) => {$(
        $(#[$of_enum])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
        #[non_exhaustive]
        pub enum $name { $($(#[$of_value])* #[serde(rename = $word)] $value,)* }

        impl $crate::word::Word for $name {
            const ALL: &'static [Self] = &[$(Self::$value,)*];

            fn word(self) -> &'static str {
                match self { $(Self::$value => $word,)* }
            }
        }

        impl std::fmt::Display for $name {
            fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str($crate::word::Word::word(*self))
            }
        }
    )*};
}

pub(crate) use words;

/// A value as a node tells it. A newer node may have values that this program does not know: they can be shown.
///
/// ```
/// use ledger_contract::{Reason, Told};
///
/// let known: Told<Reason> = serde_json::from_str(r#""expired""#)?;
/// let newer: Told<Reason> = serde_json::from_str(r#""weary""#)?;
/// assert_eq!((known.known(), newer.known()), (Some(Reason::Expired), None));
/// assert_eq!(newer.to_string(), "weary");
/// # Ok::<(), serde_json::Error>(())
/// ```
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize)]
#[serde(untagged)]
pub enum Told<T> {
    /// A value that this program knows.
    Known(T),
    /// The word of another one.
    Unknown(String),
}

impl<T: Word> Told<T> {
    /// The value, if this program knows it.
    pub fn known(&self) -> Option<T> {
        match self {
            Self::Known(value) => Some(*value),
            Self::Unknown(_) => None,
        }
    }

    /// Its word.
    pub fn word(&self) -> &str {
        match self {
            Self::Known(value) => value.word(),
            Self::Unknown(word) => word,
        }
    }
}

impl<T: PartialEq> PartialEq<T> for Told<T> {
    fn eq(&self, other: &T) -> bool {
        matches!(self, Self::Known(value) if value == other)
    }
}

impl<T> From<T> for Told<T> {
    fn from(value: T) -> Self {
        Self::Known(value)
    }
}

impl<T: Word> fmt::Display for Told<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.word())
    }
}

impl<'d, T: Word> Deserialize<'d> for Told<T> {
    fn deserialize<D: Deserializer<'d>>(deserializer: D) -> Result<Self, D::Error> {
        let word = String::deserialize(deserializer)?;
        Ok(T::of(&word).map_or(Self::Unknown(word), Self::Known))
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::{Told, Word};
    use crate::{Direction, Fencing, LeftReason, OnConflict, Publishing, Reason, Sequence, TaskState};
    use serde::Serialize;
    use serde::de::DeserializeOwned;

    fn agrees<T: Word + Serialize + DeserializeOwned + std::fmt::Debug>() {
        for value in T::ALL {
            let json = serde_json::to_string(value).unwrap();
            assert_eq!(json, format!("{:?}", value.word()));
            assert_eq!(serde_json::from_str::<T>(&json).unwrap(), *value);
            let told: Told<T> = serde_json::from_str(&json).unwrap();
            assert_eq!((told.known(), serde_json::to_string(&told).unwrap()), (Some(*value), json));
        }
        assert!(serde_json::from_str::<T>("\"unheard_of\"").is_err(), "what is asked for must be known");
    }

    #[test]
    fn a_value_has_the_same_word_in_json_and_for_people() {
        agrees::<LeftReason>();
        agrees::<OnConflict>();
        agrees::<Direction>();
        agrees::<Reason>();
        agrees::<Publishing>();
        agrees::<Fencing>();
        agrees::<Sequence>();
        agrees::<TaskState>();
    }

    #[test]
    fn a_word_of_a_newer_node_is_kept_and_told_on_as_it_came() {
        let told: Told<Reason> = serde_json::from_str("\"weary\"").unwrap();
        assert_eq!((told.known(), told.word()), (None, "weary"));
        assert_eq!(serde_json::to_string(&told).unwrap(), "\"weary\"");
        assert!(serde_json::from_str::<Told<Reason>>("7").is_err(), "a number is no word");
    }
}
