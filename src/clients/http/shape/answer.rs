//! Bytes of a chaincode: JSON, text, or neither.

use serde::Serialize;
use serde_json::value::RawValue;

/// The bytes as a pair: `encoding` says how `response` is to be read.
#[derive(Serialize)]
#[serde(tag = "encoding", content = "response", rename_all = "lowercase")]
pub(in crate::clients::http) enum Answer {
    /// JSON, as the chaincode wrote it, on one line.
    Json(Box<RawValue>),
    /// Text without control characters other than line ends and tabs.
    Text(String),
    /// Anything else, in hexadecimal digits.
    Hex(String),
}

impl Answer {
    /// Finds out what the bytes are.
    pub(in crate::clients::http) fn read(bytes: &[u8]) -> Self {
        let Ok(text) = std::str::from_utf8(bytes) else { return Self::Hex(hex::encode(bytes)) };
        // In JSON, an end of line is space between values: a string cannot have one.
        if serde_json::from_str::<&RawValue>(text).is_ok()
            && let Ok(value) = RawValue::from_string(text.replace(['\n', '\r'], " "))
        {
            return Self::Json(value);
        }
        match text.chars().any(|c| c.is_control() && !matches!(c, '\n' | '\r' | '\t')) {
            true => Self::Hex(hex::encode(bytes)),
            false => Self::Text(text.to_owned()),
        }
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn bytes_are_json_on_one_line_text_or_hexadecimal_digits() {
        let shown = |bytes: &[u8]| serde_json::to_string(&Answer::read(bytes)).unwrap();
        assert_eq!(
            shown(b"{\"a\":\n18446744073709551616}"),
            r#"{"encoding":"json","response":{"a": 18446744073709551616}}"#
        );
        assert_eq!(shown(b"hello\n"), r#"{"encoding":"text","response":"hello\n"}"#);
        assert_eq!(shown(&[0, 1, 0, 0]), r#"{"encoding":"hex","response":"00010000"}"#);
        assert_eq!(shown(&[0xff]), r#"{"encoding":"hex","response":"ff"}"#);
    }
}
