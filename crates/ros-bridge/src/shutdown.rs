//! The signal that ends the tasks of a bridge, and tasks that end by it.

use tokio::{
    sync::watch,
    task::{JoinError, JoinHandle},
};

/// Tells a task to end. It also ends when the sender is gone.
pub(crate) type Shutdown = watch::Receiver<bool>;

/// Waits until it is time to end.
pub(crate) async fn requested(shutdown: &mut Shutdown) {
    // An error means that the sender is gone.
    let _requested = shutdown.wait_for(|shutdown| *shutdown).await;
}

/// A task, and the signal that ends it.
pub(crate) struct BackgroundTask {
    stop: watch::Sender<bool>,
    task: JoinHandle<()>,
    /// The log message if it ends by a panic.
    complaint: &'static str,
}

impl BackgroundTask {
    /// Spawns a task that ends by the signal that it gets. `complaint` is logged if it ends by a panic.
    pub(crate) fn spawn<F>(complaint: &'static str, task: impl FnOnce(Shutdown) -> F) -> Self
    where
        F: Future<Output = ()> + Send + 'static,
    {
        let (stop, shutdown) = watch::channel(false);
        Self::with(stop, complaint, task(shutdown))
    }

    /// Spawns a task that `stop` ends.
    pub(crate) fn with(
        stop: watch::Sender<bool>,
        complaint: &'static str,
        task: impl Future<Output = ()> + Send + 'static,
    ) -> Self {
        Self { stop, task: tokio::spawn(task), complaint }
    }

    /// Tells it to end.
    pub(crate) fn signal(&self) {
        self.stop.send_replace(true);
    }

    /// Tells it to end, and waits until it has.
    pub(crate) async fn end(self) {
        let complaint = self.complaint;
        if let Err(error) = self.join().await {
            tracing::error!(%error, "{complaint}");
        }
    }

    /// As [`BackgroundTask::end`], but the caller logs a panic.
    pub(crate) async fn join(self) -> Result<(), JoinError> {
        self.signal();
        self.task.await
    }
}
