//! Messages as JSON. Where `ledgerctl -o json` prints the same thing, the fields have the same names (docs/output.md).

mod answer;
mod audit;
mod block;
mod event;
mod network;
mod status;

pub(super) use answer::Answer;
pub(super) use audit::{AuditFacts, DenialFacts};
pub(super) use block::{BlockFacts, TransactionFacts};
pub(super) use event::DeliveryFacts;
pub(super) use network::NetworkFacts;
pub(super) use status::{NodeFacts, StatusFacts};

use ledger_base::moment::rfc3339;

/// A time, microseconds since the UNIX epoch, in the form of RFC 3339; none for 0, which is no time.
pub(super) fn utc(micros: u64) -> Option<String> {
    (micros > 0).then(|| rfc3339(micros))
}

/// The code of a verdict: `OK`, or `LGR-3005`.
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
