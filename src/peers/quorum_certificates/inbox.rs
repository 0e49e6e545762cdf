//! Statements of peers that wait to be looked at. Each peer has its own places and its turn, so that none crowds out another.

use bytes::Bytes;
use std::collections::{BTreeMap, VecDeque};
use std::sync::{Mutex, PoisonError};
use tokio::sync::Notify;

/// Most statements of one peer that wait.
const WAITING_MAX: usize = 64;

/// Statements that wait.
#[derive(Default)]
pub(super) struct Inbox {
    waiting: Mutex<Waiting>,
    more: Notify,
}

#[derive(Default)]
struct Waiting {
    peers: BTreeMap<u64, VecDeque<Bytes>>,
    /// The peer that had the last turn.
    last: u64,
}

impl Waiting {
    /// The next one, peer after peer.
    fn take(&mut self) -> Option<(u64, Bytes)> {
        let next = self.peers.range(self.last + 1..).next().or_else(|| self.peers.range(..).next());
        let peer = next.map(|(peer, _)| *peer)?;
        let waiting = self.peers.get_mut(&peer)?;
        let statement = waiting.pop_front();
        if waiting.is_empty() {
            self.peers.remove(&peer);
        }
        self.last = peer;
        Some((peer, statement?))
    }
}

impl Inbox {
    /// A statement has come. The oldest one of the peer gives way: the newest says more.
    pub(super) fn put(&self, from: u64, statement: Bytes) {
        let mut waiting = self.waiting.lock().unwrap_or_else(PoisonError::into_inner);
        let of_peer = waiting.peers.entry(from).or_default();
        if of_peer.len() >= WAITING_MAX {
            of_peer.pop_front();
        }
        // A copy: the frame that it came in may be larger.
        of_peer.push_back(Bytes::copy_from_slice(&statement));
        self.more.notify_one();
    }

    /// The next statement, once there is one.
    pub(super) async fn next(&self) -> (u64, Bytes) {
        loop {
            let next = self.waiting.lock().unwrap_or_else(PoisonError::into_inner).take();
            match next {
                Some(next) => return next,
                None => self.more.notified().await,
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn a_peer_that_floods_loses_its_own_statements_and_delays_nobody() {
        let inbox = Inbox::default();
        for number in 0..1000u16 {
            inbox.put(3, Bytes::copy_from_slice(&number.to_be_bytes()));
        }
        inbox.put(2, Bytes::from_static(b"of 2"));
        inbox.put(4, Bytes::from_static(b"of 4"));
        let mut order = Vec::new();
        for _ in 0..4 {
            order.push(inbox.next().await.0);
        }
        assert_eq!(order, [2, 3, 4, 3]);
        let mut left = Vec::new();
        while let Some((_, statement)) = inbox.waiting.lock().unwrap_or_else(PoisonError::into_inner).take() {
            left.push(statement);
        }
        assert_eq!(
            (left.len(), left.last().map(|last| last.to_vec())),
            (WAITING_MAX - 2, Some(999u16.to_be_bytes().to_vec()))
        );
    }
}
