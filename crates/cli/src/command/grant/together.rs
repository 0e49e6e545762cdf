//! `acquire … --all-or-none`: several services in one transaction.

use super::{Granted, Kept};
use crate::answer;
use crate::failure::Failure;
use crate::output::{Facts, Output};
use crate::session::{self, ABAC, Session};
use crate::words::Words;
use bytes::Bytes;
use ledger_api::{Committed, Subscription};
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{AcquireOptions, Grant, LineState};
use serde::Serialize;
use std::io::{self, Write};
use std::time::Duration;
use tokio::time::Instant;

/// How often the node says that it is alive while nothing changes, in milliseconds.
const HEARTBEAT_MS: u32 = 2_000;

const WORDS: Words = Words {
    arguments: &[("LEASE_MS", "--for"), ("OPTIONS_JSON", "the options"), ("SERVICE", "ROBOT[/TOPIC]")],
    help: "ledgerctl acquire",
};

/// The grants, all by one transaction.
#[derive(Serialize)]
#[serde(transparent)]
struct Together(Vec<Granted>);

impl Facts for Together {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        self.0.iter().try_for_each(|granted| granted.text(out))
    }
}

/// Acquires all of them, or none; tries again for `wait` whenever one of them was released. Then renews them if told to `keep`.
pub(super) async fn acquire(
    session: &Session,
    services: &[String],
    options: &AcquireOptions,
    wait: Option<Duration>,
    keep: bool,
    output: &mut Output,
) -> Result<(), Failure> {
    let mut args = vec![session::argument(options)?];
    args.extend(services.iter().map(|service| Bytes::from(service.clone())));
    let until = Instant::now() + wait.unwrap_or_default();
    loop {
        // Known before the try: what is released after it is not missed.
        let height = session.client.status().await?.height;
        match session.call(ABAC, "acquire_all", args.clone()).await {
            Ok(done) => {
                let mut grants = Vec::new();
                for grant in granted(&done)? {
                    grants.push(grant.with_longest(session).await.for_keeping(keep));
                }
                let grants = Together(grants);
                output.show(&grants)?;
                if !keep {
                    return Ok(());
                }
                let kept = grants.0.into_iter().map(|granted| granted.grant).collect();
                return Kept::of(session, kept).until_interrupted(done.height, output).await;
            }
            Err(refused) if refused.code == Code::Held && Instant::now() < until => {
                if tokio::time::timeout_at(until, released(session, services, height)).await.is_err() {
                    return Err(WORDS.told(refused).into());
                }
            }
            Err(refused) => return Err(WORDS.told(refused).into()),
        }
    }
}

fn granted(done: &Committed) -> Result<Vec<Granted>, Rejection> {
    let grants: Vec<Grant> = answer::parse(&done.response, "grants")?;
    Ok(grants.into_iter().map(|grant| Granted::of(done, grant, false)).collect())
}

/// Waits until something about one of the services ends after that height.
async fn released(session: &Session, services: &[String], height: u64) -> Result<(), Rejection> {
    let mut subjects = Vec::new();
    for service in services {
        let line = session.ask(ABAC, "line", vec![Bytes::from(service.clone())]).await?;
        subjects.push(answer::parse::<LineState>(&line, "a queue")?.service);
    }
    let mut stream = session.client.subscribe(Subscription {
        from_height: height + 1,
        chaincode: ABAC.to_owned(),
        subjects,
        names: ["released", "left"].map(str::to_owned).to_vec(),
        heartbeat: HEARTBEAT_MS,
        ..Subscription::default()
    });
    while stream.next().await?.events.is_empty() {}
    Ok(())
}
