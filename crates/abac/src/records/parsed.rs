//! The meaning of values of the state, remembered, so that a value which has not changed is not parsed again.
//!
//! The state is asked every time, and a record counts only for exactly the bytes that it was parsed from. So what is
//! remembered saves time and never changes an answer, in simulated calls and in executed ones.

use bytes::Bytes;
use ledger::Context;
use ledger_base::rejection::Rejection;
use quick_cache::Weighter;
use quick_cache::unsync::Cache;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Most bytes of keys and values that are remembered.
const BYTES_MAX: u64 = 4 * 1024 * 1024;

/// Bytes of a record that is expected; how many records there is room for follows from it.
const RECORD_BYTES: u64 = 512;

/// Values of one kind by their keys.
pub(crate) struct Parsed<T>(Mutex<Known<T>>);

type Known<T> = Cache<Vec<u8>, (Bytes, Arc<T>), ByBytes>;

/// A record weighs as much as its key and value.
struct ByBytes;

impl<T> Weighter<Vec<u8>, (Bytes, Arc<T>)> for ByBytes {
    fn weight(&self, key: &Vec<u8>, (value, _): &(Bytes, Arc<T>)) -> u64 {
        (key.len() + value.len()) as u64
    }
}

impl<T> Default for Parsed<T> {
    fn default() -> Self {
        Self(Mutex::new(Cache::with_weighter((BYTES_MAX / RECORD_BYTES) as usize, BYTES_MAX, ByBytes)))
    }
}

impl<T> Parsed<T> {
    /// The value of a key now, parsed now or before; none if the state has none.
    ///
    /// # Errors
    /// The result of `parse`, which gets key and value.
    pub(crate) fn read(
        &self,
        ctx: &Context<'_>,
        key: &[u8],
        parse: impl FnOnce(&[u8], &[u8]) -> Result<T, Rejection>,
    ) -> Result<Option<Arc<T>>, Rejection> {
        let Some(value) = ctx.get(key) else { return Ok(None) };
        if let Some((bytes, record)) = self.lock().get(key)
            && same(bytes, &value)
        {
            return Ok(Some(Arc::clone(record)));
        }
        let record = Arc::new(parse(key, &value)?);
        self.lock().insert(key.to_vec(), (value, Arc::clone(&record)));
        Ok(Some(record))
    }

    fn lock(&self) -> MutexGuard<'_, Known<T>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Mostly it is the same memory, which then need not be looked at.
fn same(a: &Bytes, b: &Bytes) -> bool {
    (a.as_ptr() == b.as_ptr() && a.len() == b.len()) || a == b
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use ledger::{Environment, Meter, Registry, Rules};
    use ledger_base::hash::Hash;
    use ledger_storage::state::MemoryState;
    use ledger_storage::state::Overlay;
    use std::cell::Cell;

    /// Runs `body` in a context in which keys can be written.
    fn in_context(body: impl FnOnce(&mut Context<'_>)) {
        let registry = Registry::new();
        let environment = Environment {
            registry: &registry,
            submitter: None,
            network: Hash::ZERO,
            rules: Rules::NEWEST,
            height: 1,
            time: 0,
            transaction: Hash::ZERO,
            executed: &|_, _| false,
            meter: &Meter::of_query(),
        };
        let (mut overlay, mut events) = (Overlay::new(Arc::new(MemoryState::default())), Vec::new());
        body(&mut Context::new(environment, "abac", &mut overlay, &mut events));
    }

    #[test]
    fn a_value_is_parsed_once_and_again_when_it_changes_or_comes_back() {
        in_context(|ctx| {
            let (records, parsed) = (Parsed::default(), Cell::new(0));
            let read = |ctx: &Context<'_>| {
                let parse = |_: &[u8], value: &[u8]| {
                    parsed.set(parsed.get() + 1);
                    Ok(value.to_vec())
                };
                records.read(ctx, b"key", parse).unwrap().map(|value| value.to_vec())
            };
            assert_eq!(read(ctx), None);
            for (value, times) in [(b"1", 1), (b"2", 2), (b"1", 3)] {
                ctx.put(b"key", value.to_vec());
                assert_eq!(read(ctx).as_deref(), Some(&value[..]));
                assert_eq!(read(ctx).as_deref(), Some(&value[..]));
                assert_eq!(parsed.get(), times);
            }
            ctx.delete(b"key");
            assert_eq!(read(ctx), None, "what is remembered does not outlive the key");
        });
    }

    #[test]
    fn memory_is_bounded() {
        in_context(|ctx| {
            let records = Parsed::default();
            let value = vec![7; (BYTES_MAX / 8) as usize];
            for number in 0..100u32 {
                let key = number.to_be_bytes();
                ctx.put(&key, value.clone());
                records.read(ctx, &key, |_, value| Ok(value.len())).unwrap();
                let known = records.lock();
                let bytes: usize = known.iter().map(|(key, (value, _))| key.len() + value.len()).sum();
                assert!(bytes > 0 && bytes as u64 <= BYTES_MAX, "{bytes}");
            }
        });
    }
}
