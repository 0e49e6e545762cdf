//! The answer to a request, for people.

use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{Grant, LineState, Pending, Place};

/// `std_srvs/srv/Trigger_Response`.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Answer {
    success: bool,
    message: String,
}

impl Answer {
    pub(super) fn yes(message: String) -> Self {
        Self { success: true, message }
    }

    /// The explanation in its four lines.
    pub(super) fn no(refused: &Rejection) -> Self {
        Self { success: false, message: refused.to_string() }
    }

    /// Its CDR, without an encapsulation header: a boolean, and a string with its length and a zero.
    pub(super) fn encode(&self) -> Vec<u8> {
        let text = self.message.replace('\0', " ");
        let mut bytes = vec![u8::from(self.success), 0, 0, 0];
        bytes.extend(u32::try_from(text.len().saturating_add(1)).unwrap_or(u32::MAX).to_le_bytes());
        bytes.extend(text.into_bytes());
        bytes.push(0);
        bytes
    }
}

/// The holders of a service, and since when, at a block time in microseconds.
pub(super) fn holders(line: &LineState, now: u64) -> String {
    let held = |grant: &Grant| {
        let seconds = now.saturating_sub(grant.acquired_at) / 1_000_000;
        format!("{} has held {} for {seconds} s", grant.holder, line.service)
    };
    match line.holders.as_slice() {
        [] => format!("nobody holds {} now", line.service),
        holders => holders.iter().map(held).collect::<Vec<_>>().join(", "),
    }
}

/// The caller waits in line.
pub(super) fn queued(place: &Place, name: &str) -> Rejection {
    let Place { service, position, .. } = place;
    Rejection::new(Code::Held, format!("{service} is not yours yet: queued at position {position}"))
        .wanted("your turn")
        .next(format!("wait: the grant comes by itself, and this bridge keeps it; {name}/release leaves the line"))
}

/// Others must confirm the caller.
pub(super) fn pending(pending: &Pending) -> Rejection {
    let Pending { service, contender, confirmed, wanted, .. } = pending;
    let have = format!("{} of {wanted} have", confirmed.len());
    Rejection::new(Code::Held, format!("{service} is not yours yet: others must confirm {contender}, {have}"))
        .wanted(format!("{wanted} confirmations"))
        .next(format!("ask for them: ledgerctl confirm {service} {contender}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_answer_is_a_boolean_and_a_string_of_cdr() {
        let bytes = Answer::yes("ab".to_owned()).encode();
        assert_eq!(bytes, [1, 0, 0, 0, 3, 0, 0, 0, b'a', b'b', 0]);
        let refused = Rejection::new(Code::Held, "it is held").found("a\0b").wanted("nobody").next("wait");
        let bytes = Answer::no(&refused).encode();
        let text = "it is held [LGR-3005]\n  found   a b\n  wanted  nobody\n  try     wait\0";
        assert_eq!(bytes.get(8..), Some(text.as_bytes()), "a string ends with its first zero");
    }

    #[test]
    fn who_holds_a_service_is_told_with_the_time_since_then() {
        let grant = |holder: &str, at: u64| Grant { acquired_at: at, ..ledger_gate::fixture::grant(holder, 1) };
        let line = |holders| LineState { service: "T/a".into(), holders, line: Vec::new(), pending: Vec::new() };
        assert_eq!(holders(&line(Vec::new()), 9), "nobody holds T/a now");
        let both = line(vec![grant("Org1/Salma", 1_000_000), grant("Org1/Farhad", 99_000_000)]);
        let wanted = "Org1/Salma has held T/a for 12 s, Org1/Farhad has held T/a for 0 s";
        assert_eq!(holders(&both, 13_500_000), wanted);
    }
}
