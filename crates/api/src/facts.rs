//! Answers of a node as JSON: the HTTP API (docs/http.md) and `ledgerctl -o json` (docs/output.md) serialise the same structs.
//!
//! Bytes are lower-case hexadecimal digits. Times are microseconds since the UNIX epoch, each followed by the same time in the form
//! of RFC 3339.

mod audit;
mod block;
mod decoded;
mod event;
mod status;

pub use audit::{AuditFacts, DenialFacts};
pub use block::{BlockFacts, TransactionFacts};
pub use decoded::DecodedBytes;
pub use event::{CallFacts, EventFacts, SignedCallFacts};
pub use status::{
    AttentionFacts, CRITICAL, CertificateFacts, CertificateRuleFacts, DiskFacts, ERROR, PeerFacts, StatusFacts, WARNING,
};

use ledger_base::moment::rfc3339;

/// A time, microseconds since the UNIX epoch, in the form of RFC 3339; none for 0, which is no time.
pub fn utc(micros: u64) -> Option<String> {
    (micros > 0).then(|| rfc3339(micros))
}

/// The printed form of a code that may be unknown to this version: `OK`, or `LGR-3005`.
fn code_text(number: u32) -> String {
    if number == 0 { "OK".to_owned() } else { format!("LGR-{number:04}") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_have_microseconds_and_no_time_has_no_text() {
        assert_eq!(utc(1_800_000_000_000_001).as_deref(), Some("2027-01-15T08:00:00.000001Z"));
        assert_eq!(utc(0), None);
    }
}
