//! Addresses from which members have come.

use std::collections::HashMap;
use std::net::IpAddr;
use std::sync::{Mutex, PoisonError};

/// Most addresses that are remembered; beyond it the one that was seen longest ago is forgotten.
const SOURCES_MAX: usize = 4096;

/// The addresses, and when each was seen last.
#[derive(Default)]
pub(super) struct Sources {
    seen: Mutex<Seen>,
}

#[derive(Default)]
struct Seen {
    sources: HashMap<IpAddr, u64>,
    count: u64,
}

impl Sources {
    /// A member has come from there.
    pub(super) fn note(&self, source: IpAddr) {
        let mut seen = self.seen.lock().unwrap_or_else(PoisonError::into_inner);
        seen.count += 1;
        let count = seen.count;
        if seen.sources.len() >= SOURCES_MAX
            && !seen.sources.contains_key(&source)
            && let Some(oldest) = seen.sources.iter().min_by_key(|(_, seen)| **seen).map(|(source, _)| *source)
        {
            seen.sources.remove(&oldest);
        }
        seen.sources.insert(source, count);
    }

    /// Has a member come from there?
    pub(super) fn is_known(&self, source: IpAddr) -> bool {
        self.seen.lock().unwrap_or_else(PoisonError::into_inner).sources.contains_key(&source)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_remembered_up_to_a_limit_and_the_oldest_is_forgotten() {
        let sources = Sources::default();
        let address = |number: usize| IpAddr::from((number as u32).to_be_bytes());
        (0..SOURCES_MAX).for_each(|number| sources.note(address(number)));
        sources.note(address(0));
        sources.note(address(SOURCES_MAX));
        assert!(sources.is_known(address(0)) && sources.is_known(address(SOURCES_MAX)));
        assert!(!sources.is_known(address(1)), "it was seen longest ago");
    }
}
