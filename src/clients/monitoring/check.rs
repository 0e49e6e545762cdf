//! A part of readiness: well or not, and why.

use std::borrow::Cow;
use std::fmt;

/// One of the parts.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Check {
    name: Cow<'static, str>,
    /// Why it is not well; none if it is.
    failed: Option<String>,
    /// It is well, and needs attention soon.
    warning: Option<String>,
    /// Facts that are shown while nothing is wrong.
    note: Option<String>,
}

impl Check {
    /// A part that is well.
    pub(super) fn ok(name: impl Into<Cow<'static, str>>) -> Self {
        Self { name: name.into(), failed: None, warning: None, note: None }
    }

    /// A part that is not well.
    pub(super) fn failed(name: impl Into<Cow<'static, str>>, reason: String) -> Self {
        Self { name: name.into(), failed: Some(reason), warning: None, note: None }
    }

    /// A part that is well, or else not for this reason.
    pub(super) fn of(name: impl Into<Cow<'static, str>>, is_ok: bool, reason: impl FnOnce() -> String) -> Self {
        Self { name: name.into(), failed: (!is_ok).then(reason), warning: None, note: None }
    }

    /// It needs attention soon, if it is near that.
    pub(super) fn warn(self, is_near: bool, warning: impl FnOnce() -> String) -> Self {
        let warning = (is_near && self.is_ok()).then(warning);
        Self { warning, ..self }
    }

    /// Says this, too, while nothing is wrong.
    pub(super) fn note(self, note: Option<String>) -> Self {
        Self { note, ..self }
    }

    /// Is it well?
    pub(super) fn is_ok(&self) -> bool {
        self.failed.is_none()
    }
}

impl fmt::Display for Check {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (&self.failed, &self.warning, &self.note) {
            (Some(reason), ..) => writeln!(f, "[-] {} failed: {reason}", self.name),
            (None, Some(warning), _) => writeln!(f, "[+] {} ok, but {warning}", self.name),
            (None, None, Some(note)) => writeln!(f, "[+] {} ok: {note}", self.name),
            (None, None, None) => writeln!(f, "[+] {} ok", self.name),
        }
    }
}
