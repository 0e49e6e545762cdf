//! The answers of functions whose form is known.

use bytes::Bytes;
use ledger_base::rejection::{Code, Rejection};
use serde::de::DeserializeOwned;

/// Reads the answer of a function whose form we know.
///
/// # Errors
/// [`Code::Malformed`] if it has another form: then node and client are of different versions.
pub(crate) fn parse<T: DeserializeOwned>(bytes: &Bytes, what: &str) -> Result<T, Rejection> {
    serde_json::from_slice(bytes).map_err(|error| {
        Rejection::new(Code::Malformed, format!("the node's answer cannot be read as {what}"))
            .found(error.to_string())
            .wanted(format!("the form that ledgerctl {} understands", env!("CARGO_PKG_VERSION")))
            .next("compare the versions: ledgerctl --version, ledgerctl status")
    })
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn an_answer_of_another_form_is_refused() {
        let error = parse::<Vec<u8>>(&Bytes::from_static(b"{}"), "a list").unwrap_err();
        assert_eq!(error.code, Code::Malformed);
    }
}
