//! Acts for one robot.

use std::{
    sync::{Arc, Mutex, PoisonError},
    time::{Duration, Instant},
};

use bytes::Bytes;
use ledger_base::rejection::{Class, Code, Rejection};
use ledger_contract::{Acquired, EmergencyAnswer, Grant, LineState, Released};
use ledger_gate::ABAC;
use serde::de::DeserializeOwned;
use tokio::time::{sleep, timeout};

use super::{
    answer::{Answer, holders, pending, queued},
    kept::{Due, KeptGrants},
};
use crate::{
    graph::names::TopicName,
    ledger::gateway::{Gateway, read},
    log::one_line,
    routes::table::Roster,
};

/// How long the ledger may take for an answer.
const ANSWER_MAX: Duration = Duration::from_secs(8);
/// Between two looks at what is to be renewed.
const LOOK_EVERY: Duration = Duration::from_millis(250);

/// Acts for one robot.
pub(super) struct RobotGrants {
    gateway: Arc<dyn Gateway>,
    roster: Arc<Roster>,
    robot: String,
    /// The robot in ROS, `/Turtlebot4`.
    name: String,
    keeping: Mutex<KeptGrants>,
}

impl RobotGrants {
    pub(super) fn new(gateway: Arc<dyn Gateway>, roster: Arc<Roster>, robot: &str, name: &TopicName) -> Self {
        let name = name.as_str().to_owned();
        Self { gateway, roster, robot: robot.to_owned(), name, keeping: Mutex::default() }
    }

    /// Gets what this bridge drives of the robot: all of it, or nothing.
    pub(super) async fn acquire(&self) -> Answer {
        let services = self.roster.held_services(&self.robot);
        let done = match services.as_slice() {
            [] => {
                let robot = &self.robot;
                return Answer::yes(format!(
                    "{robot} needs no grant here: everybody may use it whom its policies permit"
                ));
            }
            [service] => self.acquire_one(service).await,
            several => self.acquire_all(several).await,
        };
        match done {
            Ok(grants) => {
                let name = &self.name;
                let held: Vec<String> =
                    grants.iter().map(|grant| format!("{} is yours, epoch {}", grant.service, grant.epoch)).collect();
                let until = format!("until {name}/release is called, it is taken back, or this bridge ends");
                Answer::yes(format!("{}; {until}", held.join(", ")))
            }
            Err(refused) if refused.code == Code::Held => Answer::no(&self.with_holders(refused, &services).await),
            Err(refused) => Answer::no(&refused),
        }
    }

    async fn acquire_one(&self, service: &str) -> Result<Vec<Grant>, Rejection> {
        match self.call("acquire", &[service]).await? {
            Acquired::Granted(grant) => {
                self.keep_one(&grant);
                Ok(vec![*grant])
            }
            Acquired::Queued { queued: place } => {
                self.lock().wait(service);
                Err(queued(&place, &self.name))
            }
            Acquired::Pending { pending: state } => Err(pending(&state)),
        }
    }

    async fn acquire_all(&self, services: &[String]) -> Result<Vec<Grant>, Rejection> {
        let args: Vec<&str> = std::iter::once("{}").chain(services.iter().map(String::as_str)).collect();
        let grants: Vec<Grant> = self.call("acquire_all", &args).await?;
        grants.iter().for_each(|grant| self.keep_one(grant));
        Ok(grants)
    }

    /// Tells who holds them, and since when, as far as that can be learnt.
    async fn with_holders(&self, refused: Rejection, services: &[String]) -> Rejection {
        let mut found = Vec::new();
        for service in services {
            let answer = self.gateway.query(0, ABAC, "line", vec![Bytes::from(service.clone())]);
            let Ok(Ok(answer)) = timeout(ANSWER_MAX, answer).await else { continue };
            found.extend(read::<LineState>("abac line", &answer.response).ok().map(|line| holders(&line, answer.time)));
        }
        if found.is_empty() { refused } else { refused.found(found.join("; ")) }
    }

    /// Gives back what it holds of the robot, and leaves its lines.
    pub(super) async fn release(&self) -> Answer {
        let services = self.roster.held_services(&self.robot);
        self.lock().forget();
        let (mut told, mut nothing) = (Vec::new(), None);
        for service in &services {
            match self.call::<Vec<Released>>("release", &[service]).await {
                Ok(ended) if ended.is_empty() => told.push(format!("you have left the line of {service}")),
                Ok(_) => told.push(format!("{service} is released")),
                Err(refused) if refused.code == Code::NotHolder => nothing = Some(refused),
                Err(refused) => return Answer::no(&refused),
            }
        }
        match nothing {
            Some(refused) if told.is_empty() => Answer::no(&refused),
            _ if services.is_empty() => Answer::yes(format!("{} needs no grant here: there is none", self.robot)),
            _ => Answer::yes(told.join(", ")),
        }
    }

    /// Stops the robot, until somebody resumes it.
    pub(super) async fn stop(&self) -> Answer {
        let Self { robot, name, .. } = self;
        match self.call::<EmergencyAnswer>("stop", &[robot, &format!("{name}/stop was called")]).await {
            Ok(EmergencyAnswer { ended, .. }) => {
                let goes_on = format!("ledgerctl resume {robot} lets it go on");
                Answer::yes(format!("{robot} is stopped, {} grants have ended; {goes_on}", ended.len()))
            }
            Err(refused) => {
                let refused = match refused.code.class() {
                    Class::Unreachable => refused.prefix("the stop is not in force, call it again: "),
                    _ => refused,
                };
                let own = format!("call {name}/release, which stops it if you hold it");
                let next = if refused.advice().is_empty() { own } else { format!("{}; or {own}", refused.advice()) };
                Answer::no(&refused.next(next))
            }
        }
    }

    /// Renews what is held, as long as it runs.
    pub(super) async fn keep(&self) {
        loop {
            sleep(LOOK_EVERY).await;
            let held = self.roster.held_now(&self.robot);
            let due = self.lock().due(&held, Instant::now());
            for Due(service) in due {
                match self.call::<Grant>("renew", &[&service]).await {
                    Ok(grant) => self.renewed(&grant),
                    Err(refused) => {
                        if self.lock().failed(&service, refused.code == Code::NotHolder) {
                            tracing::info!(
                                service,
                                code = refused.code.name(),
                                reason = one_line(&refused),
                                "the grant is kept no longer"
                            );
                        }
                    }
                }
            }
        }
    }

    fn keep_one(&self, grant: &Grant) {
        self.lock().hold(&grant.service, Duration::from_millis(grant.lease_ms), Instant::now());
    }

    /// Unless it was released meanwhile.
    fn renewed(&self, grant: &Grant) {
        self.lock().renewed(&grant.service, Duration::from_millis(grant.lease_ms), Instant::now());
    }

    async fn call<T: DeserializeOwned>(&self, function: &str, args: &[&str]) -> Result<T, Rejection> {
        let args = args.iter().map(|arg| Bytes::copy_from_slice(arg.as_bytes())).collect();
        let response = timeout(ANSWER_MAX, self.gateway.invoke(function, args)).await.map_err(|_| {
            Rejection::new(Code::Timeout, format!("the ledger has not answered to {function}"))
                .found(format!("no answer within {} s: it may have happened or not", ANSWER_MAX.as_secs()))
                .wanted("a verdict")
                .next("call again, or look at ledgerctl status")
        })??;
        read(&format!("{ABAC} {function}"), &response)
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, KeptGrants> {
        self.keeping.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
