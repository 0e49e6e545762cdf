//! The consequences of a service's rule for everybody who publishes, checks messages or shows the service. Programs
//! read this, and never the name of the mode: so they serve modes that came after them.

use crate::sharing::Mode;
use crate::word::{Word, words};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt;

words! {
    /// The entitlement to publish.
    pub enum Publishing {
        /// A grant of one's own.
        Grant = "grant",
        /// A policy that permits it; a grant is possible too.
        Policy = "policy",
    }

    /// Which epochs of a service's grants are good for publishing.
    pub enum Fencing {
        /// The newest one alone: each new grant fences off every earlier one.
        Newest = "newest",
        /// Each holder's own: grants stand side by side.
        PerHolder = "per_holder",
    }

    /// Within what sequence numbers grow.
    pub enum Sequence {
        /// They begin anew with every epoch.
        PerEpoch = "per_epoch",
        /// They go on for each publisher, whatever the epoch.
        PerPublisher = "per_publisher",
    }
}

/// The consequences of a service's rule. Every field is needed to drive a robot safely.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Capabilities {
    /// The entitlement to publish.
    pub publishing: Publishing,
    /// Which epochs are good.
    pub fencing: Fencing,
    /// Within what sequence numbers grow.
    pub sequence: Sequence,
}

/// [`Capabilities`] as a node tells them: names and words, of which a newer node may use some that this program does not
/// know. A node tells only what a client must respect, so a name that is not known counts as much as a word.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct ToldCapabilities(BTreeMap<String, String>);

/// The part of a service's rule that a program does not know: it can show the service, and must not drive it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct UnknownRule(String);

impl Capabilities {
    /// The capabilities of the modes that every program knows by name: `open` and `exclusive`. None for another one.
    pub fn of_mode(mode: &Mode) -> Option<Self> {
        match mode.name() {
            "open" => Some(Self {
                publishing: Publishing::Policy,
                fencing: Fencing::PerHolder,
                sequence: Sequence::PerPublisher,
            }),
            "exclusive" => {
                Some(Self { publishing: Publishing::Grant, fencing: Fencing::Newest, sequence: Sequence::PerEpoch })
            }
            _ => None,
        }
    }
}

impl ToldCapabilities {
    /// Their meaning.
    ///
    /// # Errors
    /// The first that this program does not know, or that is missing.
    pub fn read(&self) -> Result<Capabilities, UnknownRule> {
        if let Some((name, word)) = self.0.iter().find(|(name, _)| !NAMES.contains(&name.as_str())) {
            return Err(UnknownRule(format!("capability {name:?} with the value {word:?}")));
        }
        let [publishing, fencing, sequence] = NAMES;
        Ok(Capabilities {
            publishing: self.word(publishing)?,
            fencing: self.word(fencing)?,
            sequence: self.word(sequence)?,
        })
    }

    fn word<T: Word>(&self, name: &str) -> Result<T, UnknownRule> {
        let word = self.0.get(name).ok_or_else(|| UnknownRule(format!("no capability {name:?}")))?;
        T::of(word).ok_or_else(|| UnknownRule(format!("capability {name:?} with the value {word:?}")))
    }
}

/// The capabilities by their names in JSON.
const NAMES: [&str; 3] = ["publishing", "fencing", "sequence"];

impl From<Capabilities> for ToldCapabilities {
    fn from(known: Capabilities) -> Self {
        let Capabilities { publishing, fencing, sequence } = known;
        let words = NAMES.into_iter().zip([publishing.word(), fencing.word(), sequence.word()]);
        Self(words.map(|(name, word)| (name.to_owned(), word.to_owned())).collect())
    }
}

impl fmt::Display for UnknownRule {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for UnknownRule {}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    fn told(json: &str) -> Result<Capabilities, String> {
        let told: ToldCapabilities = serde_json::from_str(json).unwrap();
        told.read().map_err(|unknown| unknown.to_string())
    }

    #[test]
    fn capabilities_are_told_by_their_names_and_read_again() {
        for mode in [Mode::OPEN, Mode::EXCLUSIVE] {
            let known = Capabilities::of_mode(&mode).unwrap();
            assert_eq!(ToldCapabilities::from(known).read().unwrap(), known);
        }
        let json = r#"{"fencing":"newest","publishing":"grant","sequence":"per_epoch"}"#;
        assert_eq!(told(json).unwrap(), Capabilities::of_mode(&Mode::EXCLUSIVE).unwrap());
        let again: ToldCapabilities = serde_json::from_str(json).unwrap();
        assert_eq!(serde_json::to_string(&again).unwrap(), json);
    }

    #[test]
    fn a_capability_that_is_unknown_or_missing_is_named() {
        for (json, wanted) in [
            (r#"{"fencing":"newest","publishing":"grant"}"#, "no capability \"sequence\""),
            (
                r#"{"fencing":"by_place","publishing":"grant","sequence":"per_epoch"}"#,
                "capability \"fencing\" with the value \"by_place\"",
            ),
            (
                r#"{"clamp":"gate","fencing":"newest","publishing":"grant","sequence":"per_epoch"}"#,
                "capability \"clamp\" with the value \"gate\"",
            ),
        ] {
            assert_eq!(told(json).unwrap_err(), wanted);
        }
    }
}
