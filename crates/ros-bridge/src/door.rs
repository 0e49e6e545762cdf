//! The door in front of the ledger: what came from it does not enter again.
//!
//! One message of a user would otherwise go round for ever, where a bridge that brings a service into a graph and one
//! that takes it from there meet: each round signed anew, so never too old, and each of them a use of the grant.
//!
//! - **Bridges.** What a bridge of the same network has published is not taken in: it carries a [`Mark`].
//! - **Others that pass messages on** (a relay, a multiplexer, a bridge between domains) carry none. So the door remembers
//!   what was delivered to this graph: by this process, or by other bridges as far as it hears them. A publisher that never
//!   sent anything but what had been delivered shortly before is one of those, and is not taken in either. Whoever has sent
//!   something of their own once is a source, and may repeat itself, or others, as often as they like: constant commands
//!   are the normal case.
//!
//! A node that mixes its own commands with what the ledger delivered, under one publisher, cannot be told from a source.

use std::{
    collections::{BTreeSet, HashMap, HashSet, VecDeque},
    hash::{BuildHasher, RandomState},
    sync::{Arc, Mutex, MutexGuard, PoisonError, atomic::AtomicU64, atomic::Ordering},
    time::{Duration, Instant},
};

use crate::{count::Complaint, mark::Mark};

/// A payload is remembered at least so long, also where messages grow old sooner: relays may be slow.
const REMEMBERED_MIN: Duration = Duration::from_secs(1);
/// Most payloads remembered, of all services; beyond it the oldest are forgotten.
const PAYLOADS_MAX: usize = 16 * 1024;
/// Most sources remembered by a door; beyond it all have to show themselves again.
const SOURCES_MAX: usize = 4096;

/// Who published a sample: the GUID of a DDS writer, or the origin in shared memory.
type Source = [u8; 16];

/// What was delivered to the local graph, shared by all routes of a bridge.
#[derive(Debug, Default)]
pub struct Delivered {
    window: Mutex<Window>,
    hasher: RandomState,
}

#[derive(Debug, Default)]
struct Window {
    /// How long payloads of a service count; only these are remembered.
    wanted: HashMap<Mark, Duration>,
    /// Services that some bridge delivers to this graph, as far as is known.
    delivering: HashSet<Mark>,
    last: HashMap<(Mark, u64), Instant>,
    order: VecDeque<(Instant, Mark, u64)>,
}

impl Delivered {
    /// Payloads of this service shall be remembered so long.
    fn want(&self, service: Mark, remembered: Duration) {
        self.lock().wanted.insert(service, remembered);
    }

    /// A bridge delivers this service to the graph. True if that is news.
    pub fn begins(&self, service: Mark) -> bool {
        self.lock().delivering.insert(service)
    }

    /// A payload was, or is about to be, delivered to the graph.
    pub fn note(&self, service: Mark, payload: &[u8], now: Instant) {
        if !self.lock().wanted.contains_key(&service) {
            return;
        }
        let hash = self.hasher.hash_one(payload);
        let mut window = self.lock();
        window.delivering.insert(service);
        window.last.insert((service, hash), now);
        window.order.push_back((now, service, hash));
        while window.order.len() > PAYLOADS_MAX || window.is_first_old(now) {
            let Some((noted, service, hash)) = window.order.pop_front() else { break };
            if window.last.get(&(service, hash)) == Some(&noted) {
                window.last.remove(&(service, hash));
            }
        }
    }

    fn is_delivering(&self, service: Mark) -> bool {
        self.lock().delivering.contains(&service)
    }

    fn holds(&self, service: Mark, hash: u64, remembered: Duration, now: Instant) -> bool {
        let noted = self.lock().last.get(&(service, hash)).copied();
        noted.is_some_and(|noted| now.saturating_duration_since(noted) <= remembered)
    }

    fn lock(&self) -> MutexGuard<'_, Window> {
        self.window.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Window {
    fn is_first_old(&self, now: Instant) -> bool {
        self.order.front().is_some_and(|(noted, service, _)| {
            let remembered = self.wanted.get(service).copied().unwrap_or(REMEMBERED_MIN);
            now.saturating_duration_since(*noted) > remembered
        })
    }
}

/// What the door decides on a sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Entry {
    /// It may go to the ledger.
    Admit,
    /// A bridge of this network published it.
    FromBridge,
    /// Its publisher only passes on what the ledger delivered.
    PassedOn,
}

/// The door of a route to the ledger. DDS and shared memory have the same one.
#[derive(Debug)]
pub struct Door {
    mark: Mark,
    service: String,
    remembered: Duration,
    delivered: Arc<Delivered>,
    returned: AtomicU64,
    known: Mutex<Known>,
}

#[derive(Debug, Default)]
struct Known {
    /// Who has sent something of their own.
    sources: BTreeSet<Source>,
    /// Who took a payload to the ledger last, and when.
    taken: HashMap<u64, (Source, Instant)>,
    complaint: Complaint,
}

impl Door {
    /// The door of a service whose messages count for `max_age`.
    pub fn new(mark: Mark, service: &str, max_age: Duration, delivered: Arc<Delivered>) -> Self {
        let remembered = max_age.max(REMEMBERED_MIN);
        delivered.want(mark, remembered);
        let (service, known) = (service.to_owned(), Mutex::default());
        Self { mark, service, remembered, delivered, returned: AtomicU64::new(0), known }
    }

    /// The mark of the service.
    pub fn mark(&self) -> Mark {
        self.mark
    }

    /// Samples that came from the ledger, and were kept out.
    pub fn returned(&self) -> u64 {
        self.returned.load(Ordering::Relaxed)
    }

    /// A bridge that delivers this was discovered in the graph.
    pub fn hear_of(&self, mark: Mark) {
        if mark == self.mark {
            self.delivered.begins(mark);
        }
    }

    /// Decides on a sample; `mark` is its publisher's.
    pub fn judge(&self, source: Source, mark: Option<Mark>, payload: &[u8], now: Instant) -> Entry {
        if let Some(mark) = mark.filter(|mark| mark.is_of_network_of(self.mark)) {
            self.delivered.note(mark, payload, now);
            self.refuse("bridge", "a bridge of this network published it", now);
            return Entry::FromBridge;
        }
        if !self.delivered.is_delivering(self.mark) {
            // Nothing can come back: whoever publishes now is a source.
            self.lock().add(source);
            return Entry::Admit;
        }
        let hash = self.delivered.hasher.hash_one(payload);
        let was_delivered = self.delivered.holds(self.mark, hash, self.remembered, now);
        let mut known = self.lock();
        let was_taken = known
            .taken
            .get(&hash)
            .is_some_and(|(taker, when)| *taker != source && now.saturating_duration_since(*when) <= self.remembered);
        if (was_delivered || was_taken) && !known.sources.contains(&source) {
            drop(known);
            self.refuse("relay", "its publisher only passes on what came from the ledger", now);
            return Entry::PassedOn;
        }
        known.add(source);
        if known.taken.len() >= PAYLOADS_MAX {
            known.taken.retain(|_, (_, when)| now.saturating_duration_since(*when) <= self.remembered);
            if known.taken.len() >= PAYLOADS_MAX {
                known.taken.clear();
            }
        }
        known.taken.insert(hash, (source, now));
        Entry::Admit
    }

    fn refuse(&self, kind: &'static str, reason: &str, now: Instant) {
        self.returned.fetch_add(1, Ordering::Relaxed);
        let worth = self.lock().complaint.worth(kind, now);
        if let Some(not_logged) = worth {
            let service = &self.service;
            tracing::warn!(service, reason, not_logged, "a sample that came from the ledger is not taken in again");
        }
    }

    fn lock(&self) -> MutexGuard<'_, Known> {
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Known {
    fn add(&mut self, source: Source) {
        if self.sources.len() >= SOURCES_MAX && !self.sources.contains(&source) {
            self.sources.clear();
        }
        self.sources.insert(source);
    }
}

#[cfg(test)]
mod tests;
