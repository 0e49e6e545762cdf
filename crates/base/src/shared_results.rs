//! Results of pure functions that the nodes of one simulated cluster share.
//!
//! A simulated cluster runs in one thread, and each of its nodes verifies the same signatures. The answer is a function of
//! key, message and signature, so a second computation is only work: it took a third of the simulation's time.
//!
//! The table is compiled in where the deliberate bugs are ([`crate::mutation`]). In a release, [`verified`] is the
//! computation and nothing else.

use crate::hash::Hash;
use std::cell::RefCell;
use std::collections::HashMap;

/// Most results that a thread keeps. They are dropped together when one more arrives.
const RESULTS_MAX: usize = 1 << 16;

thread_local! {
    static RESULTS: RefCell<Option<HashMap<Hash, bool>>> = const { RefCell::new(None) };
}

/// From now on, this thread computes each result once. Other threads are not affected.
pub fn share() {
    RESULTS.with_borrow_mut(|results| {
        results.get_or_insert_default();
    });
}

/// The result of `verify`, a function of the bytes in `of` alone. The bytes name the function, too.
pub fn verified(of: &[&[u8]], verify: impl FnOnce() -> bool) -> bool {
    if !crate::mutation::COMPILED_IN || RESULTS.with_borrow(Option::is_none) {
        return verify();
    }
    let lengths: Vec<u8> = of.iter().flat_map(|part| part.len().to_le_bytes()).collect();
    let parts: Vec<&[u8]> = std::iter::once(lengths.as_slice()).chain(of.iter().copied()).collect();
    let key = Hash::of(&parts);
    if let Some(known) = RESULTS.with_borrow(|results| results.as_ref().and_then(|results| results.get(&key).copied()))
    {
        return known;
    }
    let result = verify();
    RESULTS.with_borrow_mut(|results| {
        if let Some(results) = results {
            if results.len() >= RESULTS_MAX {
                results.clear();
            }
            results.insert(key, result);
        }
    });
    result
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::Cell;

    #[test]
    fn a_result_is_computed_once_for_the_same_bytes_and_again_for_others() {
        let computed = Cell::new(0);
        let ask = |of: &[&[u8]], result| {
            verified(of, || {
                computed.set(computed.get() + 1);
                result
            })
        };
        // Nothing is shared before it is asked for.
        assert!(ask(&[b"key", b"message"], true));
        assert!(!ask(&[b"key", b"message"], false));
        assert_eq!(computed.replace(0), 2);
        share();
        assert!(ask(&[b"key", b"message"], true));
        assert!(ask(&[b"key", b"message"], false), "the first result stands");
        assert!(!ask(&[b"keym", b"essage"], false), "the same bytes in other parts are another question");
        assert!(!ask(&[b"key", b"message", b""], false));
        assert_eq!(computed.get(), 3);
    }
}
