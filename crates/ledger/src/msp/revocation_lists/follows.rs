//! Does a list follow the one before? Lists only go forward in time and number, and only forget what has ended.

use ledger_base::mutation::{Mutation, active};
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::revocation_list::RevocationList;
use std::collections::BTreeSet;

/// How far a list may come from the future, in microseconds of block time: clocks differ.
pub const LIST_AHEAD_MAX: u64 = 5 * 60 * 1_000_000;

/// Most serial numbers that a refusal shows.
const SHOWN_MAX: usize = 3;

/// The list before, as far as the next one has to follow it.
pub(super) struct Kept {
    /// When it was made, microseconds since the UNIX epoch.
    pub(super) this_update: u64,
    /// Its number in hexadecimal.
    pub(super) number: Option<String>,
    /// The serial numbers that it revokes.
    pub(super) serials: BTreeSet<Vec<u8>>,
}

/// Checks that a list is of today, by block time in microseconds.
pub(super) fn check_time(list: &RevocationList, now: u64) -> Result<(), Rejection> {
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

/// Checks that a list follows the one before. `ended` answers whether the certificate with this serial number is known to have
/// ended.
pub(super) fn check(before: &Kept, list: &RevocationList, ended: &dyn Fn(&[u8]) -> bool) -> Result<(), Rejection> {
    if list.this_update < before.this_update && !active(Mutation::TakeAnOlderList) {
        return Err(old("the revocation list is older than the one that the ledger has")
            .found(format!("made at {} µs", list.this_update))
            .wanted(format!("made at {} µs or later", before.this_update)));
    }
    let number = list.number.as_ref().map(hex::encode);
    if let Some(known) = before.number.as_ref()
        && number.as_ref().is_none_or(|number| in_order(number) <= in_order(known))
    {
        return Err(old("the number of the revocation list does not grow")
            .found(number.unwrap_or_else(|| "no number".to_owned()))
            .wanted(format!("a number above {known}")));
    }
    let missing: Vec<_> = before.serials.difference(&list.serials).filter(|serial| !ended(serial)).collect();
    if missing.is_empty() {
        return Ok(());
    }
    let shown: Vec<_> = missing.iter().take(SHOWN_MAX).map(hex::encode).collect();
    let more = if missing.len() > SHOWN_MAX { ", ..." } else { "" };
    Err(old("the revocation list leaves out certificates that were revoked")
        .found(format!("{} fewer: serial {}{more}", missing.len(), shown.join(", ")))
        .wanted("every certificate of the list before, unless it is known to have ended")
        .next(
            "have the CA make a list with them (Fabric: fabric-ca-client gencrl --expireafter TIME), or show the ended \
             certificates: ledgerctl identity crl FILE --ended CERTIFICATE",
        ))
}

/// Numbers in hexadecimal without leading zeros, in the order of the numbers.
fn in_order(number: &str) -> (usize, &str) {
    (number.len(), number)
}

fn old(message: &str) -> Rejection {
    Rejection::new(Code::OldList, message)
}
