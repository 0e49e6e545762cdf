//! A statement is refused, or written as it was read.
#![no_main]

use ledger_light::Statement;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    if let Ok(read) = Statement::from_bytes(bytes) {
        assert_eq!(&read.to_bytes()[..], bytes);
    }
});
