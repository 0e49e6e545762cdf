//! Bytes: hexadecimal text, files, standard input.

use crate::failure::unreadable;
use bytes::Bytes;
use ledger::transaction::TRANSACTION_BYTES_MAX;
use ledger_base::rejection::{Code, Rejection};
use std::io::Read;
use std::path::Path;

/// One argument of a call, as it stands on the command line.
///
/// `hex:00 01` is bytes, `@FILE` the content of a file, `-` standard input, `text:…` the text behind the colon
/// (for text that begins like one of these); everything else is text.
pub(crate) fn argument(text: &str) -> Result<Bytes, Rejection> {
    if let Some(digits) = text.strip_prefix("hex:") {
        from_hex(digits)
    } else if let Some(path) = text.strip_prefix('@') {
        from_file(Path::new(path))
    } else if let Some(text) = text.strip_prefix("text:") {
        Ok(Bytes::from(text.to_owned()))
    } else if text == "-" {
        from_stdin()
    } else {
        Ok(Bytes::from(text.to_owned()))
    }
}

/// Bytes of hexadecimal text; spaces, colons and a leading `0x` are tolerated, as tools print them so.
pub(crate) fn from_hex(text: &str) -> Result<Bytes, Rejection> {
    let digits: String =
        text.trim().trim_start_matches("0x").chars().filter(|c| !c.is_whitespace() && *c != ':').collect();
    hex::decode(&digits).map(Bytes::from).map_err(|error| {
        Rejection::new(Code::BadArgument, "the bytes cannot be read")
            .found(match error {
                hex::FromHexError::InvalidHexCharacter { c, .. } => format!("character {c:?}"),
                _ => format!("{} hex digits", digits.len()),
            })
            .wanted("hexadecimal digits, two for each byte, such as 00010000")
            .next("for the content of a file use --file FILE, or @FILE as an argument of a call")
    })
}

/// The content of a file, up to what a transaction may hold.
pub(crate) fn from_file(path: &Path) -> Result<Bytes, Rejection> {
    let file = std::fs::File::open(path).map_err(|error| unreadable(path, &error))?;
    bounded(file, path)
}

/// All of standard input, up to what a transaction may hold.
pub(crate) fn from_stdin() -> Result<Bytes, Rejection> {
    bounded(std::io::stdin(), Path::new("standard input"))
}

fn bounded(source: impl Read, name: &Path) -> Result<Bytes, Rejection> {
    let mut bytes = Vec::new();
    let limit = TRANSACTION_BYTES_MAX as u64 + 1;
    source.take(limit).read_to_end(&mut bytes).map_err(|error| unreadable(name, &error))?;
    if bytes.len() > TRANSACTION_BYTES_MAX {
        return Err(Rejection::new(Code::TooLarge, format!("{} is too large for a transaction", name.display()))
            .found(format!("more than {TRANSACTION_BYTES_MAX} bytes"))
            .wanted(format!("at most {TRANSACTION_BYTES_MAX} bytes"))
            .next("split it into several messages"));
    }
    Ok(bytes.into())
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn hex_is_read_as_tools_print_it() {
        for text in ["0001ff", "00 01 ff", "00:01:FF", "0x0001ff", " 0001ff\n"] {
            assert_eq!(from_hex(text).unwrap().as_ref(), [0, 1, 255], "{text:?}");
        }
        assert!(from_hex("").unwrap().is_empty());
    }

    #[test]
    fn wrong_hex_is_refused_with_what_was_found() {
        assert!(from_hex("0g").unwrap_err().found.contains("'g'"));
        assert!(from_hex("000").unwrap_err().found.contains("3 hex digits"));
    }

    #[test]
    fn arguments_are_text_unless_they_say_otherwise() {
        assert_eq!(argument("Turtlebot4/cmd_vel").unwrap().as_ref(), b"Turtlebot4/cmd_vel");
        assert_eq!(argument("hex:0a").unwrap().as_ref(), [10]);
        assert_eq!(argument("text:hex:0a").unwrap().as_ref(), b"hex:0a");
        assert_eq!(argument("text:@x").unwrap().as_ref(), b"@x");
        assert_eq!(argument("-5").unwrap().as_ref(), b"-5");
    }

    #[test]
    fn a_file_is_read_and_a_missing_one_is_named() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("payload");
        std::fs::write(&path, [1, 2, 3]).unwrap();
        assert_eq!(argument(&format!("@{}", path.display())).unwrap().as_ref(), [1, 2, 3]);
        let missing = argument("@/nowhere/payload").unwrap_err();
        assert_eq!(missing.code, Code::BadFile);
        assert!(missing.message.contains("/nowhere/payload"));
    }

    #[test]
    fn an_endless_source_is_cut_at_the_limit() {
        let error = bounded(std::io::repeat(0), Path::new("/dev/zero")).unwrap_err();
        assert_eq!(error.code, Code::TooLarge);
    }
}
