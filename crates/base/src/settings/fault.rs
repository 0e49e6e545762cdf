//! A fault of a configuration file, with its line.

use crate::rejection::Rejection;
use std::fmt;
use std::path::PathBuf;

/// Something wrong with a configuration file. Prints as the four lines of an error, of which the first names the file
/// and the line.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Fault {
    /// The file.
    pub file: PathBuf,
    /// The line, from 1; none if it is about the whole file.
    pub line: Option<usize>,
    /// The fault, the value that was wanted, the next step.
    pub rejection: Rejection,
}

impl From<Fault> for Rejection {
    fn from(fault: Fault) -> Self {
        let mut rejection = fault.rejection;
        let line = fault.line.map(|line| format!("{line}:")).unwrap_or_default();
        rejection.message = format!("{}:{line} {}", fault.file.display(), rejection.message);
        rejection
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(&Rejection::from(self.clone()), f)
    }
}

impl std::error::Error for Fault {}
