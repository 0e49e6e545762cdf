//! Text files as editors write them.

use std::fmt;

/// The mark that some editors put before a text in UTF-8.
const MARK: &[u8] = b"\xef\xbb\xbf";

/// Bytes that are no text.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum NotText {
    /// A byte that UTF-8 does not have at this place.
    Utf8 {
        /// Its position.
        at: usize,
    },
    /// A mark of UTF-16, and units of it that are no characters.
    Utf16,
}

impl fmt::Display for NotText {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Utf8 { at } => write!(f, "bytes that are not UTF-8 at byte {at}"),
            Self::Utf16 => f.write_str("a mark of UTF-16, and bytes that are not UTF-16"),
        }
    }
}

/// The text in the bytes of a file, without the byte order mark of editors such as Notepad. UTF-16 is read where such a mark
/// announces it, as PowerShell writes files.
///
/// # Errors
/// [`NotText`] for other bytes.
pub fn of_bytes(bytes: &[u8]) -> Result<String, NotText> {
    match bytes {
        [0xff, 0xfe, rest @ ..] => utf16(rest, u16::from_le_bytes),
        [0xfe, 0xff, rest @ ..] => utf16(rest, u16::from_be_bytes),
        _ => {
            let skipped = if bytes.starts_with(MARK) { MARK.len() } else { 0 };
            let text = bytes.get(skipped..).unwrap_or_default();
            let text =
                std::str::from_utf8(text).map_err(|fault| NotText::Utf8 { at: skipped + fault.valid_up_to() })?;
            Ok(text.to_owned())
        }
    }
}

fn utf16(bytes: &[u8], unit: fn([u8; 2]) -> u16) -> Result<String, NotText> {
    let (pairs, rest) = bytes.as_chunks::<2>();
    if !rest.is_empty() {
        return Err(NotText::Utf16);
    }
    char::decode_utf16(pairs.iter().copied().map(unit)).collect::<Result<_, _>>().map_err(|_| NotText::Utf16)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_marks_of_editors_are_no_part_of_a_text() {
        let utf16 = |mark: [u8; 2], unit: fn(u16) -> [u8; 2]| {
            let units = "permit é\r\n".encode_utf16().flat_map(unit);
            mark.into_iter().chain(units).collect::<Vec<u8>>()
        };
        for bytes in [
            "permit é\r\n".as_bytes().to_vec(),
            [MARK, "permit é\r\n".as_bytes()].concat(),
            utf16([0xff, 0xfe], u16::to_le_bytes),
            utf16([0xfe, 0xff], u16::to_be_bytes),
        ] {
            assert_eq!(of_bytes(&bytes).as_deref(), Ok("permit é\r\n"));
        }
        assert_eq!(of_bytes(b"").as_deref(), Ok(""));
    }

    #[test]
    fn other_bytes_are_no_text() {
        assert_eq!(of_bytes(b"ab\xff"), Err(NotText::Utf8 { at: 2 }));
        assert_eq!(of_bytes(b"\xef\xbb\xbfab\xff"), Err(NotText::Utf8 { at: 5 }));
        assert_eq!(of_bytes(b"\xff\xfea"), Err(NotText::Utf16));
        assert_eq!(of_bytes(b"\xff\xfe\x00\xd8"), Err(NotText::Utf16));
    }
}
