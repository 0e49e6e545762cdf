//! Receipts: proof, for the node that made it, of what it has acknowledged.
//!
//! A voter that has lost acknowledged blocks must stop (design rule: never truncate what was promised), and it cannot tell
//! by itself. Its leader can, but a word of the leader alone could then stop every voter. So each acknowledgement carries
//! an authentication code under a secret of the node that acknowledges. The leader keeps the newest one and shows it with
//! its heartbeats. It costs one HMAC for each acknowledgement, below a microsecond.
//!
//! The other nodes keep receipts of committed blocks, too. A node that starts believes nobody who says that it had more
//! than it has, unless it is shown a receipt of its own.

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

/// The words of a node that it holds a block, which only that node can check.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Receipt {
    /// The term in which it acknowledged the block to its leader; 0 for a block that is committed.
    pub term: u64,
    /// The block, and so all before it.
    pub index: u64,
    /// The authentication code.
    pub code: Bytes,
}

/// Makes the receipts of one node, and knows them again.
#[derive(Clone, Debug)]
pub struct ReceiptKey {
    id: u64,
    key: Key,
}

impl ReceiptKey {
    /// Of the node with this number.
    pub fn new(id: u64, secret: &Secret) -> Self {
        Self { id, key: Key::new(HMAC_SHA256, &secret.0) }
    }

    /// The receipt for a committed block.
    pub fn committed(&self, index: u64) -> Receipt {
        self.receipt(0, index)
    }

    /// Has a node with this term and this end of its log lost blocks, as its own receipt shows? A leader of a later term
    /// may have replaced what was acknowledged in an earlier one (Raft §5.3), but nothing that is committed.
    pub fn shows_loss(&self, receipt: &Receipt, term: u64, last: u64) -> bool {
        let counts = receipt.term == 0 || receipt.term >= term;
        counts && receipt.index > last && self.made(receipt)
    }

    fn receipt(&self, term: u64, index: u64) -> Receipt {
        let code = Bytes::copy_from_slice(sign(&self.key, &self.said(term, index)).as_ref());
        Receipt { term, index, code }
    }

    /// Did this node make it?
    fn made(&self, receipt: &Receipt) -> bool {
        verify(&self.key, &self.said(receipt.term, receipt.index), &receipt.code).is_ok()
    }

    /// This node holds the block, as it says in a term.
    fn said(&self, term: u64, index: u64) -> Vec<u8> {
        [DOMAIN, &[self.id, term, index].map(u64::to_be_bytes).concat()].concat()
    }
}

/// The receipts of a node, and those that it was given.
pub(super) struct Receipts {
    own: ReceiptKey,
    /// The term in which this node leads and was given the receipts.
    term: u64,
    given: BTreeMap<u64, Receipt>,
}

impl Receipts {
    pub(super) fn new(id: u64, secret: &Secret) -> Self {
        Self { own: ReceiptKey::new(id, secret), term: 0, given: BTreeMap::new() }
    }

    /// The newest receipt of a follower.
    pub(super) fn given(&self, from: u64) -> Option<Receipt> {
        self.given.get(&from).cloned()
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
            message.receipt = self.own.receipt(message.term, message.index).code;
        }
        if message.kind == i32::from(RaftKind::Heartbeat)
            && message.term == self.term
            && let Some(receipt) = self.given.get(&to)
        {
            (message.receipt_index, message.receipt) = (receipt.index, receipt.code.clone());
        }
    }

    /// Does a message show an own receipt for a block that this node, with this term and this end of its log, does not hold?
    pub(super) fn show_loss(&self, message: &RaftMessage, term: u64, last: u64) -> bool {
        let (index, code) = (message.receipt_index, message.receipt.clone());
        message.term > 0 && self.own.shows_loss(&Receipt { term: message.term, index, code }, term, last)
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
        counts.then(|| Receipt { term: message.term, index: message.index, code: message.receipt.clone() })
    }
}
