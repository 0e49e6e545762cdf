//! Child processes of `demo` and `lab`: started with a log file, stopped in order, never left behind.

use crate::process::telemetry::LOG_FORMAT;
use ledger_base::rejection::{Code, Rejection};
use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::{ExitStatus, Stdio};
use std::time::{Duration, Instant};
use tokio::io::AsyncReadExt;
use tokio::process::{Child, Command};

/// Time that a process has to end by itself after it was asked to.
const STOP_TIME_MAX: Duration = Duration::from_secs(5);

/// Time that a killed process has to be gone, before the directory it wrote into is removed.
const KILL_TIME_MAX: Duration = Duration::from_secs(2);

/// A running `ledgerd`. Dropping it kills the process and waits until it is gone.
pub(super) struct Process {
    name: String,
    child: Child,
    log: PathBuf,
}

impl Process {
    /// Starts this program with other arguments; its log goes into a file of the directory.
    pub(super) fn start(name: &str, directory: &Path, arguments: &[&str]) -> Result<Self, Rejection> {
        let log = directory.join(format!("{name}.log"));
        let failed = |error: std::io::Error| Rejection::new(Code::Internal, format!("cannot start {name}: {error}"));
        let program = std::env::current_exe().map_err(failed)?;
        let child = Command::new(program)
            .args(arguments)
            // The demo reads the logs: at the level of the configuration.
            .env_remove("RUST_LOG")
            // And people read their ends.
            .env(LOG_FORMAT, "text")
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(File::create(&log).map_err(failed)?)
            // Ctrl-C reaches the parent alone, which ends the others in order.
            .process_group(0)
            .kill_on_drop(true)
            .spawn()
            .map_err(failed)?;
        Ok(Self { name: name.to_owned(), child, log })
    }

    /// Fails if the process has ended by itself, with the end of its log.
    pub(super) fn check(&mut self) -> Result<(), Rejection> {
        match self.child.try_wait() {
            Ok(None) => Ok(()),
            Ok(Some(status)) => {
                Err(Rejection::new(Code::Internal, format!("{} ended: {status}", self.name)).found(self.log_end()))
            }
            Err(error) => Err(Rejection::new(Code::Internal, format!("cannot watch {}: {error}", self.name))),
        }
    }

    /// The number of the process; none if it has ended.
    pub(super) fn id(&self) -> Option<u32> {
        self.child.id()
    }

    /// How the process ended, if it has.
    pub(super) fn ended(&mut self) -> Option<ExitStatus> {
        self.child.try_wait().ok().flatten()
    }

    /// Has it logged a line with these words?
    pub(super) fn logged(&self, words: &str) -> bool {
        std::fs::read_to_string(&self.log).is_ok_and(|log| log.contains(words))
    }

    /// Asks the process to end, waits, and answers with what it printed on standard output.
    pub(super) async fn stop(mut self) -> Result<String, Rejection> {
        if let Some(pid) =
            self.child.id().and_then(|id| i32::try_from(id).ok()).and_then(rustix::process::Pid::from_raw)
        {
            let _gone = rustix::process::kill_process(pid, rustix::process::Signal::TERM);
        }
        let mut printed = String::new();
        let ended = async {
            if let Some(mut stdout) = self.child.stdout.take() {
                stdout.read_to_string(&mut printed).await?;
            }
            self.child.wait().await
        };
        match tokio::time::timeout(STOP_TIME_MAX, ended).await {
            Ok(Ok(status)) if status.success() => Ok(printed),
            Ok(Ok(status)) => {
                Err(Rejection::new(Code::Internal, format!("{} failed: {status}", self.name)).found(self.log_end()))
            }
            Ok(Err(error)) => Err(Rejection::new(Code::Internal, format!("cannot watch {}: {error}", self.name))),
            Err(_) => {
                let _killed = self.child.kill().await;
                Err(Rejection::new(Code::Internal, format!("{} did not end within {STOP_TIME_MAX:?}", self.name))
                    .found(self.log_end()))
            }
        }
    }

    fn log_end(&self) -> String {
        let log = std::fs::read_to_string(&self.log).unwrap_or_default();
        let lines: Vec<_> = log.lines().rev().take(5).collect();
        lines.into_iter().rev().collect::<Vec<_>>().join(" | ")
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        // An error means that it has ended and was waited for already.
        if self.child.start_kill().is_err() {
            return;
        }
        let deadline = Instant::now() + KILL_TIME_MAX;
        while matches!(self.child.try_wait(), Ok(None)) && Instant::now() < deadline {
            std::thread::sleep(Duration::from_millis(2));
        }
    }
}
