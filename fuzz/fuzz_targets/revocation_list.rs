//! A revocation list in DER is refused, or read within limits, and an organisation that has not signed it refuses it.
#![no_main]

use ledger_identity::msp::Msp;
use ledger_identity::revocation_list::{LISTED_MAX, RevocationList};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    if let Ok(list) = RevocationList::parse(bytes) {
        assert!(list.serials.len() <= LISTED_MAX);
        assert!(list.next_update.is_none_or(|next| next >= list.this_update));
    }
    // The same bytes as a root of an organisation: hardly ever one, and never one that panics.
    if let Ok(msp) = Msp::new("Org3", &[bytes], &[] as &[&[u8]]) {
        let _ = msp.verify_list(bytes);
    }
});
