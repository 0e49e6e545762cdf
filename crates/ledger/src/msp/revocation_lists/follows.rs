//! Does a list follow the one before? The newest list of a key and a scope is kept, so that its age can be judged.
//! Revocations do not depend on it.

use super::ListRecord;
use ledger_base::mutation::{Mutation, active};
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::revocation_list::RevocationList;

/// How far a list may come from the future, in microseconds of block time: clocks differ.
pub const LIST_AHEAD_MAX: u64 = 5 * 60 * 1_000_000;

/// Checks that a list is of today, by block time in microseconds.
pub(in super::super) fn check_time(list: &RevocationList, now: u64) -> Result<(), Rejection> {
    if list.this_update > now.saturating_add(LIST_AHEAD_MAX) {
        return Err(old("the revocation list is from the future")
            .found(format!("made at {} µs, block time {now} µs", list.this_update))
            .wanted("a list that was made before now")
            .next(
                "compare the clock of the CA with one that you trust; if it is wrong, set it and make the list again",
            ));
    }
    if let Some(end) = list.next_update.filter(|end| *end < now) {
        return Err(old("the revocation list has ended")
            .found(format!("next update at {end} µs, block time {now} µs"))
            .wanted("a list that is good now")
            .next("have the CA make a new one"));
    }
    Ok(())
}

/// Checks that a list was made after the one before of the same key and scope. Of two lists of one moment the numbers decide.
pub(super) fn check(before: &ListRecord, list: &RevocationList) -> Result<(), Rejection> {
    if list.this_update < before.this_update && !active(Mutation::TakeAnOlderList) {
        return Err(old("the revocation list is older than the one that the ledger has")
            .found(format!("made at {} µs", list.this_update))
            .wanted(format!("made at {} µs or later", before.this_update)));
    }
    if list.this_update == before.this_update && !grows(before, list) {
        return Err(old("the number of the revocation list does not grow")
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
