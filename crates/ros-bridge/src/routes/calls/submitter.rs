//! From the local part of a route of calls to the half that submits to the ledger.

use std::sync::Arc;

use ledger_gate::sample::Sample;

use crate::graph::queue::{Incoming, Queue};

/// Numbers messages, and hands them over to the half that submits them.
pub(in crate::routes) struct Submitter {
    queue: Arc<Queue>,
    /// The number of the last message.
    last: u64,
}

impl Submitter {
    pub(super) fn new(queue: Arc<Queue>) -> Self {
        Self { queue, last: 0 }
    }

    /// Hands a message over. Returns its number.
    pub(in crate::routes) fn submit(&mut self, message: Sample) -> u64 {
        let number = self.last.saturating_add(1);
        self.last = number;
        self.queue.push(Incoming::own(message, number));
        number
    }

    /// Nothing is submitted any more.
    pub(in crate::routes) fn close(&self) {
        self.queue.close();
    }
}
