//! `acquire --keep`: renews grants until Ctrl-C releases them, or until they are lost.

use super::{RELEASE, RENEW};
use crate::answer;
use crate::failure::Failure;
use crate::output::Output;
use crate::session::{ABAC, Session};
use bytes::Bytes;
use ledger_api::{EventStream, Subscription};
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{Grant, Reason, Released};
use std::time::Duration;
use tokio::signal::unix::{SignalKind, signal};
use tokio::time::{Instant, sleep, timeout, timeout_at};

/// Renewals within one lease: two may fail before it ends.
const RENEWALS: u32 = 3;
/// Pause between two attempts at a renewal while no node takes it.
const PAUSE: Duration = Duration::from_millis(250);
/// Time in which the event that ended a grant follows the rejection of its renewal.
const REASON_WITHIN: Duration = Duration::from_secs(2);
/// How often the node says that it is alive while nothing changes, in milliseconds.
const HEARTBEAT_MS: u32 = 2_000;

/// Grants that are renewed.
pub(crate) struct Kept<'s> {
    session: &'s Session,
    grants: Vec<Grant>,
}

impl<'s> Kept<'s> {
    /// To renew these grants.
    pub(crate) fn of(session: &'s Session, grants: Vec<Grant>) -> Self {
        Self { session, grants }
    }

    /// Renews them until Ctrl-C or a signal to terminate, and releases them then.
    ///
    /// # Errors
    /// Why they are held no longer: [`Code::Stopped`], [`Code::NotHolder`] and others for a grant that ended,
    /// [`Code::Unreachable`] if no node took a renewal within the lease.
    pub(super) async fn until_interrupted(&self, height: u64, output: &Output) -> Result<(), Failure> {
        let services = self.services();
        let mut ends = Interrupts::new()?;
        output.note(&format!("{services}: renewed until Ctrl-C, which releases"));
        let lost = tokio::select! {
            () = ends.next() => None,
            lost = self.until_lost(height, output) => Some(lost),
        };
        let Some(lost) = lost else {
            tokio::select! {
                released = self.release() => released?,
                () = ends.next() => {
                    return Err(Rejection::new(Code::Timeout, format!("{services}: not released, interrupted again"))
                        .next(format!("the lease expires by itself; to end it now: ledgerctl release {services}")).into());
                }
            }
            output.note(&format!("{services}: released"));
            return Ok(());
        };
        // A holder who wanted all of several grants has no use for the rest.
        if self.grants.len() > 1 {
            self.release().await?;
        }
        Err(lost.into())
    }

    /// Renews them until one is lost, and says why.
    async fn until_lost(&self, height: u64, output: &Output) -> Rejection {
        let mut ended = self.session.client.subscribe(Subscription {
            from_height: height + 1,
            chaincode: ABAC.to_owned(),
            subjects: self.grants.iter().map(|grant| grant.service.clone()).collect(),
            names: vec!["released".to_owned()],
            heartbeat: HEARTBEAT_MS,
            ..Subscription::default()
        });
        let refused = tokio::select! {
            refused = self.renewals(|text| output.note(text)) => refused,
            end = self.end(&mut ended) => return end.unwrap_or_else(|refused| refused),
        };
        match timeout(REASON_WITHIN, self.end(&mut ended)).await {
            Ok(Ok(end)) if refused.code.is_final() => end,
            _ => refused,
        }
    }

    /// The end of one of the grants.
    async fn end(&self, ended: &mut EventStream) -> Result<Rejection, Rejection> {
        loop {
            for event in ended.next().await?.events {
                let released: Released = answer::parse(&event.payload, "the end of a grant")?;
                let is_ours = |grant: &Grant| grant.service == released.service && grant.epoch == released.epoch;
                if self.grants.iter().any(|grant| is_ours(grant) && grant.holder == released.holder) {
                    return Ok(lost(&released));
                }
            }
        }
    }

    /// Renews them again and again. Ends with the rejection of a renewal that is final, or of the last attempt within the lease.
    /// `note` gets a line when renewals fail and when they work again.
    pub(crate) async fn renewals(&self, note: impl Fn(&str)) -> Rejection {
        let lease = self.grants.iter().map(|grant| Duration::from_millis(grant.lease_ms)).min().unwrap_or_default();
        // The wait for a certificate has used up a part of the lease: the first renewal is now.
        let mut renewed = Instant::now();
        loop {
            let begun = Instant::now();
            let mut last = None;
            match timeout_at(renewed + lease, self.renew_all(&mut last, &note)).await {
                Ok(Ok(())) => renewed = begun,
                Ok(Err(refused)) => return refused,
                Err(_late) => return self.unrenewed(last),
            }
            if last.is_some() {
                note(&format!("{}: renewed again", self.services()));
            }
            sleep(lease / RENEWALS).await;
        }
    }

    /// Renews each of them, and tries again while no node takes it.
    async fn renew_all(&self, last: &mut Option<Rejection>, note: &impl Fn(&str)) -> Result<(), Rejection> {
        for Grant { service, .. } in &self.grants {
            let args = || vec![Bytes::from(service.clone())];
            while let Err(refused) = self.session.client.execute(ABAC, "renew", args()).await {
                if refused.code.is_final() {
                    return Err(RENEW.told(refused));
                }
                if last.is_none() {
                    note(&format!("{service}: renewal failed, retrying: {} [{}]", refused.message, refused.code));
                }
                *last = Some(refused);
                sleep(PAUSE).await;
            }
        }
        Ok(())
    }

    fn unrenewed(&self, last: Option<Rejection>) -> Rejection {
        let services = self.services();
        let found = last.map_or_else(
            || "no answer".to_owned(),
            |Rejection { message, code, .. }| format!("the last answer: {message} [{code}]"),
        );
        Rejection::new(Code::Unreachable, format!("{services}: no node has renewed the grant within its lease"))
            .found(found)
            .wanted("an answer within the lease")
            .next(format!("once nodes answer: ledgerctl acquire {services} --keep; a longer lease: --for 5m"))
    }

    /// Releases all of them. One that has ended meanwhile is none that is left.
    pub(crate) async fn release(&self) -> Result<(), Rejection> {
        for Grant { service, .. } in &self.grants {
            match self.session.call(ABAC, "release", vec![Bytes::from(service.clone())]).await {
                Err(refused) if refused.code != Code::NotHolder => return Err(RELEASE.told(refused)),
                _ => {}
            }
        }
        Ok(())
    }

    fn services(&self) -> String {
        self.grants.iter().map(|grant| grant.service.as_str()).collect::<Vec<_>>().join(" ")
    }
}

/// The signals that end the command in order.
struct Interrupts {
    interrupt: tokio::signal::unix::Signal,
    terminate: tokio::signal::unix::Signal,
}

impl Interrupts {
    fn new() -> Result<Self, Rejection> {
        let listen =
            |kind| signal(kind).map_err(|error| Rejection::new(Code::Internal, "no signals").found(error.to_string()));
        Ok(Self { interrupt: listen(SignalKind::interrupt())?, terminate: listen(SignalKind::terminate())? })
    }

    async fn next(&mut self) {
        tokio::select! {
            _ = self.interrupt.recv() => {}
            _ = self.terminate.recv() => {}
        }
    }
}

/// The end of a grant, for its former holder.
fn lost(released: &Released) -> Rejection {
    let Released { service, epoch, reason, by, .. } = released;
    let by = by.as_deref().unwrap_or("another user");
    let again = format!("ledgerctl acquire {service} --keep");
    let (code, why, next) = match reason.known() {
        Some(Reason::Stopped) => {
            (Code::Stopped, "the robot was stopped".to_owned(), format!("once it is resumed: {again}"))
        }
        Some(Reason::Preempted) => (Code::NotHolder, format!("preempted by {by}, with a higher priority"), again),
        Some(Reason::Overridden) => (Code::NotHolder, format!("overridden by {by} in an emergency"), again),
        Some(Reason::Taken) => (Code::NotHolder, "its owner revoked the grant".to_owned(), again),
        Some(Reason::Policy) => {
            let next = format!("to see why: ledgerctl can ORG/NAME acquire {service}, with your name");
            (Code::DeniedByPolicy, "the policies of its owner no longer permit it".to_owned(), next)
        }
        Some(Reason::Revoked) => {
            let next = "ask an admin of your organisation".to_owned();
            (Code::Revoked, "your certificate is revoked".to_owned(), next)
        }
        Some(Reason::Expired) => (Code::NotHolder, "its lease expired before a renewal".to_owned(), again),
        Some(Reason::Idle) => {
            let why = "no message within the limit of its owner (idle-release)".to_owned();
            (Code::NotHolder, why, again)
        }
        Some(Reason::Released) => (Code::NotHolder, "another command of yours released it".to_owned(), again),
        Some(Reason::RobotRemoved) => {
            (Code::UnknownService, "it was removed".to_owned(), "ledgerctl robot list".to_owned())
        }
        Some(Reason::Delegated) => (Code::NotHolder, "you delegated it".to_owned(), again),
        Some(Reason::Recalled) => (Code::NotHolder, format!("{by} recalled it"), again),
        _ => (Code::NotHolder, format!("it ended: {reason}"), again),
    };
    Rejection::new(code, format!("{service} is no longer held: {why}"))
        .found(format!("the end of the grant with epoch {epoch}: {reason}"))
        .wanted("a grant to renew")
        .next(next)
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    fn ended(reason: &str, by: &str) -> Rejection {
        let json =
            format!(r#"{{"service":"Husky/cmd_vel","holder":"Org1/Salma","epoch":3,"reason":"{reason}","by":"{by}"}}"#);
        lost(&serde_json::from_str(&json).unwrap())
    }

    #[test]
    fn an_end_names_its_reason_and_has_the_exit_code_of_its_kind() {
        for (reason, part, exit) in [
            ("stopped", "the robot was stopped", 5),
            ("preempted", "preempted by Org1/Farhad", 2),
            ("overridden", "overridden by Org1/Farhad", 2),
            ("policy", "no longer permit it", 2),
            ("revoked", "your certificate is revoked", 2),
            ("expired", "its lease expired", 2),
            ("released", "another command of yours", 2),
            ("invented_later", "it ended: invented_later", 2),
        ] {
            let refused = ended(reason, "Org1/Farhad");
            assert!(refused.message.contains(part), "{refused}");
            assert_eq!(refused.code.class().exit_code(), exit, "{refused}");
        }
    }
}
