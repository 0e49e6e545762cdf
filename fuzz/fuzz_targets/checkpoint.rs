//! A checkpoint is refused, or written as it was read; its reader can ask who governs.
#![no_main]

use ledger_light::Checkpoint;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    if let Ok(checkpoint) = Checkpoint::from_bytes(&ledger_fuzz::network(), bytes) {
        assert_eq!(&checkpoint.to_bytes()[..], bytes);
        let governance = &checkpoint.governance;
        let _ = (governance.voters(), governance.msps(), governance.revocations().count());
        let _ = governance.check(&checkpoint.proof.certificate);
    }
});
