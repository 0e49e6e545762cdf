//! The filter in front of the ledger: what came from it does not enter again.
//!
//! Where a bridge that brings a service into a graph meets one that takes it from there, a message of a user would go
//! round for ever. Each round would be signed anew, so it would never be too old, and would use the grant.
//!
//! - **Bridges.** A sample of a bridge of the same network is not taken in: it carries a [`Mark`].
//! - **Others that pass messages on** (a relay, a bridge between domains) carry none. So the filter remembers what was
//!   delivered to this graph: by this process, or by other bridges as far as it hears them; and what it has let in. Each of
//!   these explains one repetition of the same payload by another publisher, and the repetition is not taken in. A publisher
//!   whose payload nothing explains is a source. From then on it may repeat itself, or others, without limit: constant
//!   commands are the normal case.
//! - **A stop must not be lost.** The first sample of a publisher that was quiet is taken in, unless the same was delivered
//!   just now: it may be somebody who stops the robot with one message. One sample makes no loop.
//!
//! A node that mixes its own commands with what the ledger delivered, under one publisher, cannot be told from a
//! source.

use std::{
    collections::{BTreeMap, HashMap, HashSet, VecDeque},
    hash::{BuildHasher, RandomState},
    sync::{Arc, Mutex, MutexGuard, PoisonError, atomic::AtomicU64, atomic::Ordering},
    time::{Duration, Instant},
};

use ledger_gate::sample::HEADER_BYTES;

use super::mark::Mark;
use crate::log::LogLimiter;

/// A payload is remembered at least so long, also where messages grow old sooner: relays may be slow.
const REMEMBERED_MIN: Duration = Duration::from_secs(1);
/// Within this time a relay passes on what was delivered.
const RELAYED_WITHIN: Duration = Duration::from_millis(250);
/// Most payloads remembered, of all services; beyond it the oldest are forgotten.
const PAYLOADS_MAX: usize = 16 * 1024;
/// Most publishers remembered by a filter; beyond it all have to show themselves again.
const PUBLISHERS_MAX: usize = 1024;
/// Most repetitions remembered of a publisher that is no source; beyond it they are forgotten.
const REPETITIONS_MAX: usize = 256;

/// The publisher of a sample: the GUID of a DDS writer, or the origin in shared memory.
type Source = [u8; 16];

/// Payloads that were delivered to the local graph or came from it, shared by all routes of a bridge.
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
    /// By service and hash of the payload, in the order in which they came.
    payloads: HashMap<(Mark, u64), VecDeque<Explanation>>,
    order: VecDeque<(Instant, Mark, u64)>,
    /// Number of the newest explanation.
    newest: u64,
}

/// An earlier payload that explains a repetition.
#[derive(Debug, Clone, Copy)]
struct Explanation {
    number: u64,
    at: Instant,
    /// The sender, if it came from the graph; none if it was delivered there.
    from: Option<Source>,
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

    /// The hash of a payload, without the options in its header: a relay on another middleware writes others.
    fn hash(&self, payload: &[u8]) -> u64 {
        match payload.split_at_checked(HEADER_BYTES) {
            Some(([first, second, ..], body)) => self.hasher.hash_one(([*first, *second], body)),
            _ => self.hasher.hash_one(payload),
        }
    }

    /// A payload was, or is about to be, delivered to the graph.
    pub fn note(&self, service: Mark, payload: &[u8], now: Instant) {
        if self.lock().wanted.contains_key(&service) {
            let hash = self.hash(payload);
            let mut window = self.lock();
            window.delivering.insert(service);
            window.add(service, hash, None, now);
        }
    }

    fn lock(&self) -> MutexGuard<'_, Window> {
        self.window.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Window {
    fn add(&mut self, service: Mark, hash: u64, from: Option<Source>, at: Instant) {
        self.newest = self.newest.saturating_add(1);
        let explanation = Explanation { number: self.newest, at, from };
        self.payloads.entry((service, hash)).or_default().push_back(explanation);
        self.order.push_back((at, service, hash));
        while self.order.len() > PAYLOADS_MAX || self.is_first_old(at) {
            let Some((_, service, hash)) = self.order.pop_front() else { break };
            if let Some(same) = self.payloads.get_mut(&(service, hash)) {
                same.pop_front();
                if same.is_empty() {
                    self.payloads.remove(&(service, hash));
                }
            }
        }
    }

    fn is_first_old(&self, now: Instant) -> bool {
        self.order.front().is_some_and(|(noted, service, _)| {
            let remembered = self.wanted.get(service).copied().unwrap_or(REMEMBERED_MIN);
            now.saturating_duration_since(*noted) > remembered
        })
    }

    /// The first explanation after that number, and whether there is one of just now.
    fn explain(&self, service: Mark, hash: u64, by: Source, after: u64, now: Instant) -> Option<(u64, bool)> {
        let remembered = self.wanted.get(&service).copied().unwrap_or(REMEMBERED_MIN);
        let same = self.payloads.get(&(service, hash))?;
        let age = |known: &Explanation| now.saturating_duration_since(known.at);
        let usable = |known: &&Explanation| known.from != Some(by) && age(known) <= remembered;
        let unused = same.partition_point(|known| known.number <= after);
        let first = same.range(unused..).find(usable)?;
        let is_prompt = same.range(unused..).rev().find(usable).is_some_and(|last| age(last) <= RELAYED_WITHIN);
        Some((first.number, is_prompt))
    }
}

/// The decision of the filter on a sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Entry {
    /// It may go to the ledger.
    Admit,
    /// A bridge of this network published it.
    FromBridge,
    /// Its publisher only passes on what the ledger delivered.
    PassedOn,
}

/// The filter of a route to the ledger. DDS and shared memory have the same one.
#[derive(Debug)]
pub struct LoopFilter {
    mark: Mark,
    service: String,
    remembered: Duration,
    delivered: Arc<Delivered>,
    returned: AtomicU64,
    publishers: Mutex<BTreeMap<Source, Publisher>>,
    log_limiter: Mutex<LogLimiter>,
}

/// The record of a publisher.
#[derive(Debug)]
enum Publisher {
    /// It has sent something of its own.
    Source,
    /// All that it has sent was explained.
    Repeats {
        /// For each payload, the explanation that was used up last.
        used: HashMap<u64, u64>,
        last: Instant,
    },
}

impl LoopFilter {
    /// The filter of a service whose messages count for `max_age`.
    pub fn new(mark: Mark, service: &str, max_age: Duration, delivered: Arc<Delivered>) -> Self {
        let remembered = max_age.max(REMEMBERED_MIN);
        delivered.want(mark, remembered);
        let (publishers, log_limiter) = (Mutex::default(), Mutex::default());
        Self {
            mark,
            service: service.to_owned(),
            remembered,
            delivered,
            returned: AtomicU64::new(0),
            publishers,
            log_limiter,
        }
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
            self.keep_out("bridge", "a bridge of this network published it", now);
            return Entry::FromBridge;
        }
        let mut publishers = self.publishers.lock().unwrap_or_else(PoisonError::into_inner);
        if publishers.len() >= PUBLISHERS_MAX && !publishers.contains_key(&source) {
            publishers.clear();
        }
        if !self.delivered.lock().delivering.contains(&self.mark) {
            // Nothing can come back: whoever publishes now is a source.
            publishers.insert(source, Publisher::Source);
            return Entry::Admit;
        }
        let hash = self.delivered.hash(payload);
        let mut window = self.delivered.lock();
        let (is_source, was_quiet, after) = match publishers.get(&source) {
            Some(Publisher::Source) => (true, false, 0),
            Some(Publisher::Repeats { used, last }) => {
                let was_quiet = now.saturating_duration_since(*last) > self.remembered;
                (false, was_quiet, used.get(&hash).copied().unwrap_or(0))
            }
            None => (false, true, 0),
        };
        let explained = if is_source { None } else { window.explain(self.mark, hash, source, after, now) };
        let Some((number, is_prompt)) = explained else {
            publishers.insert(source, Publisher::Source);
            window.add(self.mark, hash, Some(source), now);
            return Entry::Admit;
        };
        let mut used = match publishers.remove(&source) {
            Some(Publisher::Repeats { used, .. }) if used.len() < REPETITIONS_MAX => used,
            _ => HashMap::new(),
        };
        used.insert(hash, number);
        publishers.insert(source, Publisher::Repeats { used, last: now });
        drop(publishers);
        if was_quiet && !is_prompt {
            window.add(self.mark, hash, Some(source), now);
            return Entry::Admit;
        }
        drop(window);
        self.keep_out("relay", "its publisher only passes on what came from the ledger", now);
        Entry::PassedOn
    }

    fn keep_out(&self, kind: &'static str, reason: &str, now: Instant) {
        self.returned.fetch_add(1, Ordering::Relaxed);
        let worth = self.log_limiter.lock().unwrap_or_else(PoisonError::into_inner).admit(kind, now);
        if let Some(not_logged) = worth {
            let service = &self.service;
            tracing::warn!(service, reason, not_logged, "sample from the ledger not published to it again");
        }
    }
}

#[cfg(test)]
mod tests;
