//! Follows the robots on the ledger, and has the routes of a bridge come and go with them.
//!
//! The node tells which robots there are, and may lie: it can hide one, or make one up. A route of a robot that does not
//! exist carries nothing, as a gate and the ledger itself decide about messages.

use std::{
    collections::BTreeSet,
    sync::Arc,
    time::{Duration, Instant},
};

use futures::{StreamExt, stream};
use ledger_api::{Subscription, pages};
use ledger_base::rejection::{Class, Code, Rejection};
use ledger_contract::RobotAsset;
use ledger_gate::ABAC;
use tokio::time::{sleep, sleep_until};

use super::{
    offer::{Candidate, NotOffered, candidates},
    settings::Settings,
};
use crate::{
    ledger::{
        gateway::{Deliveries, Gateway, HEARTBEAT_MS, ask},
        service::Authorization,
    },
    log::one_line,
    routes::{kind::RouteConfig, table::RouteTable},
    shutdown::{Shutdown, requested},
};

/// Most discovered routes of a bridge.
const DISCOVERED_MAX: usize = 128;
/// Questions about rights that are under way at a time.
const QUESTIONS_MAX: usize = 8;
/// Between two looks, whatever the ledger tells: a look costs as much as there are robots.
const LOOK_PAUSE: Duration = Duration::from_millis(250);
/// A look without news: a user may have got another certificate, with other attributes.
const LOOK_EVERY: Duration = Duration::from_secs(30);
/// Pause after a look that failed.
const RETRY_PAUSE: Duration = Duration::from_secs(2);
/// Services without a route that a line of the log names.
const NAMED_MAX: usize = 5;

/// Discovers the routes of a bridge.
pub(crate) struct Discovery {
    settings: Settings,
    gateway: Arc<dyn Gateway>,
    table: Arc<RouteTable>,
    left: BTreeSet<NotOffered>,
    /// The reason why the last look failed.
    failed: Option<String>,
    /// The newest height that the ledger has told.
    seen: u64,
}

/// The routes that there are to be.
struct Wanted {
    routes: Vec<RouteConfig>,
    left: Vec<NotOffered>,
    /// The state was at least that of this height.
    height: u64,
}

impl Discovery {
    pub(crate) fn new(settings: Settings, gateway: Arc<dyn Gateway>, table: Arc<RouteTable>) -> Self {
        Self { settings, gateway, table, left: BTreeSet::new(), failed: None, seen: 0 }
    }

    /// Runs until it is told to end. The routes stay.
    pub(crate) async fn run(mut self, mut shutdown: Shutdown) {
        let mut news: Option<Deliveries> = None;
        loop {
            let wanted = tokio::select! {
                () = requested(&mut shutdown) => return,
                wanted = self.wanted() => wanted,
            };
            // From the first look on: what changes during it is looked at again.
            if let (None, Ok(Wanted { height, .. })) = (&news, &wanted) {
                news = Some(self.gateway.subscribe(Subscription {
                    from_height: height.saturating_add(1),
                    chaincode: ABAC.to_owned(),
                    names: ["robot", "policy"].map(str::to_owned).to_vec(),
                    heartbeat: HEARTBEAT_MS,
                    ..Subscription::default()
                }));
            }
            let deadline = Instant::now() + self.take_over(wanted).await;
            loop {
                tokio::select! {
                    biased;
                    () = requested(&mut shutdown) => return,
                    Some(delivery) = async { news.as_mut()?.next().await }, if news.is_some() => {
                        // An error is followed by more, some time later.
                        let Ok(delivery) = delivery else { continue };
                        self.table.heard(Instant::now());
                        self.seen = self.seen.max(delivery.height);
                        if !delivery.events.is_empty() {
                            break;
                        }
                    }
                    () = sleep_until(deadline.into()) => break,
                }
            }
            tokio::select! {
                () = requested(&mut shutdown) => return,
                () = sleep(LOOK_PAUSE) => {}
            }
        }
    }

    /// Hands over the routes. Answers when to look again, whatever happens.
    async fn take_over(&mut self, wanted: Result<Wanted, Rejection>) -> Duration {
        match wanted {
            Ok(Wanted { routes, left, .. }) => {
                self.failed = None;
                self.tell(left);
                self.table.discovered(routes).await;
                LOOK_EVERY
            }
            Err(refused) => {
                // The same reason once, not every two seconds. What was discovered stays.
                if self.failed.as_ref() != Some(&refused.message) {
                    let (code, reason) = (refused.code.name(), one_line(&refused));
                    tracing::warn!(code, reason, "cannot look which robots there are: {}", refused.message);
                    self.failed = Some(refused.message);
                }
                RETRY_PAUSE
            }
        }
    }

    async fn wanted(&self) -> Result<Wanted, Rejection> {
        let gateway = &self.gateway;
        // Another node may be behind the one that told of a change.
        let height = gateway.height().await?.max(self.seen);
        let page = |args| {
            let answer = gateway.query(height, ABAC, "robots", args);
            async { Ok(answer.await?.response) }
        };
        let robots: Vec<RobotAsset> = pages::follow("the answer to abac robots", page).await?;
        let (found, mut left) = candidates(&self.settings, &robots);
        let mut asked = stream::iter(found).map(|candidate| self.judge(height, candidate)).buffered(QUESTIONS_MAX);
        let mut routes = Vec::new();
        while let Some(outcome) = asked.next().await {
            match outcome? {
                Ok(_) if routes.len() >= DISCOVERED_MAX => {
                    let reason = format!("a bridge discovers at most {DISCOVERED_MAX} routes; use [discover] allow");
                    left.push(NotOffered { service: "the rest".to_owned(), reason });
                    break;
                }
                Ok(route) => routes.push(route),
                Err(refused) => left.push(refused),
            }
        }
        Ok(Wanted { routes, left, height })
    }

    /// Is a service offered? It is if the rights of the bridge's identity permit it, also while a grant or a place is
    /// missing. Where something else is in the way, the route says what.
    async fn judge(&self, height: u64, candidate: Candidate) -> Result<Result<RouteConfig, NotOffered>, Rejection> {
        let Candidate { route, .. } = candidate;
        let (service, right) = (route.service.as_str(), route.kind.right);
        let (rights, _): (Authorization, u64) =
            ask(&*self.gateway, height, ABAC, "authorize", &[service, right]).await?;
        let denied = rights.code().filter(|code| code.class() == Class::Denied && *code != Code::NotHolder);
        Ok(match denied {
            Some(code) => Err(NotOffered { service: service.to_owned(), reason: format!("{code} {}", rights.reason) }),
            None => Ok(route),
        })
    }

    /// Says which services have no route, where that is news.
    fn tell(&mut self, left: Vec<NotOffered>) {
        let left: BTreeSet<NotOffered> = left.into_iter().collect();
        let news: Vec<&NotOffered> = left.difference(&self.left).collect();
        if !news.is_empty() {
            let named =
                news.iter().take(NAMED_MAX).map(|NotOffered { service, reason }| format!("{service} ({reason})"));
            let named = named.collect::<Vec<_>>().join(", ");
            let count = news.len();
            let more = if count > NAMED_MAX { format!(" and {} more", count - NAMED_MAX) } else { String::new() };
            tracing::info!(count, "not offered: {named}{more}");
        }
        self.left = left;
    }
}
