//! A fact is refused, or written as it was read.
#![no_main]

use ledger_light::fact::Fact;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    if let Ok(read) = Fact::from_bytes(bytes) {
        assert_eq!(&read.to_bytes()[..], bytes);
    }
});
