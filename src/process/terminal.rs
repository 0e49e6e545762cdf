//! Lines on the terminal, and the signals that stop a process.

use ledger_base::rejection::{Code, Rejection};
use std::future::Future;

/// Catches SIGINT and SIGTERM from now on; the future ends when one of them comes. Called before a node starts, so that
/// it ends in order whenever it is asked to. Must be called inside a tokio runtime.
pub fn stop_signal() -> impl Future<Output = ()> {
    use tokio::signal::unix::{Signal, SignalKind, signal};
    let listen = |kind| {
        let listening = signal(kind);
        listening
            .inspect_err(|error| tracing::warn!(%error, signal = kind.as_raw_value(), "cannot wait for this signal"))
            .ok()
    };
    async fn received(signal: Option<Signal>) {
        match signal {
            Some(mut signal) => drop(signal.recv().await),
            None => std::future::pending().await,
        }
    }
    let (terminate, interrupt) = (listen(SignalKind::terminate()), listen(SignalKind::interrupt()));
    async move {
        tokio::select! {
            () = received(terminate) => {}
            () = received(interrupt) => {}
        }
    }
}

/// As [`stop_signal`], and the future ends when the terminal is closed, too (SIGHUP), unless the process was started to outlive it, as
/// `nohup` does.
pub(crate) fn stop_signal_of_terminal() -> impl Future<Output = ()> {
    use tokio::signal::unix::{SignalKind, signal};
    let closed = if ignores_hangup() { None } else { signal(SignalKind::hangup()).ok() };
    let stopped = stop_signal();
    async move {
        let closed = async {
            match closed {
                Some(mut closed) => drop(closed.recv().await),
                None => std::future::pending().await,
            }
        };
        tokio::select! {
            () = stopped => {}
            () = closed => {}
        }
    }
}

/// Was the process started with SIGHUP ignored? Its bit is the lowest of the mask that the kernel shows.
fn ignores_hangup() -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).is_some_and(|mask| mask & 1 == 1)
}

/// Prints a line of the results. A reader that has gone away (`ledgerd … | head -1`) is no failure.
///
/// # Errors
/// [`Code::BadFile`] if it cannot be written, such as to a full disk.
pub fn print_line(text: &str) -> Result<(), Rejection> {
    use std::io::Write;
    let mut out = std::io::stdout();
    written(writeln!(out, "{text}").and_then(|()| out.flush()))
}

/// The rejection of results that could not be written.
pub(crate) fn written(done: std::io::Result<()>) -> Result<(), Rejection> {
    match done {
        Err(error) if error.kind() != std::io::ErrorKind::BrokenPipe => {
            Err(Rejection::new(Code::BadFile, "cannot write the results to standard output")
                .found(error.to_string())
                .wanted("a terminal, a pipe, or a file with free space")
                .next("write to another place; check first whether the command has taken effect"))
        }
        _ => Ok(()),
    }
}

/// Prints a line on standard error.
pub fn eprint_line(text: &str) {
    use std::io::Write;
    let _closed = writeln!(std::io::stderr(), "{text}");
}

/// Shows lines on standard error and asks on the terminal; none if standard input is no terminal.
pub(crate) fn asked(lines: &[String], question: &str) -> Option<bool> {
    use std::io::{BufRead, IsTerminal, Write, stderr, stdin};
    if !stdin().is_terminal() {
        return None;
    }
    lines.iter().for_each(|line| eprint_line(line));
    let _closed = write!(stderr(), "{question}").and_then(|()| stderr().flush());
    let mut answer = String::new();
    let _nothing = stdin().lock().read_line(&mut answer);
    Some(answer.trim() == "yes")
}
