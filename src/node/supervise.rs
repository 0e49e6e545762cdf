//! Runs a node until it is stopped or ends.

use super::Node;
use crate::process::config::Config;
use crate::process::failure::Ended;
use futures::{FutureExt, Stream, StreamExt, future};
use ledger_base::rejection::{Code, Rejection};
use std::future::Future;

/// Waits for a signal to stop, or for the node to end; ends the node in order either way. Meanwhile it takes over changed
/// configurations, as [`Node::reload`] does.
pub(crate) async fn until_stopped(
    node: Node,
    stop: impl Future<Output = ()>,
    changes: impl Stream<Item = Config>,
) -> Result<(), Rejection> {
    let reload = changes.for_each(async |config| node.reload(&config));
    let outcome = tokio::select! {
        () = stop => Ok(()),
        ended = node.ended() => Err(ended),
        () = reload.then(|()| future::pending()) => Ok(()),
    };
    node.stop().await;
    match outcome {
        Ok(()) => Ok(()),
        Err(Ended::Failed(reason)) => Err(reason),
        Err(Ended::StartAgain) => Err(start_again()),
    }
}

/// Puts this program anew in the place of this process: nothing of the old state is left in memory or in use.
fn start_again() -> Rejection {
    use std::os::unix::process::CommandExt;
    let failed = |error: std::io::Error| {
        Rejection::new(Code::Internal, format!("the node must restart, and cannot do so by itself: {error}"))
            .next("start it again")
    };
    match std::env::current_exe() {
        Ok(program) => failed(std::process::Command::new(program).args(std::env::args_os().skip(1)).exec()),
        Err(error) => failed(error),
    }
}
