//! Recent answers of the store, so that a key that every block reads, such as a robot's, is not asked for every time.

use crate::state::WriteSet;
use bytes::Bytes;
use std::collections::HashMap;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Most bytes of keys and values; when they are more, all are forgotten.
const CACHE_BYTES_MAX: usize = 2 * 1024 * 1024;
/// Longer values are not kept, in bytes.
const VALUE_BYTES_MAX: usize = 64 * 1024;
const _: () = assert!(VALUE_BYTES_MAX * 8 <= CACHE_BYTES_MAX);
/// Bytes that every entry is taken to cost besides its own.
const OVERHEAD_BYTES: usize = 100;

/// Values by key, `None` where the store has none.
#[derive(Default)]
pub(super) struct Cache(Mutex<Entries>);

#[derive(Default)]
struct Entries {
    values: HashMap<Bytes, Option<Bytes>>,
    bytes: usize,
}

impl Cache {
    /// The value of a key in the store, if it is known.
    pub(super) fn get(&self, key: &[u8]) -> Option<Option<Bytes>> {
        self.lock().values.get(key).cloned()
    }

    /// Takes note of what the store said.
    pub(super) fn keep(&self, key: &[u8], value: &Option<Bytes>) {
        if value.as_ref().is_some_and(|value| value.len() > VALUE_BYTES_MAX) {
            return;
        }
        let mut entries = self.lock();
        let bytes = weight(key, value);
        if entries.bytes + bytes > CACHE_BYTES_MAX {
            *entries = Entries::default();
        }
        if entries.values.insert(Bytes::copy_from_slice(key), value.clone()).is_none() {
            entries.bytes += bytes;
        }
    }

    /// The store has other values now.
    pub(super) fn forget(&self, written: &WriteSet) {
        let mut entries = self.lock();
        for key in written.keys() {
            if let Some((key, value)) = entries.values.remove_entry(key) {
                entries.bytes -= weight(&key, &value);
            }
        }
    }

    fn lock(&self) -> MutexGuard<'_, Entries> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn weight(key: &[u8], value: &Option<Bytes>) -> usize {
    key.len() + value.as_ref().map_or(0, Bytes::len) + OVERHEAD_BYTES
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_is_bounded_and_counted_right() {
        let cache = Cache::default();
        let value = Some(Bytes::from(vec![7; VALUE_BYTES_MAX]));
        for number in 0..1000u32 {
            let key = (number % 40).to_be_bytes();
            cache.keep(&key, &value);
            if number % 3 == 0 {
                cache.forget(&WriteSet::from([(Bytes::copy_from_slice(&key), None)]));
                assert_eq!(cache.get(&key), None);
            }
            let entries = cache.lock();
            let bytes: usize = entries.values.iter().map(|(key, value)| weight(key, value)).sum();
            assert!(entries.bytes == bytes && bytes <= CACHE_BYTES_MAX);
        }
        cache.keep(b"large", &Some(Bytes::from(vec![7; VALUE_BYTES_MAX + 1])));
        assert_eq!(cache.get(b"large"), None);
    }
}
