//! Governing writes are refused, or written as they were read; the chain over them takes them in one order only.
#![no_main]

use ledger_base::hash::Hash;
use ledger_light::Change;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    if let Ok(change) = Change::from_bytes(1, bytes) {
        assert_eq!(&change.to_bytes()[..], bytes);
        let ascending = change.writes.is_sorted_by(|(one, _), (next, _)| one < next);
        assert_eq!(change.extend(Hash::ZERO).is_ok(), ascending);
    }
});
