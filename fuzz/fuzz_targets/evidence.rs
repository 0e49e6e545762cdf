//! Evidence is refused, or written as it was read. Nothing is proved by it that the evidence of the vectors does not prove.
#![no_main]

use ledger::evidence::Evidence;
use ledger_base::hash::Hash;
use ledger_fuzz::EVIDENCE;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    if let Ok(evidence) = Evidence::from_bytes(bytes) {
        assert_eq!(&evidence.to_bytes()[..], bytes);
    }
    // The same with the hash at the end that belongs to it: as somebody makes it who wants to be believed.
    let whole = [bytes, &Hash::of(&[bytes]).0].concat();
    if let Ok(evidence) = Evidence::from_bytes(&whole) {
        if let Ok(proved) = evidence.check(&EVIDENCE.genesis, None) {
            assert!(EVIDENCE.proved.contains(&proved.transaction.id()));
        }
    }
});
