//! The answer of a chaincode: bytes that are JSON, text, or neither.

use bytes::Bytes;
use ledger_api::json;
use ledger_base::rejection::{Code, Rejection};
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::value::RawValue;

/// The bytes as people and programs can read them. In JSON a pair: `encoding` tells how `response` is to be read.
#[derive(Debug, Serialize)]
#[serde(tag = "encoding", content = "response", rename_all = "lowercase")]
pub(crate) enum Answer {
    /// JSON, as the chaincode wrote it.
    Json(Box<RawValue>),
    /// Text without control characters other than line ends and tabs.
    Text(String),
    /// Anything else, in hexadecimal digits.
    Hex(String),
}

impl Answer {
    /// Finds out what the bytes are.
    pub(crate) fn read(bytes: &[u8]) -> Self {
        let Ok(text) = std::str::from_utf8(bytes) else { return Self::Hex(hex::encode(bytes)) };
        match json::compact(text) {
            Some(value) => Self::Json(value),
            None if text.chars().any(|c| c.is_control() && !matches!(c, '\n' | '\r' | '\t')) => {
                Self::Hex(hex::encode(bytes))
            }
            None => Self::Text(text.to_owned()),
        }
    }

    /// For people: JSON with one field per line, text as it is, bytes in hexadecimal digits.
    pub(crate) fn to_text(&self) -> String {
        match self {
            Self::Json(value) => json::pretty(value.get()).unwrap_or_else(|| value.get().to_owned()),
            Self::Text(text) | Self::Hex(text) => text.clone(),
        }
    }
}

/// Reads the answer of a function whose form we know.
///
/// # Errors
/// [`Code::Malformed`] if it has another form: then node and client are of different versions.
pub(crate) fn parse<T: DeserializeOwned>(bytes: &Bytes, what: &str) -> Result<T, Rejection> {
    serde_json::from_slice(bytes).map_err(|error| {
        Rejection::new(Code::Malformed, format!("the node's answer cannot be read as {what}"))
            .found(error.to_string())
            .wanted(format!("the form that ledgerctl {} knows", env!("CARGO_PKG_VERSION")))
            .next("compare the versions: ledgerctl --version, ledgerctl status")
    })
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    fn shown(bytes: &[u8]) -> (String, String) {
        let answer = Answer::read(bytes);
        (answer.to_text(), serde_json::to_string(&answer).unwrap())
    }

    #[test]
    fn json_is_pretty_for_people_and_itself_for_programs() {
        let (text, json) = shown(br#"{"Name":"Husky","UnderOp": false}"#);
        assert_eq!(text, "{\n  \"Name\": \"Husky\",\n  \"UnderOp\": false\n}");
        assert_eq!(json, r#"{"encoding":"json","response":{"Name":"Husky","UnderOp":false}}"#);
    }

    #[test]
    fn text_is_text_and_anything_else_is_hex() {
        assert_eq!(shown(b"hello\n"), ("hello\n".into(), r#"{"encoding":"text","response":"hello\n"}"#.into()));
        assert_eq!(shown(&[0xff, 0]).0, "ff00");
        assert_eq!(shown(b"\x1b[2J").0, "1b5b324a", "control sequences never reach the terminal");
        assert_eq!(shown(b"").0, "");
    }

    #[test]
    fn an_answer_of_another_form_is_refused() {
        let error = parse::<Vec<u8>>(&Bytes::from_static(b"{}"), "a list").unwrap_err();
        assert_eq!(error.code, Code::Malformed);
    }
}
