//! An engine that takes back a promise is found out.

use super::*;

#[test]
#[should_panic(expected = "acknowledged blocks are on the disk; found block 1, the disk has 0")]
fn a_driver_that_says_flushed_before_it_flushed_is_found_out() {
    let mut engine = engine(1, &[1], &[]);
    let mut out = Vec::new();
    engine.step(1000, Input::Tick, &mut out);
    let flushes: Vec<u64> = out
        .iter()
        .filter_map(|output| if let Output::Flush { ready } = output { Some(*ready) } else { None })
        .collect();
    for ready in flushes {
        engine.step(1000, Input::Persisted { ready }, &mut out);
    }
}

#[test]
#[should_panic(expected = "only committed blocks are handed out")]
fn a_block_that_is_handed_out_and_not_committed_is_found_at_the_next_step() {
    let mut engine = leader(1);
    engine.emitted += 5;
    step(&mut engine, Input::Tick);
}
