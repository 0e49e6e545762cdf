//! The payload of a block, and a result, are refused, or say the same when they are written again.
#![no_main]

use bytes::Bytes;
use ledger::block::Payload;
use ledger_storage::result::BlockResult;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let bytes = Bytes::copy_from_slice(bytes);
    if let Ok(payload) = Payload::from_bytes(bytes.clone()) {
        assert_eq!(Payload::from_bytes(payload.to_bytes()), Ok(payload));
    }
    if let Ok(result) = BlockResult::from_bytes(bytes) {
        assert_eq!(BlockResult::from_bytes(result.to_bytes()), Ok(result));
    }
});
