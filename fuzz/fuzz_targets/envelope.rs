//! An envelope is refused, or written as it was read; and what nobody sealed is never opened.
#![no_main]

use ledger_base::hash::Hash;
use ledger_confidential::{Keyring, ReadingKey};
use ledger_contract::{Envelope, Share};
use libfuzzer_sys::fuzz_target;
use std::sync::LazyLock;

static OWN: LazyLock<ReadingKey> = LazyLock::new(|| ReadingKey::from_secret(&[3; 32]).expect("a key"));

fuzz_target!(|bytes: &[u8]| {
    let mut keyring = Keyring::new(Hash::ZERO, "Org1/Salma".into(), OWN.clone());
    // A share in front, if there is one, then the envelope.
    let (share, envelope) = match bytes.iter().position(|byte| *byte == b'\n') {
        Some(end) => (&bytes[..end], &bytes[end + 1..]),
        None => (&bytes[..0], bytes),
    };
    if let Ok(share) = serde_json::from_slice::<Share>(share) {
        keyring.learn("Husky/front", "Org2/Husky", 7, &share);
    }
    if let Some(read) = Envelope::parse(envelope) {
        let written = [Envelope::head(read.key, &read.nonce), read.sealed.to_vec()].concat();
        assert_eq!(written, envelope);
        assert!(keyring.open("Husky/front", "Org2/Husky", 1, 1, envelope).is_err());
    }
});
