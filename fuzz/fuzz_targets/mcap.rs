//! A recording is read to its end, or to the place where it is damaged.
#![no_main]

#[expect(dead_code, reason = "only whether it is read counts here")]
#[path = "../../crates/cli/src/recording/items.rs"]
mod items;

use items::Reader;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let mut reader = Reader::new(bytes);
    let mut items = 0;
    while let Ok(Some(_)) = reader.read() {
        items += 1;
        assert!(items <= bytes.len(), "more items than bytes");
    }
});
