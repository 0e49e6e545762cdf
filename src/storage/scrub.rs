//! Looks for rot in the finished part of the log, once after every start: opening does not read it. Slowly, so that nobody
//! notices: 4 MiB a second at most.

use crate::process::failure::FailureHandle;
use ledger_storage::block_store::{BlockStore, StoreError};
use std::io;
use std::sync::Arc;
use std::sync::mpsc::{self, RecvTimeoutError, Sender};
use std::thread::JoinHandle;
use std::time::Duration;

/// Bytes that are read at once: about half a millisecond of work.
const PIECE_BYTES: u32 = 256 * 1024;
/// Between two pieces.
const PAUSE: Duration = Duration::from_millis(64);

/// The thread that reads. It ends when it has seen everything.
pub(crate) struct Scrub {
    stop: Sender<()>,
    thread: JoinHandle<()>,
}

impl Scrub {
    /// Begins to read. The node ends if there is damage: what it holds is not what it acknowledged.
    ///
    /// # Errors
    /// If the operating system gives no thread.
    pub(crate) fn start(store: Arc<BlockStore>, failure: FailureHandle) -> io::Result<Self> {
        let (stop, stopped) = mpsc::channel();
        let thread = std::thread::Builder::new().name("scrub".into()).spawn(move || {
            let mut read = 0_u32;
            let checked = store.check_finished(|bytes| {
                read = read.saturating_add(bytes);
                if read < PIECE_BYTES {
                    return true;
                }
                read = 0;
                stopped.recv_timeout(PAUSE) == Err(RecvTimeoutError::Timeout)
            });
            match checked {
                Ok(()) => tracing::debug!("no damage in finished segments"),
                Err(damage @ StoreError::Corrupt { .. }) => failure.fail(damage.into()),
                Err(error) => tracing::warn!(%error, "cannot check finished segments for damage"),
            }
        })?;
        Ok(Self { stop, thread })
    }

    /// Ends the thread.
    pub(crate) fn stop(self) {
        drop(self.stop);
        if self.thread.join().is_err() {
            tracing::error!("thread that checks for damage panicked");
        }
    }
}
