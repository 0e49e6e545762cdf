//! A proof is refused, or written as it was read; its facts can be asked for.
#![no_main]

use ledger_light::Proof;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    if let Ok(proof) = Proof::from_bytes(bytes) {
        assert_eq!(&proof.to_bytes()[..], bytes);
        let _ = (proof.ground(), proof.others());
    }
});
