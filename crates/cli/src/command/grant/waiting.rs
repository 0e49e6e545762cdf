//! Waiting for a service, in line or to be confirmed: a live line of where we are and who holds it, until the service is ours.

use super::line::turn;
use super::{Granted, confirm};
use crate::answer;
use crate::failure::Failure;
use crate::output::Output;
use crate::session::{ABAC, Session};
use bytes::Bytes;
use ledger_api::{EventStream, Subscription, v1};
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{Grant, Left, LeftReason, LineState, Pending, Place};
use std::io::{self, IsTerminal, Write};

/// How often the node says that it is alive while nothing changes, in milliseconds.
const HEARTBEAT_MS: u32 = 2_000;

/// A wait for a service: in line, or to be confirmed.
pub(super) struct Waiting<'s> {
    session: &'s Session,
    stream: EventStream,
    service: String,
    contender: String,
    /// Width of the live line on the terminal; 0 while there is none.
    shown: usize,
}

/// The outcome of the wait.
enum End {
    Granted(Box<Granted>),
    Left(Left),
}

impl<'s> Waiting<'s> {
    /// Waits in a place that was given at this height.
    pub(super) fn in_line(session: &'s Session, place: Place, height: u64) -> Self {
        Self::begin(session, place.service, place.contender, height)
    }

    /// Waits to be confirmed, as asked at this height.
    pub(super) fn for_confirmation(session: &'s Session, pending: Pending, height: u64) -> Self {
        Self::begin(session, pending.service, pending.contender, height)
    }

    fn begin(session: &'s Session, service: String, contender: String, height: u64) -> Self {
        let stream = session.client.subscribe(Subscription {
            from_height: height + 1,
            chaincode: ABAC.to_owned(),
            subjects: vec![service.clone()],
            names: ["confirmed", "granted", "left", "line", "queued", "released"].map(str::to_owned).to_vec(),
            heartbeat: HEARTBEAT_MS,
            ..Subscription::default()
        });
        Self { session, stream, service, contender, shown: 0 }
    }

    /// Waits until the service is ours, until our patience ends, or until Ctrl-C, which leaves the line.
    pub(super) async fn until_granted(mut self, output: &Output) -> Result<Granted, Failure> {
        let end = tokio::select! {
            end = self.follow() => end,
            _ = tokio::signal::ctrl_c() => {
                self.clear();
                return self.leave(output).await;
            }
        };
        self.clear();
        match end? {
            End::Granted(granted) => Ok(*granted),
            End::Left(left) => Err(self.refused(&left).into()),
        }
    }

    async fn follow(&mut self) -> Result<End, Rejection> {
        self.look_again().await?;
        loop {
            let delivery = self.stream.next().await?;
            for event in &delivery.events {
                if let Some(end) = self.read(&delivery, event)? {
                    return Ok(end);
                }
            }
            if !delivery.events.is_empty() {
                self.look_again().await?;
            }
        }
    }

    /// The end of the wait, if the event tells it.
    fn read(&self, delivery: &v1::Delivery, event: &v1::EventRecord) -> Result<Option<End>, Rejection> {
        match event.name.as_str() {
            "granted" => {
                let grant: Grant = answer::parse(&event.payload, "a grant")?;
                let is_ours = grant.holder == self.contender;
                let (time, height) = (delivery.time, delivery.height);
                // The block itself gave it: no transaction of ours did.
                let (transaction, certified) = (Hash::ZERO, !delivery.proof.is_empty());
                let granted = Granted {
                    grant,
                    time,
                    height,
                    transaction,
                    certified,
                    lease_ms_max: None,
                    kept: false,
                    renewed: false,
                    passed_on: false,
                };
                Ok(is_ours.then(|| End::Granted(Box::new(granted))))
            }
            "left" => {
                let left: Left = answer::parse(&event.payload, "an event of a queue")?;
                Ok((left.contender == self.contender).then_some(End::Left(left)))
            }
            _ => Ok(None),
        }
    }

    /// Shows where we are and who holds the service.
    async fn look_again(&mut self) -> Result<(), Rejection> {
        if !io::stderr().is_terminal() {
            return Ok(());
        }
        let response = self.session.ask(ABAC, "line", vec![Bytes::from(self.service.clone())]).await?;
        let text = self.state(&answer::parse(&response, "a queue")?);
        let text = crate::output::printable(&text).into_owned();
        let width = text.chars().count();
        let _ = write!(io::stderr(), "\r{text}{}", " ".repeat(self.shown.saturating_sub(width)));
        let _ = io::stderr().flush();
        self.shown = width;
        Ok(())
    }

    /// Where we are, and who holds the service.
    fn state(&self, state: &LineState) -> String {
        let Self { service, contender, .. } = self;
        let holders: Vec<&str> = state.holders.iter().map(|grant| grant.holder.as_str()).collect();
        let holders = if holders.is_empty() { "none".to_owned() } else { holders.join(", ") };
        if let Some(pending) = state.pending.iter().find(|pending| pending.contender == *contender) {
            return format!("{service}: confirmed by {}, held by {holders}", confirm::state(pending));
        }
        let Some(place) = state.line.iter().find(|place| place.contender == *contender) else {
            return format!("{service}: held by {holders}");
        };
        let (length, turn) = (state.line.len(), turn(place, self.session.client.now()));
        format!("{service}: position {} of {length}, held by {holders}, your turn: {turn}", place.position)
    }

    /// Takes the live line off the terminal.
    fn clear(&mut self) {
        if self.shown > 0 {
            let _ = write!(io::stderr(), "\r{}\r", " ".repeat(self.shown));
            self.shown = 0;
        }
    }

    /// Leaves the line, or gives the service back if it has just become ours.
    async fn leave(&self, output: &Output) -> Result<Granted, Failure> {
        let service = self.service.clone();
        match self.session.call(ABAC, "release", vec![Bytes::from(service.clone())]).await {
            Ok(_) => output.note(&format!("you left the queue of {service}")),
            // We were neither in line nor holders any more.
            Err(refused) if refused.code == Code::NotHolder => {}
            Err(refused) => return Err(refused.into()),
        }
        Err(Rejection::new(Code::Held, format!("{service} is not acquired: you stopped waiting")).into())
    }

    fn refused(&self, left: &Left) -> Rejection {
        let service = &self.service;
        let (code, why) = match left.reason.known() {
            Some(LeftReason::TimedOut) => (Code::Held, "others held it for your whole waiting time"),
            Some(LeftReason::Policy) => (Code::DeniedByPolicy, "its policies no longer permit you to acquire it"),
            Some(LeftReason::Revoked) => (Code::Revoked, "your certificate is revoked"),
            Some(LeftReason::Expired) => (Code::CertificateExpired, "your certificate has expired"),
            Some(LeftReason::Unconfirmed) => (Code::Held, "not enough confirmations in time"),
            Some(LeftReason::Left) => (Code::Held, "another command of yours left the queue"),
            Some(LeftReason::Removed) => (Code::Held, "an admin of its owner removed you from the queue"),
            Some(LeftReason::RobotRemoved) => (Code::UnknownService, "it was removed"),
            Some(LeftReason::Rule) => (Code::Held, "its owner changed the rule, which shortened or removed the queue"),
            _ => (Code::Held, "you are no longer in the queue"),
        };
        Rejection::new(code, format!("{service} is not acquired: {why}"))
            .found(format!("removed from the queue: {}", left.reason))
            .wanted(format!("a grant of {service} to {}", self.contender))
            .next(format!("to see holders and queue: ledgerctl queue {service}"))
    }
}
