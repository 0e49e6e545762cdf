//! Results of pure functions that the nodes of one simulated cluster share.
//!
//! A simulated cluster runs in one thread, and each of its nodes verifies the same signatures and evaluates the same policies. A second
//! computation is only work: both took more than half of the simulation's time.
//!
//! The table is compiled in where the deliberate bugs are ([`crate::mutation`]). In a release, [`verified`] and [`shared`] are
//! the computation and nothing else.

use crate::hash::Hash;
use std::any::Any;
use std::cell::RefCell;
use std::collections::HashMap;

/// Most results that a thread keeps. They are dropped together when one more arrives.
const RESULTS_MAX: usize = 1 << 16;

type Results = HashMap<Hash, Box<dyn Any>>;

thread_local! {
    static RESULTS: RefCell<Option<Results>> = const { RefCell::new(None) };
}

/// From now on, this thread computes each result once, or each time. Nothing is known from before. Other threads are not affected.
pub fn share(is_shared: bool) {
    RESULTS.set(is_shared.then(HashMap::new));
}

/// The result of `verify`, a function of the bytes in `of` alone. The bytes name the function, too.
pub fn verified(of: &[&[u8]], verify: impl FnOnce() -> bool) -> bool {
    let key = |of: &&[&[u8]]| {
        let lengths: Vec<u8> = of.iter().flat_map(|part| part.len().to_le_bytes()).collect();
        let parts: Vec<&[u8]> = std::iter::once(lengths.as_slice()).chain(of.iter().copied()).collect();
        Hash::of(&parts)
    };
    shared(of, key, |_| Ok::<_, std::convert::Infallible>(verify())).unwrap_or_else(|never| match never {})
}

/// The result of `compute`, a function of what `key` hashes of the input. The hash is also over a name of the function. A failure is
/// computed each time.
///
/// # Errors
/// Those of `compute`.
pub fn shared<I, T: Clone + 'static, E>(
    input: I,
    key: impl FnOnce(&I) -> Hash,
    compute: impl FnOnce(I) -> Result<T, E>,
) -> Result<T, E> {
    if !crate::mutation::COMPILED_IN || RESULTS.with_borrow(Option::is_none) {
        return compute(input);
    }
    let key = key(&input);
    let known = RESULTS.with_borrow(|results| {
        let result = results.as_ref()?.get(&key)?;
        result.downcast_ref::<T>().cloned()
    });
    if let Some(known) = known {
        return Ok(known);
    }
    let result = compute(input)?;
    RESULTS.with_borrow_mut(|results| {
        if let Some(results) = results {
            if results.len() >= RESULTS_MAX {
                results.clear();
            }
            results.insert(key, Box::new(result.clone()));
        }
    });
    Ok(result)
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
        share(true);
        assert!(ask(&[b"key", b"message"], true));
        assert!(ask(&[b"key", b"message"], false), "the first result stands");
        assert!(!ask(&[b"keym", b"essage"], false), "the same bytes in other parts are another question");
        assert!(!ask(&[b"key", b"message", b""], false));
        assert_eq!(computed.get(), 3);
        share(false);
        assert!(!ask(&[b"key", b"message"], false), "it is computed again");
    }

    #[test]
    fn a_failure_is_not_kept() {
        share(true);
        let ask = |result: Result<u8, &'static str>| shared((), |()| Hash::of(&[b"seven"]), |()| result);
        assert_eq!(ask(Err("not now")), Err("not now"));
        assert_eq!((ask(Ok(7)), ask(Err("not now"))), (Ok(7), Ok(7)));
    }
}
