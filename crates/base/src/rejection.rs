//! Refusals that explain themselves, and their stable codes.
//!
//! Every crate refuses with a [`Rejection`]: a [`Code`], and what was found, what was wanted, and what to do next. The
//! [`Class`] of a code decides the exit code of command-line tools.
//!
//! ```
//! use ledger_base::rejection::{Code, Rejection};
//!
//! let refused = Rejection::new(Code::UnknownRobot, "no robot is registered as Husky").wanted("Turtlebot4");
//! assert_eq!(refused.to_string(), "no robot is registered as Husky [LGR-3003]\n  wanted  Turtlebot4");
//! assert_eq!(refused.code.class().exit_code(), 3);
//! ```

mod code;

pub use code::{Class, Code};

use std::fmt;

/// Why something was refused: a stable code and the four lines that a person needs.
///
/// ```text
/// error: Farhad may not acquire Husky        [LGR-3001]
///   found   attributes Turtlebot4=true
///   wanted  attribute Husky=true
///   try     ask an admin of Org1 for the attribute, then enrol again
/// ```
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Rejection {
    /// The stable code.
    pub code: Code,
    /// The refusal, in one line without a full stop.
    pub message: String,
    /// The value that was found; empty if the message says it all.
    pub found: String,
    /// The value that would have been accepted; empty if the message says it all.
    pub wanted: String,
    /// Advice for this case; empty if the general advice of the code is enough. Private, so that every reader goes
    /// through [`Rejection::advice`] and shows the general advice as well.
    next: String,
}

impl Rejection {
    /// A refusal with a code and its first line.
    pub fn new(code: Code, message: impl Into<String>) -> Self {
        Self { code, message: message.into(), found: String::new(), wanted: String::new(), next: String::new() }
    }

    /// The refusal of a function that a chaincode does not have.
    pub fn unknown_function(chaincode: &str, function: &str, known: &[&str]) -> Self {
        Self::new(Code::UnknownFunction, format!("chaincode {chaincode:?} has no function {function:?}"))
            .found(function.to_owned())
            .wanted(format!("one of {}", known.join(", ")))
    }

    /// The refusal of an error whose text is `MESSAGE: found …, wanted …`, in its parts.
    pub fn told(code: Code, said: &str) -> Self {
        let parts = said.split_once(": found ").and_then(|(message, rest)| {
            let (found, wanted) = rest.rsplit_once(", wanted ")?;
            Some(Self::new(code, message).found(found).wanted(wanted))
        });
        parts.unwrap_or_else(|| Self::new(code, said))
    }

    /// The same with another code.
    #[must_use]
    pub fn code(mut self, code: Code) -> Self {
        self.code = code;
        self
    }

    /// The same with this in front of its first line.
    #[must_use]
    pub fn prefix(mut self, prefix: impl fmt::Display) -> Self {
        self.message = format!("{prefix}{}", self.message);
        self
    }

    /// Adds what was found.
    #[must_use]
    pub fn found(mut self, found: impl Into<String>) -> Self {
        self.found = found.into();
        self
    }

    /// Adds what was wanted.
    #[must_use]
    pub fn wanted(mut self, wanted: impl Into<String>) -> Self {
        self.wanted = wanted.into();
        self
    }

    /// Adds advice for this case, where [`Code::advice`] is not enough.
    #[must_use]
    pub fn next(mut self, next: impl Into<String>) -> Self {
        self.next = next.into();
        self
    }

    /// Advice for the next step: the one for this case, otherwise the general one of the code; empty if there is neither.
    ///
    /// The general advice is applied here, when a rejection is read, and nowhere else. So a stored verdict need not repeat
    /// it, and a rejection that gets another code gets its advice as well.
    pub fn advice(&self) -> &str {
        if self.next.is_empty() { self.code.advice() } else { &self.next }
    }

    /// The advice for this case alone: what a stored verdict keeps.
    pub fn own_advice(&self) -> &str {
        &self.next
    }
}

impl fmt::Display for Rejection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} [{}]", self.message, self.code)?;
        for (label, text) in [("found ", self.found.as_str()), ("wanted", &self.wanted), ("try   ", self.advice())] {
            if !text.is_empty() {
                write!(f, "\n  {label}  {text}")?;
            }
        }
        Ok(())
    }
}

impl std::error::Error for Rejection {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_of_one_sentence_becomes_the_lines_of_a_refusal() {
        let told = Rejection::told(Code::Untrusted, "it is another node: found Org1/node1, wanted Org2/node1");
        assert_eq!((&*told.message, &*told.found, &*told.wanted), ("it is another node", "Org1/node1", "Org2/node1"));
        let whole = Rejection::told(Code::Untrusted, "it found nothing");
        assert_eq!((&*whole.message, &*whole.found, &*whole.wanted), ("it found nothing", "", ""));
    }

    #[test]
    fn a_rejection_without_advice_of_its_own_shows_that_of_its_code() {
        let expired = Rejection::new(Code::Expired, "it has expired");
        assert_eq!((expired.advice(), expired.own_advice()), (Code::Expired.advice(), ""));
        assert!(expired.to_string().ends_with(&format!("\n  try     {}", Code::Expired.advice())), "{expired}");
        let own = expired.next("wait");
        assert_eq!((own.advice(), own.own_advice()), ("wait", "wait"));
        assert_eq!(Rejection::new(Code::Expired, "").code(Code::Internal).advice(), "");
    }
}
