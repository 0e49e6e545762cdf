//! Calls that end control for safety: each is signed and sent again until it is in force.
//!
//! A call without a verdict may never be ordered. So the command ends with success only once the ledger has executed the call.
//! Ended before, by its timeout or by Ctrl-C, it ends with an error that says so.

use crate::failure::Failure;
use crate::output::Output;
use crate::session::Session;
use ledger_api::v1::OpenStop;
use ledger_base::rejection::{Class, Code, Rejection};
use std::future::pending;
use std::time::Duration;
use tokio::time::{Instant, sleep, sleep_until};

/// Time without a verdict after which the node is asked whether robots were notified.
const ASK_AFTER: Duration = Duration::from_secs(1);
/// Pause between two attempts that were rejected at once.
const PAUSE: Duration = Duration::from_millis(500);

/// The call, for people.
pub(crate) struct Described<'a> {
    /// `the stop of Turtlebot4`.
    pub(crate) what: String,
    /// The command that repeats it.
    pub(crate) command: String,
    /// The robot that is stopped (or `*`), of which nodes notify robots ahead of ordering; none for another call.
    pub(crate) robot: Option<&'a str>,
}

/// Calls it again and again until it is in force; `attempt` signs it again each time.
///
/// # Errors
/// A final rejection; [`Code::Timeout`] if it is not in force when the timeout is over or on Ctrl-C.
pub(crate) async fn until_in_force<T, F: Future<Output = Result<T, Rejection>>>(
    session: &Session,
    described: &Described<'_>,
    timeout: Option<Duration>,
    output: &Output,
    attempt: impl Fn() -> F,
) -> Result<T, Failure> {
    let until = timeout.map(|timeout| Instant::now() + timeout);
    let mut progress = Progress::default();
    let end = async {
        match until {
            Some(until) => sleep_until(until).await,
            None => pending().await,
        }
    };
    let found = tokio::select! {
        done = progress.call(session, described, output, attempt) => return done.map_err(Failure::from),
        () = end => "the timeout expired",
        _ = tokio::signal::ctrl_c() => "it was interrupted",
    };
    Err(described.not_in_force(found, &progress).into())
}

impl Described<'_> {
    fn not_in_force(&self, found: &str, progress: &Progress) -> Rejection {
        let state = if progress.is_told { "sent to the robots, not in force" } else { "not in force" };
        let last = progress.last.as_ref().map(|last| format!("; the last answer: {} [{}]", last.message, last.code));
        Rejection::new(Code::Timeout, format!("{} is not in force: repeat it", self.what))
            .found(format!("{state}: {found}{}", last.unwrap_or_default()))
            .wanted("its verdict in a block")
            .next(&self.command)
    }
}

/// The result of the attempts so far.
#[derive(Default)]
struct Progress {
    /// A node has notified robots of it.
    is_told: bool,
    /// It was noted that it is not in force.
    is_noted: bool,
    /// The last answer that was no end.
    last: Option<Rejection>,
}

impl Progress {
    async fn call<T, F: Future<Output = Result<T, Rejection>>>(
        &mut self,
        session: &Session,
        described: &Described<'_>,
        output: &Output,
        attempt: impl Fn() -> F,
    ) -> Result<T, Rejection> {
        loop {
            let answer = {
                let mut answer = std::pin::pin!(attempt());
                loop {
                    let asked = async {
                        sleep(ASK_AFTER).await;
                        is_told(session, described).await
                    };
                    tokio::select! {
                        answer = &mut answer => break answer,
                        told = asked => self.note(told, described, output),
                    }
                }
            };
            match answer {
                Err(refused) if is_no_end(refused.code) => {
                    self.note(false, described, output);
                    self.last = Some(refused);
                    sleep(PAUSE).await;
                }
                end => return end,
            }
        }
    }

    fn note(&mut self, is_told: bool, described: &Described<'_>, output: &Output) {
        let what = &described.what;
        if is_told && !self.is_told {
            output.note(&format!("{what} is sent to the robots, not in force yet; it is repeated until it is"));
        } else if !self.is_told && !self.is_noted {
            output.note(&format!("{what} is not in force yet; it is repeated until it is"));
        }
        (self.is_told, self.is_noted) = (self.is_told || is_told, true);
    }
}

/// Must the call be signed and sent again?
fn is_no_end(code: Code) -> bool {
    code.class() == Class::Unreachable || matches!(code, Code::Expired | Code::NotAfterTooFar | Code::Duplicate)
}

/// Has the node notified robots of a stop of ours that has no verdict yet?
async fn is_told(session: &Session, described: &Described<'_>) -> bool {
    let (Some(robot), Ok(own)) = (described.robot, session.identity()) else { return false };
    let Ok(status) = session.client.status().await else { return false };
    let by = own.id();
    status.open_stops.iter().any(|OpenStop { robot: stopped, by: signer, .. }| stopped == robot && *signer == by)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_call_without_a_verdict_is_repeated_and_a_rejected_one_is_not() {
        for code in [Code::Timeout, Code::NoLeader, Code::Unreachable, Code::Overloaded, Code::Expired] {
            assert!(is_no_end(code), "{code}");
        }
        for code in [Code::DeniedByPolicy, Code::UnknownRobot, Code::Refused, Code::Revoked] {
            assert!(!is_no_end(code), "{code}");
        }
    }

    #[test]
    fn ended_before_it_says_that_it_is_not_in_force_and_fails() {
        let described = Described {
            what: "the stop of Turtlebot4".to_owned(),
            command: "ledgerctl stop Turtlebot4".to_owned(),
            robot: Some("Turtlebot4"),
        };
        let progress = Progress { is_told: true, ..Progress::default() };
        let refused = described.not_in_force("it was interrupted", &progress);
        assert_eq!(refused.message, "the stop of Turtlebot4 is not in force: repeat it");
        assert_eq!(refused.found, "sent to the robots, not in force: it was interrupted");
        assert_eq!((refused.code.class().exit_code(), refused.advice()), (4, "ledgerctl stop Turtlebot4"));
    }
}
