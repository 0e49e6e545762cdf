//! Why something was refused.

/// The refusal, the value found, the value wanted, and advice; the last three may be empty.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{message}")]
pub struct Fault {
    /// The refused thing.
    pub message: String,
    /// The value that was found.
    pub found: String,
    /// The value that would have been accepted.
    pub wanted: String,
    /// Advice for the next step.
    pub next: String,
}

impl Fault {
    pub(crate) fn new(message: impl Into<String>) -> Self {
        Self { message: message.into(), found: String::new(), wanted: String::new(), next: String::new() }
    }

    pub(crate) fn found(mut self, found: impl Into<String>) -> Self {
        self.found = found.into();
        self
    }

    pub(crate) fn wanted(mut self, wanted: impl Into<String>) -> Self {
        self.wanted = wanted.into();
        self
    }

    /// The same fault, of a field: `linear.x: …`.
    pub(crate) fn within(self, field: &str) -> Self {
        let is_path = self.message.split(": ").next().is_some_and(|path| {
            !path.is_empty() && path.chars().all(|c| c.is_ascii_alphanumeric() || matches!(c, '_' | '.' | '[' | ']'))
        });
        let message = match is_path {
            true => format!("{field}.{}", self.message),
            false => format!("{field}: {}", self.message),
        };
        Self { message, ..self }
    }

    pub(crate) fn next(mut self, next: impl Into<String>) -> Self {
        self.next = next.into();
        self
    }
}

/// Longest text that a fault quotes, in characters.
const QUOTED_MAX: usize = 80;

/// A text in quotes, cut where it is long.
pub(crate) fn quoted(text: &str) -> String {
    match text.char_indices().nth(QUOTED_MAX) {
        Some((end, _)) => format!("{:?}…", text.get(..end).unwrap_or_default()),
        None => format!("{text:?}"),
    }
}
