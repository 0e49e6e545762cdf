//! Regular expressions for the ids of services, limited in size.

use std::{fmt, ops::RangeInclusive};

use ledger_base::rejection::{Code, Rejection};
use regex::bytes::{Regex, RegexBuilder};

/// Longest expression, in bytes.
const EXPRESSION_BYTES_MAX: usize = 256;
/// Most memory of a compiled expression, in bytes.
const COMPILED_BYTES_MAX: usize = 256 * 1024;

/// An expression that matches whole ids, such as `Turtlebot4/cmd_vel`.
#[derive(Clone)]
pub(super) struct Pattern {
    text: String,
    compiled: Regex,
}

/// An expression with a number for what it matches: `.*/odom=10`.
#[derive(Debug, Clone)]
pub(super) struct PatternLimit {
    pub(super) pattern: Pattern,
    pub(super) number: u64,
}

impl Pattern {
    /// Reads an expression. It takes linear time on whatever it is applied to.
    ///
    /// # Errors
    /// [`Code::BadConfiguration`] if it is none, or too large.
    pub(super) fn parse(text: &str) -> Result<Self, Rejection> {
        let refused = |found: String| {
            Err(Rejection::new(Code::BadConfiguration, "this is no usable regular expression")
                .found(found)
                .wanted("an expression for whole ids of services, e.g. \".*/cmd_vel\"")
                .next("a dot stands for any character, \".*\" for any text; write \"\\\\.\" for a dot"))
        };
        if text.len() > EXPRESSION_BYTES_MAX {
            return refused(format!("{} bytes, at most {EXPRESSION_BYTES_MAX} are allowed", text.len()));
        }
        // Names are ASCII: without Unicode the tables stay small.
        let compile = |text: &str| {
            let mut builder = RegexBuilder::new(text);
            builder.unicode(false).size_limit(COMPILED_BYTES_MAX).dfa_size_limit(COMPILED_BYTES_MAX).build()
        };
        // Alone first: a parenthesis too many must not close ours.
        match compile(text).and_then(|_| compile(&format!("^(?:{text})$"))) {
            Ok(compiled) => Ok(Self { text: text.to_owned(), compiled }),
            Err(regex::Error::CompiledTooBig(_)) => {
                refused(format!("{text:?} needs more than {COMPILED_BYTES_MAX} bytes"))
            }
            Err(_) => refused(format!("{text:?}")),
        }
    }

    pub(super) fn matches(&self, service: &str) -> bool {
        self.compiled.is_match(service.as_bytes())
    }
}

/// As in the configuration: routes are compared by their text.
impl fmt::Debug for Pattern {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Debug::fmt(&self.text, f)
    }
}

impl PatternLimit {
    /// Reads `EXPRESSION=NUMBER`.
    ///
    /// # Errors
    /// As [`Pattern::parse`]; [`Code::BadConfiguration`] for a number out of range.
    pub(super) fn parse(text: &str, range: RangeInclusive<u64>) -> Result<Self, Rejection> {
        // The expression may have an equals sign of its own.
        let parts = text.rsplit_once('=');
        let number = parts.and_then(|(_, number)| number.trim().parse().ok()).filter(|number| range.contains(number));
        let (Some((pattern, _)), Some(number)) = (parts, number) else {
            let (low, high) = (range.start(), range.end());
            return Err(Rejection::new(Code::BadConfiguration, "this is no limit")
                .found(format!("{text:?}"))
                .wanted(format!("EXPRESSION=NUMBER with a number from {low} to {high}, e.g. \".*/odom={low}\"")));
        };
        Ok(Self { pattern: Pattern::parse(pattern)?, number })
    }

    /// The number of the first that matches.
    pub(super) fn of(all: &[Self], service: &str) -> Option<u64> {
        all.iter().find(|numbered| numbered.pattern.matches(service)).map(|numbered| numbered.number)
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn an_expression_matches_whole_ids_only() {
        let pattern = Pattern::parse("Rover/cmd|.*/odom").unwrap();
        for (id, matches) in [("Rover/cmd", true), ("Rover/cmd_vel", false), ("a/b/odom", true), ("xRover/cmd", false)]
        {
            assert_eq!(pattern.matches(id), matches, "{id}");
        }
    }

    #[test]
    fn an_expression_that_is_none_or_too_large_is_refused() {
        let huge = "(?:a{100}){100}{100}";
        for (bad, found) in
            [("(", "\"(\""), (huge, "bytes"), (&"a".repeat(300)[..], "300 bytes"), ("a)|(?:b", "\"a)|(?:b\"")]
        {
            let refused = Pattern::parse(bad).unwrap_err();
            assert!(refused.found.contains(found), "{refused}");
        }
    }

    #[test]
    fn a_limit_is_an_expression_with_a_number() {
        let limits = [".*/odom=10", ".*=5"].map(|text| PatternLimit::parse(text, 1..=100).unwrap());
        assert_eq!(PatternLimit::of(&limits, "a/odom"), Some(10), "the first counts");
        assert_eq!(PatternLimit::of(&limits, "a/scan"), Some(5));
        for bad in ["10", ".*=", ".*=0", ".*=101", "(=5"] {
            assert!(PatternLimit::parse(bad, 1..=100).is_err(), "{bad}");
        }
    }
}
