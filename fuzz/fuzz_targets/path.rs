//! A Merkle path is refused, or written as it was read. It leads from no leaf to a root that it does not compute.
#![no_main]

use ledger_base::hash::Hash;
use ledger_light::merkle::Path;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    if let Ok(path) = Path::from_bytes(bytes) {
        assert_eq!(path.to_bytes(), bytes);
        assert!(path.count == 1 || !path.leads(Hash::ZERO, Hash::ZERO));
    }
});
