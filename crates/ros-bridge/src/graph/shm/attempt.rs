//! Work with shared memory that others may disturb.

use std::time::Duration;

use crate::error::{Error, Explained, Result};

/// Tries to open something that others create or clean up at the same time.
const OPEN_TRIES_MAX: u32 = 20;
const OPEN_PAUSE: Duration = Duration::from_millis(50);

/// Tries again what fails while others create or clean up the same thing.
pub(super) fn retry<T, E: std::fmt::Debug + std::fmt::Display>(
    what: &str,
    mut attempt: impl FnMut() -> std::result::Result<T, E>,
) -> Result<T> {
    let mut tries = 1;
    loop {
        match attempt() {
            Ok(done) => return Ok(done),
            Err(error) if tries >= OPEN_TRIES_MAX => return Err(failed(what, &error)),
            Err(error) => {
                tracing::debug!(what, %error, tries, "trying again");
                tries += 1;
                std::thread::sleep(OPEN_PAUSE);
            }
        }
    }
}

pub(super) fn failed(what: &str, error: &dyn std::fmt::Debug) -> Error {
    let wanted =
        "free, compatible shared memory of this user in /dev/shm and in the directory that docs/bridge.md names";
    let hint = "run all processes as one user, with the types that docs/bridge.md names; if it stays, stop them and delete that directory";
    Error::Shm(Explained::new(what, format!("{error:?}"), wanted, hint))
}

/// Runs what may wait (files, locks, retries) off the threads of the runtime.
pub(super) async fn blocking<T: Send + 'static>(work: impl FnOnce() -> Result<T> + Send + 'static) -> Result<T> {
    tokio::task::spawn_blocking(work).await.map_err(|error| failed("shared memory task ended early", &error))?
}
