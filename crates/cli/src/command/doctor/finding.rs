//! One finding: what was looked at, how it is, and the repair.

use ledger_base::rejection::Rejection;
use serde::Serialize;
use std::borrow::Cow;

/// How something is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum State {
    /// As it should be.
    Ok,
    /// It works, and may not always.
    Advice,
    /// It keeps somebody from something.
    Wrong,
    /// It could not be looked at.
    Unknown,
}

impl State {
    /// For a column.
    pub(super) const fn word(self) -> &'static str {
        match self {
            Self::Ok => "ok",
            Self::Advice => "advice",
            Self::Wrong => "wrong",
            Self::Unknown => "unknown",
        }
    }
}

/// One finding. Only what is ok has no repair.
#[derive(Debug, Serialize)]
pub(super) struct Finding {
    pub(super) check: Cow<'static, str>,
    pub(super) state: State,
    pub(super) message: String,
    /// The repair.
    pub(super) r#try: String,
}

impl Finding {
    /// All is well.
    pub(super) fn ok(check: impl Into<Cow<'static, str>>, message: impl Into<String>) -> Self {
        Self { check: check.into(), state: State::Ok, message: message.into(), r#try: String::new() }
    }

    /// It works, and may not always.
    pub(super) fn advice(
        check: impl Into<Cow<'static, str>>,
        message: impl Into<String>,
        repair: impl Into<String>,
    ) -> Self {
        Self { check: check.into(), state: State::Advice, message: message.into(), r#try: repair.into() }
    }

    /// It keeps somebody from something.
    pub(super) fn wrong(
        check: impl Into<Cow<'static, str>>,
        message: impl Into<String>,
        repair: impl Into<String>,
    ) -> Self {
        Self { check: check.into(), state: State::Wrong, message: message.into(), r#try: repair.into() }
    }

    /// It could not be looked at.
    pub(super) fn unknown(
        check: impl Into<Cow<'static, str>>,
        message: impl Into<String>,
        repair: impl Into<String>,
    ) -> Self {
        Self { check: check.into(), state: State::Unknown, message: message.into(), r#try: repair.into() }
    }

    /// Wrong, as a refusal explains it.
    pub(super) fn refused(check: impl Into<Cow<'static, str>>, refused: &Rejection) -> Self {
        let Rejection { code, message, found, wanted, .. } = refused;
        let mut text = format!("{message} [{code}]");
        for (word, value) in [("found", found), ("wanted", wanted)] {
            if !value.is_empty() {
                text.push_str(&format!("; {word} {value}"));
            }
        }
        let advice = refused.advice();
        let repair = if advice.is_empty() { format!("ledgerctl explain {code}") } else { advice.to_owned() };
        Self::wrong(check, text, repair)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ledger_base::rejection::Code;

    #[test]
    fn a_refusal_keeps_its_four_parts_and_always_has_a_next_step() {
        let told = Finding::refused("node", &Rejection::new(Code::Unreachable, "m").found("f").wanted("w").next("n"));
        assert_eq!((told.message.as_str(), told.r#try.as_str()), ("m [LGR-4001]; found f; wanted w", "n"));
        assert_eq!(Finding::refused("node", &Rejection::new(Code::Held, "m")).r#try, "ledgerctl explain LGR-3005");
    }
}
