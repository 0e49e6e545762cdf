//! Bytes of a chaincode: JSON, text, or neither.

use crate::json;
use serde::Serialize;
use serde_json::value::RawValue;

/// The bytes as people and programs can read them. In JSON a pair: `encoding` says how `response` is to be read.
#[derive(Debug, Serialize)]
#[serde(tag = "encoding", content = "response", rename_all = "lowercase")]
#[non_exhaustive]
pub enum DecodedBytes {
    /// JSON as the chaincode wrote it, on one line.
    Json(Box<RawValue>),
    /// Text without control characters other than line ends and tabs.
    Text(String),
    /// Anything else, in hexadecimal digits.
    Hex(String),
}

impl DecodedBytes {
    /// Finds out what the bytes are.
    pub fn read(bytes: &[u8]) -> Self {
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
    pub fn to_text(&self) -> String {
        match self {
            Self::Json(value) => json::pretty(value.get()).unwrap_or_else(|| value.get().to_owned()),
            Self::Text(text) | Self::Hex(text) => text.clone(),
        }
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    fn shown(bytes: &[u8]) -> (String, String) {
        let decoded = DecodedBytes::read(bytes);
        (decoded.to_text(), serde_json::to_string(&decoded).unwrap())
    }

    #[test]
    fn json_is_pretty_for_people_and_itself_on_one_line_for_programs() {
        let (text, json) = shown(br#"{"Name":"Husky","UnderOp": false}"#);
        assert_eq!(text, "{\n  \"Name\": \"Husky\",\n  \"UnderOp\": false\n}");
        assert_eq!(json, r#"{"encoding":"json","response":{"Name":"Husky","UnderOp":false}}"#);
        let (_, json) = shown(b"{\"a\":\n18446744073709551616}");
        assert_eq!(json, r#"{"encoding":"json","response":{"a":18446744073709551616}}"#);
    }

    #[test]
    fn text_is_text_and_anything_else_is_hex() {
        assert_eq!(shown(b"hello\n"), ("hello\n".into(), r#"{"encoding":"text","response":"hello\n"}"#.into()));
        assert_eq!(shown(&[0, 1, 0, 0]).1, r#"{"encoding":"hex","response":"00010000"}"#);
        assert_eq!(shown(&[0xff]).1, r#"{"encoding":"hex","response":"ff"}"#);
        assert_eq!(shown(&[0xff, 0]).0, "ff00");
        assert_eq!(shown(b"\x1b[2J").0, "1b5b324a", "control sequences never reach the terminal");
        assert_eq!(shown(b"").0, "");
    }
}
