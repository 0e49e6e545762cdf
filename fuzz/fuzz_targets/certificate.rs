//! A certificate is refused, or written as it was read; it is good only for a statement that was signed.
#![no_main]

use ledger_fuzz::{READERS, SIGNED};
use ledger_light::Certificate;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    if let Ok(certificate) = Certificate::from_bytes(bytes) {
        assert_eq!(&certificate.to_bytes()[..], bytes);
        let good = READERS.iter().any(|reader| reader.check(&certificate).is_ok());
        assert!(!good || SIGNED.contains(&certificate.statement));
    }
});
