//! Every message of the proto files is refused, or says the same when it is written again.
//!
//! The bytes: the number of the message in the list, its content.
#![no_main]

use ledger_fuzz::messages;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let [number, content @ ..] = bytes else { return };
    let (name, round) = messages::ALL[usize::from(*number) % messages::ALL.len()];
    assert!(round(content), "{name} says something else when it is written again");
});
