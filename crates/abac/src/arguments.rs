//! Reading a call's arguments: every mistake says which argument, what it is and what it should be.

use bytes::Bytes;
use ledger_base::rejection::{Code, Rejection};

/// Longest text argument that is not a document, in bytes.
const TEXT_BYTES_MAX: usize = 512;
/// Longest piece of an argument that a message repeats, in characters.
const SHOWN_CHARS_MAX: usize = 80;

/// The arguments of one call.
#[derive(Clone, Copy)]
pub(crate) struct Arguments<'a> {
    usage: &'static str,
    args: &'a [Bytes],
}

impl<'a> Arguments<'a> {
    /// The arguments of a function whose usage is, e.g., `acquire SERVICE [LEASE_MS]`.
    ///
    /// # Errors
    /// [`Code::BadArgument`] unless there are between `min` and `max` of them.
    pub(crate) fn new(usage: &'static str, args: &'a [Bytes], min: usize, max: usize) -> Result<Self, Rejection> {
        let found = args.len();
        if (min..=max).contains(&found) {
            return Ok(Self { usage, args });
        }
        let (few, problem) = if found < min { (true, "too few") } else { (false, "too many") };
        Err(Rejection::new(Code::BadArgument, format!("{problem} arguments"))
            .found(if found == 1 { "1 argument".to_owned() } else { format!("{found} arguments") })
            .wanted(if min == max {
                min.to_string()
            } else {
                format!("{} {}", if few { "at least" } else { "at most" }, if few { min } else { max })
            })
            .next(format!("call it as: {usage}")))
    }

    /// Is there an argument at this index?
    pub(crate) fn has(&self, index: usize) -> bool {
        index < self.args.len()
    }

    /// Everything from this index on.
    pub(crate) fn rest(&self, index: usize) -> &'a [Bytes] {
        self.args.get(index..).unwrap_or_default()
    }

    /// The argument at this index as raw bytes.
    pub(crate) fn bytes(&self, index: usize, name: &str) -> Result<&'a Bytes, Rejection> {
        self.args.get(index).ok_or_else(|| self.bad(index, name, "nothing".to_owned(), "a value"))
    }

    /// A document: UTF-8 of at most `bytes_max` bytes.
    pub(crate) fn document(&self, index: usize, name: &str, bytes_max: usize) -> Result<&'a str, Rejection> {
        let bytes = self.bytes(index, name)?;
        if bytes.len() > bytes_max {
            let wanted = format!("at most {bytes_max} bytes");
            return Err(self.bad(index, name, format!("{} bytes", bytes.len()), &wanted));
        }
        std::str::from_utf8(bytes)
            .map_err(|fault| self.bad(index, name, format!("bytes that are not UTF-8 ({fault})"), "text"))
    }

    /// A name or another short text without control characters.
    pub(crate) fn text(&self, index: usize, name: &str) -> Result<&'a str, Rejection> {
        let text = self.document(index, name, TEXT_BYTES_MAX)?;
        if text.is_empty() || text.chars().any(char::is_control) {
            return Err(self.bad(index, name, shown(text), "text that is not empty and has no control characters"));
        }
        Ok(text)
    }

    /// A decimal number.
    pub(crate) fn number(&self, index: usize, name: &str) -> Result<u64, Rejection> {
        let text = self.text(index, name)?;
        // `u64::from_str` accepts a sign; one number has one spelling here.
        text.bytes()
            .all(|b| b.is_ascii_digit())
            .then(|| text.parse().ok())
            .flatten()
            .ok_or_else(|| self.bad(index, name, shown(text), "a decimal number from 0 to 18446744073709551615"))
    }

    /// The refusal of one argument.
    pub(crate) fn bad(&self, index: usize, name: &str, found: String, wanted: &str) -> Rejection {
        Rejection::new(Code::BadArgument, format!("argument {} ({name}) is not usable", index + 1))
            .found(found)
            .wanted(wanted)
            .next(format!("call it as: {}", self.usage))
    }
}

/// A piece of hostile text as a message may repeat it: quoted, escaped and short.
pub(crate) fn shown(text: &str) -> String {
    match text.char_indices().nth(SHOWN_CHARS_MAX) {
        Some((end, _)) => format!("{:?}… ({} bytes)", text.get(..end).unwrap_or_default(), text.len()),
        None => format!("{text:?}"),
    }
}
