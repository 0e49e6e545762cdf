//! The endpoints of others that are in the graph, by their tokens.

use std::{
    collections::{BTreeMap, BTreeSet, VecDeque},
    sync::{
        Arc, Mutex, MutexGuard, PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard,
        atomic::{AtomicU64, Ordering},
    },
};

use tokio::sync::watch;

use crate::{
    gid::{Gid, gid_of},
    limits::{ENDPOINTS_MAX, LEFT_MAX},
    token::Token,
};

/// An endpoint of another session.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RemoteEndpoint {
    /// Its identifier, which its messages carry.
    pub gid: Gid,
    /// Its token.
    pub token: Token,
}

/// The endpoints of others. Cloning shares them.
#[derive(Debug, Clone)]
pub struct Graph {
    inner: Arc<Inner>,
}

#[derive(Debug)]
struct Inner {
    /// The own session, whose endpoints are left out.
    session: String,
    endpoints: RwLock<BTreeMap<Gid, Arc<RemoteEndpoint>>>,
    left: Mutex<Left>,
    changes: watch::Sender<u64>,
    ignored: AtomicU64,
}

/// Those that have left, the oldest first. Their number is limited.
#[derive(Debug, Default)]
struct Left {
    order: VecDeque<Gid>,
    known: BTreeSet<Gid>,
}

impl Left {
    fn add(&mut self, gid: Gid) {
        if self.known.insert(gid) {
            self.order.push_back(gid);
        }
        if self.order.len() > LEFT_MAX
            && let Some(oldest) = self.order.pop_front()
        {
            self.known.remove(&oldest);
        }
    }
}

impl Graph {
    pub(crate) fn new(session: &str) -> Self {
        let inner = Inner {
            session: session.to_owned(),
            endpoints: RwLock::default(),
            left: Mutex::default(),
            changes: watch::Sender::new(0),
            ignored: AtomicU64::new(0),
        };
        Self { inner: Arc::new(inner) }
    }

    /// The endpoint with this identifier.
    pub fn endpoint(&self, gid: &Gid) -> Option<Arc<RemoteEndpoint>> {
        self.read().get(gid).cloned()
    }

    /// Has an endpoint with this identifier left? False for one that was never announced: not every implementation takes the
    /// identifier in its messages from its token.
    pub fn has_left(&self, gid: &Gid) -> bool {
        self.endpoint(gid).is_none() && self.left().known.contains(gid)
    }

    /// All endpoints.
    pub fn endpoints(&self) -> Vec<Arc<RemoteEndpoint>> {
        self.read().values().cloned().collect()
    }

    /// Counts up with every change.
    pub fn changes(&self) -> watch::Receiver<u64> {
        self.inner.changes.subscribe()
    }

    /// Tokens that were ignored because there are too many.
    pub fn ignored(&self) -> u64 {
        self.inner.ignored.load(Ordering::Relaxed)
    }

    /// A token has appeared.
    pub(crate) fn add(&self, key: &str) {
        let Some(token) = Token::parse(key).filter(|token| token.node.session != self.inner.session) else { return };
        let gid = gid_of(key);
        let mut endpoints = self.write();
        if endpoints.len() >= ENDPOINTS_MAX && !endpoints.contains_key(&gid) {
            self.inner.ignored.fetch_add(1, Ordering::Relaxed);
            return;
        }
        if endpoints.insert(gid, Arc::new(RemoteEndpoint { gid, token })).is_none() {
            drop(endpoints);
            self.changed();
        }
    }

    /// A token has gone.
    pub(crate) fn remove(&self, key: &str) {
        let gid = gid_of(key);
        let removed = self.write().remove(&gid);
        if removed.is_some() {
            self.left().add(gid);
            self.changed();
        }
    }

    fn changed(&self) {
        self.inner.changes.send_modify(|changes| *changes = changes.wrapping_add(1));
    }

    fn left(&self) -> MutexGuard<'_, Left> {
        self.inner.left.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn read(&self) -> RwLockReadGuard<'_, BTreeMap<Gid, Arc<RemoteEndpoint>>> {
        self.inner.endpoints.read().unwrap_or_else(PoisonError::into_inner)
    }

    fn write(&self) -> RwLockWriteGuard<'_, BTreeMap<Gid, Arc<RemoteEndpoint>>> {
        self.inner.endpoints.write().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    fn token(session: &str, number: usize) -> String {
        format!("@ros2_lv/0/{session}/0/{number}/MP/%/%/n/%t/a::msg::dds_::T_/RIHS01_0/::,1:,:,:,,")
    }

    #[test]
    fn the_endpoints_of_others_come_and_go_and_the_own_ones_are_left_out() {
        let graph = Graph::new("a");
        let mut changes = graph.changes();
        graph.add(&token("a", 1));
        graph.add("@ros2_lv/0/b/0/0/NN/%/%/n");
        graph.add("nonsense");
        assert!(!changes.has_changed().unwrap() && graph.endpoints().is_empty());
        graph.add(&token("b", 1));
        assert!(changes.has_changed().unwrap());
        changes.mark_unchanged();
        let gid = gid_of(&token("b", 1));
        assert_eq!(graph.endpoint(&gid).unwrap().token.node.session, "b");
        graph.add(&token("b", 1));
        assert!(!changes.has_changed().unwrap(), "it was there");
        graph.remove(&token("b", 1));
        assert!(changes.has_changed().unwrap() && graph.endpoint(&gid).is_none());
    }

    #[test]
    fn who_has_left_is_told_from_who_was_never_announced() {
        let graph = Graph::new("a");
        let gid = gid_of(&token("b", 1));
        assert!(!graph.has_left(&gid), "never announced");
        graph.add(&token("b", 1));
        assert!(!graph.has_left(&gid));
        graph.remove(&token("b", 1));
        assert!(graph.has_left(&gid));
        for number in 2..LEFT_MAX + 2 {
            graph.add(&token("b", number));
            graph.remove(&token("b", number));
        }
        assert!(!graph.has_left(&gid), "forgotten");
    }

    #[test]
    fn tokens_without_end_do_not_fill_the_memory() {
        let graph = Graph::new("a");
        (0..ENDPOINTS_MAX + 3).for_each(|number| graph.add(&token("b", number)));
        assert_eq!((graph.endpoints().len(), graph.ignored()), (ENDPOINTS_MAX, 3));
        graph.remove(&token("b", 0));
        graph.add(&token("b", ENDPOINTS_MAX + 5));
        assert_eq!((graph.endpoints().len(), graph.ignored()), (ENDPOINTS_MAX, 3), "there was room again");
    }
}
