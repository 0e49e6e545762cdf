//! The certified part of a branch is refused, or written as it was read; then its headers lead to the certified block.
#![no_main]

use ledger::branch::CertifiedBranch;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    if let Ok(branch) = CertifiedBranch::from_bytes(bytes) {
        assert_eq!(&branch.to_bytes()[..], bytes);
        let statement = &branch.certificate().statement;
        assert!(branch.height() <= statement.height);
        assert!(branch.height() < statement.height || branch.block() == statement.block);
    }
});
