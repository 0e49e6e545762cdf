//! The answer to a request, for people.

use ledger_contract::{Grant, LineState, Pending, Place};
use ledger_rejection::{Code, Rejection};

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
    Rejection::new(Code::Held, format!("{service} is not yours yet: others must confirm {contender}"))
        .found(format!("{} of {wanted} confirmations", confirmed.len()))
        .wanted(format!("{wanted} confirmations"))
        .next(format!("ask for them: ledgerctl confirm {service} {contender}"))
}
