//! A proof of misbehaviour is refused, or written as it was read; that of a lie proves nothing of a node that has not lied.
#![no_main]

use ledger_fuzz::{MSPS, TOLD};
use ledger_light::{DoubleHead, Misbehaviour};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    if let Ok(proof) = Misbehaviour::from_bytes(bytes) {
        assert_eq!(&proof.to_bytes()[..], bytes);
        if let Misbehaviour::Lie(lie) = proof {
            let proved = lie.verify(|der, time| Ok(MSPS.verify(der, &[], time)?)).is_ok();
            assert!(!proved || [lie.first, lie.second].iter().all(|said| TOLD.contains(&said.statement)));
        }
    }
    if let Ok(heads) = DoubleHead::from_bytes(bytes) {
        assert!(heads.verify(|der, time| Ok(MSPS.verify(der, &[], time)?)).is_err(), "nobody has signed a head");
    }
});
