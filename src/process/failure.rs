//! The end of an instance that cannot go on as it is.

use crate::process::config::Config;
use ledger_base::rejection::{Code, Rejection};
use ledger_base::shell;
use std::io;
use std::sync::Arc;
use tokio::sync::watch;

/// Stands for the configuration in commands that are told where it is not known; [`advised`] puts it in.
const FILE_WORD: &str = "--config FILE";

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
pub(crate) struct FailureHandle {
    ended: watch::Sender<Option<Ended>>,
    /// For advice to the operator.
    config: Arc<Config>,
}

impl FailureHandle {
    /// For a node with this configuration.
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
        tracing::error!(code = reason.code.name(), %reason, "node cannot continue");
        self.ended.send_replace(Some(Ended::Failed(reason)));
    }

    /// The node must start again, on a snapshot that it took.
    pub(crate) fn start_again(&self) {
        self.ended.send_replace(Some(Ended::StartAgain));
    }
}

/// The refusal with the commands that it names as they must be typed here.
pub(crate) fn advised(reason: Rejection, config: &Config) -> Rejection {
    let next = reason.advice().replace(FILE_WORD, &format!("--config {}", shell::path(&config.file)));
    reason.next(next)
}

/// The refusal of the operating system to give a thread.
pub(crate) fn thread_error(error: &io::Error) -> Rejection {
    Rejection::new(Code::Internal, format!("cannot start a thread: {error}"))
}
