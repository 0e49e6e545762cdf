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
}

impl Check {
    /// A part that is well.
    pub(super) fn ok(name: impl Into<Cow<'static, str>>) -> Self {
        Self { name: name.into(), failed: None, warning: None }
    }

    /// A part that is not well.
    pub(super) fn failed(name: impl Into<Cow<'static, str>>, reason: String) -> Self {
        Self { name: name.into(), failed: Some(reason), warning: None }
    }

    /// A part that is well, or else not for this reason.
    pub(super) fn of(name: impl Into<Cow<'static, str>>, is_ok: bool, reason: impl FnOnce() -> String) -> Self {
        Self { name: name.into(), failed: (!is_ok).then(reason), warning: None }
    }

    /// It needs attention soon, if it is near that.
    pub(super) fn warn(self, is_near: bool, warning: impl FnOnce() -> String) -> Self {
        let warning = (is_near && self.is_ok()).then(warning);
        Self { warning, ..self }
    }

    /// Is it well?
    pub(super) fn is_ok(&self) -> bool {
        self.failed.is_none()
    }
}

impl fmt::Display for Check {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (&self.failed, &self.warning) {
            (Some(reason), _) => writeln!(f, "[-] {} failed: {reason}", self.name),
            (None, Some(warning)) => writeln!(f, "[+] {} ok, but {warning}", self.name),
            (None, None) => writeln!(f, "[+] {} ok", self.name),
        }
    }
}
