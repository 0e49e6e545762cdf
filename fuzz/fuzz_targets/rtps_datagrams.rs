//! A DDS participant with matched endpoints takes a sequence of datagrams, samples and time: what it keeps and sends is bounded, and
//! nothing comes out of writers that do not match.
//!
//! The bytes: steps, each with a kind, an argument, the number of its bytes in two bytes, little endian, and its bytes.
#![no_main]

use ledger_fuzz::dds::{OTHERS, World};
use libfuzzer_sys::fuzz_target;

/// Most steps of an input.
const STEPS_MAX: usize = 200;

fuzz_target!(|bytes: &[u8]| {
    let mut world = World::new();
    let mut rest = bytes;
    for _ in 0..STEPS_MAX {
        let [kind, argument, low, high, content @ ..] = rest else { return };
        let length = usize::from(u16::from_le_bytes([*low, *high]));
        let (content, behind) = content.split_at(length.min(content.len()));
        match kind % 8 {
            0..=4 => world.receive(1 + argument % OTHERS, content, argument / OTHERS),
            5 => world.write(*argument, 4 + length * 16),
            6 => world.wait(u64::try_from(length).unwrap_or_default() << (argument % 12)),
            _ => world.assert_liveliness(*argument),
        }
        // Of a step that takes no bytes only the head goes.
        rest = if kind % 8 <= 4 { behind } else { &rest[4..] };
    }
    world.wait(1_000_000);
});
