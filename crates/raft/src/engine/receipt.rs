//! Receipts: proof, for the node that made it, of what it has acknowledged.
//!
//! A voter that has lost acknowledged blocks must stop (design rule: never truncate what was promised), and it cannot tell
//! by itself. Its leader can, but a word of the leader alone could then stop every voter. So each acknowledgement carries
//! an authentication code under a secret of the node that acknowledges. The leader keeps the newest one and shows it with
//! its heartbeats. It costs one HMAC for each acknowledgement, below a microsecond.

use super::Engine;
use crate::message::{RECEIPT_BYTES, RaftKind, RaftMessage};
use bytes::Bytes;
use ring::hmac::{HMAC_SHA256, Key, sign, verify};
use std::collections::BTreeMap;
use std::fmt;

/// Where the authenticated bytes begin, so that they are of no other kind.
const DOMAIN: &[u8] = b"ledgerd receipt v1\0";

/// A secret of a node, the same after every start: made from its key.
#[derive(Clone, Copy, Default, PartialEq, Eq)]
pub struct Secret(pub [u8; 32]);

impl fmt::Debug for Secret {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Secret")
    }
}

/// A receipt of another node, which only that node can read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Receipt {
    /// The block, and so all before it.
    pub index: u64,
    /// The authentication code.
    pub code: Bytes,
}

/// The receipts of a node, and those that it was given.
pub(super) struct Receipts {
    id: u64,
    key: Key,
    /// The term in which this node leads and was given the receipts.
    term: u64,
    given: BTreeMap<u64, Receipt>,
}

impl Receipts {
    pub(super) fn new(id: u64, secret: &Secret) -> Self {
        Self { id, key: Key::new(HMAC_SHA256, &secret.0), term: 0, given: BTreeMap::new() }
    }

    /// This node leads from now on: receipts are of one term.
    pub(super) fn begin_term(&mut self, term: u64) {
        (self.term, self.given) = (term, BTreeMap::new());
    }

    /// Keeps the newest receipt of a follower.
    pub(super) fn keep(&mut self, from: u64, receipt: Receipt) {
        let newest = self.given.get(&from).is_none_or(|known| known.index < receipt.index);
        if newest {
            self.given.insert(from, receipt);
        }
    }

    /// Puts a receipt on an acknowledgement, and shows a follower its own with a heartbeat.
    pub(super) fn attach(&self, to: u64, message: &mut RaftMessage) {
        if message.kind == i32::from(RaftKind::AppendResponse) && !message.reject {
            message.receipt = self.code(message.term, message.index);
        }
        if message.kind == i32::from(RaftKind::Heartbeat)
            && message.term == self.term
            && let Some(receipt) = self.given.get(&to)
        {
            (message.receipt_index, message.receipt) = (receipt.index, receipt.code.clone());
        }
    }

    /// Did this node make the receipt that it is shown?
    pub(super) fn are_own(&self, message: &RaftMessage) -> bool {
        verify(&self.key, &self.said(message.term, message.receipt_index), &message.receipt).is_ok()
    }

    fn code(&self, term: u64, index: u64) -> Bytes {
        Bytes::copy_from_slice(sign(&self.key, &self.said(term, index)).as_ref())
    }

    /// This node holds the block, as it says in a term.
    fn said(&self, term: u64, index: u64) -> Vec<u8> {
        [DOMAIN, &[self.id, term, index].map(u64::to_be_bytes).concat()].concat()
    }
}

impl Engine {
    /// The receipt in a message of a follower to its leader.
    pub(super) fn receipt_in(&self, from: u64, message: &RaftMessage) -> Option<Receipt> {
        let raft = &self.raw.raft;
        let counts = message.kind == i32::from(RaftKind::AppendResponse)
            && !message.reject
            && message.term == raft.term
            && message.index <= raft.raft_log.last_index()
            && message.receipt.len() == RECEIPT_BYTES
            && self.is_leader()
            && self.membership.contains(from);
        counts.then(|| Receipt { index: message.index, code: message.receipt.clone() })
    }
}
