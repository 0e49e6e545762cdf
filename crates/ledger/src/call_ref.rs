//! The name of a signed call, by which others ask for its verdict.

use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use std::fmt;
use std::str::FromStr;

/// Names a signed call: its id, and until when it may be executed. Written as `ID:NOT_AFTER`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct CallRef {
    /// The id of the transaction.
    pub id: Hash,
    /// Its `not_after`, microseconds since the UNIX epoch.
    pub not_after: u64,
}

impl fmt::Display for CallRef {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}", self.id, self.not_after)
    }
}

impl FromStr for CallRef {
    type Err = Rejection;

    /// # Errors
    /// [`Code::Malformed`].
    fn from_str(text: &str) -> Result<Self, Rejection> {
        let read = text.split_once(':').and_then(|(id, not_after)| {
            // `u64::from_str` accepts a sign; one number has one spelling here.
            let not_after = Some(not_after).filter(|digits| digits.bytes().all(|digit| digit.is_ascii_digit()))?;
            Some(Self { id: Hash::from_hex(id)?, not_after: not_after.parse().ok()? })
        });
        read.ok_or_else(|| {
            Rejection::new(Code::Malformed, "the reference to a call cannot be read")
                .found(format!("{:?}", text.chars().take(120).collect::<String>()))
                .wanted("ID:NOT_AFTER, an id of 64 hexadecimal digits and microseconds")
                .next("copy it from the open stops in ledgerctl status")
        })
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn a_name_is_read_as_it_is_written_and_nothing_else_is_one() {
        let name = CallRef { id: Hash::of(&[b"stop"]), not_after: 7 };
        let text = name.to_string();
        assert_eq!(text.parse::<CallRef>().unwrap(), name);
        for wrong in ["", ":", "7", &text.replace(':', ":+"), &text.replace(':', ""), &text[1..], &format!("{text}x")] {
            assert_eq!(wrong.parse::<CallRef>().unwrap_err().code, Code::Malformed, "{wrong}");
        }
    }
}
