//! A message of another node's ordering is refused, or says the same when it is written again.
#![no_main]

use bytes::Bytes;
use ledger_raft::PeerMessage;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    if let Ok(message) = PeerMessage::decode(Bytes::copy_from_slice(bytes)) {
        let again = message.to_bytes();
        assert_eq!(PeerMessage::decode(again.clone()).map(|message| message.to_bytes()), Ok(again));
    }
});
