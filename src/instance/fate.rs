//! The end of an instance that cannot go on as it is.

use crate::config::Config;
use crate::join::advised;
use ledger_base::rejection::Rejection;
use std::sync::Arc;
use tokio::sync::watch;

/// Why a node cannot go on as it is.
#[derive(Clone, Debug, PartialEq)]
pub enum Ended {
    /// It failed.
    Failed(Rejection),
    /// It took a snapshot from another node, in place of blocks that nobody has any more. Stopped and started again, it
    /// goes on from there.
    StartAgain,
}

/// Ends an instance, from any of its parts; cheap to clone.
#[derive(Clone)]
pub(crate) struct Fate {
    ended: watch::Sender<Option<Ended>>,
    /// For advice to the operator.
    config: Arc<Config>,
}

impl Fate {
    /// The fate of a node with this configuration.
    pub(crate) fn new(config: &Config) -> Self {
        Self { ended: watch::Sender::new(None), config: Arc::new(config.clone()) }
    }

    /// Tells the end to its owner.
    pub(crate) fn subscribe(&self) -> watch::Receiver<Option<Ended>> {
        self.ended.subscribe()
    }

    /// The node cannot go on, for this reason.
    pub(crate) fn fail(&self, reason: Rejection) {
        let reason = advised(reason, &self.config);
        tracing::error!(code = reason.code.name(), %reason, "the node cannot continue");
        self.ended.send_replace(Some(Ended::Failed(reason)));
    }

    /// The node must start again, on a snapshot that it took.
    pub(crate) fn start_again(&self) {
        self.ended.send_replace(Some(Ended::StartAgain));
    }
}
