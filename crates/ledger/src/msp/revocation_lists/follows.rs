//! Does a list follow the one before? The newest list of a key and a scope is kept, so that its age can be judged.
//! Revocations do not depend on it.

use super::ListRecord;
use ledger_base::moment::rfc3339;
use ledger_base::mutation::{Mutation, active};
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::revocation_list::RevocationList;

/// How far a list may come from the future, in microseconds of block time: clocks differ.
pub const LIST_AHEAD_MAX: u64 = 5 * 60 * 1_000_000;

/// Checks that a list is of today, by block time in microseconds.
pub(in super::super) fn check_time(list: &RevocationList, now: u64) -> Result<(), Rejection> {
    if list.this_update > now.saturating_add(LIST_AHEAD_MAX) {
        return Err(old("the revocation list is dated in the future")
            .found(format!("issued at {}, block time {}", rfc3339(list.this_update), rfc3339(now)))
            .wanted("a list issued before now")
            .next(
                "compare the clock of the CA with a trusted clock; if it is wrong, correct it and issue the list again",
            ));
    }
    if let Some(end) = list.next_update.filter(|end| *end < now) {
        return Err(old("the revocation list has expired")
            .found(format!("next update at {}, block time {}", rfc3339(end), rfc3339(now)))
            .wanted("a list that has not expired")
            .next("have the CA issue a new list"));
    }
    Ok(())
}

/// Checks that a list was made after the one before of the same key and scope. Of two lists of one moment the numbers decide.
pub(super) fn check(before: &ListRecord, list: &RevocationList) -> Result<(), Rejection> {
    if list.this_update < before.this_update && !active(Mutation::TakeAnOlderList) {
        return Err(old("the revocation list is older than the recorded one")
            .found(format!("issued at {}", rfc3339(list.this_update)))
            .wanted(format!("issued at {} or later", rfc3339(before.this_update))));
    }
    if list.this_update == before.this_update && !grows(before, list) {
        return Err(old("the number of the revocation list does not increase")
            .found(list.number.as_ref().map_or_else(|| "no number".to_owned(), hex::encode))
            .wanted(format!("a number above {}, or a later time", before.number.as_deref().unwrap_or("none"))));
    }
    Ok(())
}

/// Is the number of a list above that of the one before? A CA whose memory was lost counts from one again.
pub(super) fn grows(before: &ListRecord, list: &RevocationList) -> bool {
    let Some(known) = before.number.as_deref() else { return true };
    list.number.as_ref().map(hex::encode).is_some_and(|number| in_order(&number) > in_order(known))
}

/// Numbers in hexadecimal without leading zeros, in the order of the numbers.
fn in_order(number: &str) -> (usize, &str) {
    (number.len(), number)
}

fn old(message: &str) -> Rejection {
    Rejection::new(Code::OldList, message)
}
