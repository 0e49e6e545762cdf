//! The time that the steps of a command take: the histograms behind `/metrics`, and traces of single messages.

use ledger::{Ledger, Outcome};
use ledger_replica::Observer;
use ledger_traces::{Step, Tracer, wall_at};
use prometheus_client::metrics::histogram::Histogram;
use std::sync::Arc;
use std::time::Instant;

/// Upper bounds of the buckets, in seconds.
const BOUNDS: [f64; 8] = [0.0005, 0.001, 0.002, 0.005, 0.01, 0.05, 0.25, 1.0];
/// The same of the gateway, which waits for no disk and no other node.
const GATEWAY_BOUNDS: [f64; 5] = [0.0001, 0.0005, 0.002, 0.01, 0.1];

/// The histograms of a node. Clones share them.
#[derive(Clone, Debug)]
pub(crate) struct Meters {
    /// From a transaction's arrival until it is handed to ordering.
    pub gateway: Histogram,
    /// From a transaction's arrival to its verdict from a block.
    pub commit: Histogram,
    /// One flush of the log.
    pub flush: Histogram,
    /// Executing the blocks that came together.
    pub execute: Histogram,
}

impl Default for Meters {
    fn default() -> Self {
        let empty = || Histogram::new(BOUNDS);
        Self { gateway: Histogram::new(GATEWAY_BOUNDS), commit: empty(), flush: empty(), execute: empty() }
    }
}

/// Takes down how much time has passed since then.
pub(crate) fn observe(histogram: &Histogram, since: Instant) {
    histogram.observe(since.elapsed().as_secs_f64());
}

/// Tells the traces of messages when their block is executed here.
pub(crate) struct Traced(pub(crate) Tracer);

impl Observer for Traced {
    fn executed(&self, outcome: &Arc<Outcome>, _ledger: &Ledger) {
        if self.0.is_off() {
            return;
        }
        let (begun, height) = (wall_at(outcome.header.time), outcome.header.height);
        for (id, result) in outcome.ids.iter().zip(&outcome.results) {
            self.0.tell(id, || Step {
                failed: result.outcome().err().map(|refused| refused.code.name()),
                ..Step::since("block", begun).with("ledgerd.height", height)
            });
        }
    }
}
