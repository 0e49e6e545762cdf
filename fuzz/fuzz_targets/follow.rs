//! A reader that has begun at a genesis goes on to no block but one that voters have signed.
//!
//! The bytes: the number of the beginning, the number of changes, each change (height u64, length u32, writes), the proof.
#![no_main]

use ledger_fuzz::{READERS, SIGNED};
use ledger_light::{Change, Proof};
use libfuzzer_sys::fuzz_target;

fn change<'a>(bytes: &mut &'a [u8]) -> Option<(u64, &'a [u8])> {
    let height = u64::from_be_bytes(*bytes.split_off(..8)?.as_array()?);
    let length = u32::from_be_bytes(*bytes.split_off(..4)?.as_array()?);
    Some((height, bytes.split_off(..length as usize)?))
}

fuzz_target!(|bytes: &[u8]| {
    let [begin, count, rest @ ..] = bytes else { return };
    let (reader, mut rest) = (&READERS[usize::from(*begin) % READERS.len()], rest);
    let mut changes = Vec::new();
    for _ in 0..count % 8 {
        let Some((height, writes)) = change(&mut rest) else { return };
        let Ok(change) = Change::from_bytes(height, writes) else { return };
        changes.push(change);
    }
    let Ok(proof) = Proof::from_bytes(rest) else { return };
    if let Ok(after) = reader.follow(&changes, &proof) {
        let statement = proof.certificate.statement;
        assert!(SIGNED.contains(&statement), "nobody has signed {statement:?}");
        assert_eq!((after.height(), after.time()), (statement.height, statement.time));
        assert_eq!(Ok(after.chain()), proof.ground().map(|ground| ground.governing));
    }
});
