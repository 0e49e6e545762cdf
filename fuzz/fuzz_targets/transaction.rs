//! A transaction from the wire is refused, or kept byte for byte.
#![no_main]

use bytes::Bytes;
use ledger::transaction::Transaction;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let bytes = Bytes::copy_from_slice(bytes);
    if let Ok(transaction) = Transaction::decode(bytes.clone()) {
        assert_eq!(transaction.encoded(), &bytes);
        let _ = (transaction.id(), transaction.check_time(0));
    }
});
