//! `acquire`, `renew`, `release`, `take`, `queue`, `delegate`, `handover`, `recall`, `confirm`: who may use a service, until when, and who is next.

mod confirm;
mod keep;
mod line;
mod pass;
mod together;
mod waiting;

use self::waiting::Waiting;
pub(crate) use self::{
    confirm::Confirm,
    keep::Kept,
    line::turn,
    pass::{Delegate, Handover, Recall},
};
use crate::answer;
use crate::argument::span::Milliseconds;
use crate::failure::Failure;
use crate::global::Global;
use crate::output::{Facts, Output};
use crate::session::{self, ABAC, Session};
use crate::time;
use crate::words::{Words, decimal};
use bytes::Bytes;
use ledger_api::Committed;
use ledger_contract::{AcquireOptions, Acquired, Capabilities, Fencing, Grant, Limits, Released, ServiceState};
use serde::Serialize;
use std::io::{self, Write};
use std::time::Duration;

/// Acquire the right to use a service of a robot.
///
/// While the grant lasts, an exclusive service accepts messages from its holder only. The grant is a lease: each
/// message and `renew` extend it, `release` ends it. Otherwise it expires after `--for`, or after the lease of the
/// service, which is 10 s by default. The longest lease is 10 min unless the owner sets another `lease-max`. With
/// `--keep`, the command renews the grant until Ctrl-C, which releases it.
///
/// A stop of the robot ends its grants permanently: acquire again once it is resumed.
///
/// If a service has a queue and others hold it, you join the queue: the command prints your position and exits with 5.
/// With `--wait`, it waits for the grant; Ctrl-C leaves the queue.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Example:
  ledgerctl acquire Turtlebot4
  ledgerctl acquire Turtlebot4/cmd_vel --for 30s
  ledgerctl acquire Turtlebot4/cmd_vel --keep
  ledgerctl acquire Turtlebot4/cmd_vel --wait 5m
  ledgerctl acquire Turtlebot4 Husky/cmd_vel --all-or-none")]
pub(crate) struct Acquire {
    #[command(flatten)]
    lease: Lease,
    /// Further services, with --all-or-none
    #[arg(value_name = "ROBOT[/TOPIC]", requires = "all_or_none")]
    others: Vec<String>,
    /// Acquire several services in one transaction: all of them, or none
    #[arg(long, conflicts_with = "no_wait")]
    all_or_none: bool,
    /// Renew the grant until Ctrl-C, which releases it; exits with 5 after a stop, 2 if it is lost, 4 if no node
    /// answers
    #[arg(long)]
    keep: bool,
    /// Wait in the queue for at most this long, such as 5m
    #[arg(long, value_name = "SPAN")]
    wait: Option<Milliseconds>,
    /// Do not join the queue: fail if others hold the service
    #[arg(long, conflicts_with = "wait")]
    no_wait: bool,
    /// A lower priority than your own
    #[arg(long, value_name = "N", allow_hyphen_values = true)]
    priority: Option<i64>,
}

/// Take a service in an emergency, regardless of its rule: its holders lose it.
///
/// For admins of the robot's owner, and identities to which its policies permit `override`. The reason is recorded on
/// the ledger.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl take Turtlebot4/cmd_vel --reason 'person in the cell'")]
pub(crate) struct Take {
    #[command(flatten)]
    lease: Lease,
    /// Reason; visible to all members
    #[arg(long, value_name = "TEXT")]
    reason: String,
}

/// Show the holders of a service and its queue, in order.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl queue Turtlebot4/cmd_vel")]
pub(crate) struct Queue {
    /// The service; the robot alone if it offers exactly one
    #[arg(value_name = "ROBOT[/TOPIC]")]
    service: String,
}

/// Extend a grant that you hold: from now by its lease, or by `--for`.
///
/// To extend it repeatedly: `ledgerctl acquire ROBOT/TOPIC --keep`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl renew Turtlebot4/cmd_vel --for 2m")]
pub(crate) struct Renew {
    #[command(flatten)]
    lease: Lease,
}

/// Release a service, or leave its queue; an admin of the robot's owner can revoke the grants of others.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Example:
  ledgerctl release Turtlebot4/cmd_vel
  ledgerctl release Turtlebot4/cmd_vel --holder Org1/Salma")]
pub(crate) struct Release {
    /// The service; the robot alone if it offers exactly one
    #[arg(value_name = "ROBOT[/TOPIC]")]
    service: String,
    /// Revoke only the grant of this holder, or remove it from the queue; for admins of the robot's owner
    #[arg(long, value_name = "ORG/NAME")]
    holder: Option<String>,
}

#[derive(Debug, clap::Args)]
struct Lease {
    /// The service; the robot alone if it offers exactly one
    #[arg(value_name = "ROBOT[/TOPIC]")]
    service: String,
    /// Lease: how long the grant lasts without use, such as 30s, 500ms or 2m; by default that of the service, at most
    /// its lease-max
    #[arg(long = "for", value_name = "SPAN")]
    span: Option<Milliseconds>,
}

/// How long the longest lease of a service is asked for.
const LONGEST_WITHIN: Duration = Duration::from_secs(2);

/// A grant and the transaction that gave it.
#[derive(Serialize)]
struct Granted {
    #[serde(flatten)]
    grant: Grant,
    /// Block time of the transaction, microseconds.
    time: u64,
    height: u64,
    transaction: ledger_base::hash::Hash,
    certified: bool,
    /// The longest lease of the service in milliseconds, if a node has told it.
    #[serde(skip_serializing_if = "Option::is_none")]
    lease_ms_max: Option<u64>,
    /// Does this command go on and renew it?
    #[serde(skip)]
    kept: bool,
    #[serde(skip)]
    renewed: bool,
    /// Is it somebody else's?
    #[serde(skip)]
    passed_on: bool,
}

impl Facts for Granted {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let Grant { service, holder, epoch, expires, mode, limits, givers, lease_ms, .. } = &self.grant;
        let is_alone = Capabilities::of_mode(mode).map(|known| known.fencing == Fencing::Newest);
        let what = match (self.renewed, is_alone) {
            _ if self.passed_on => format!("is now held by {holder}"),
            (true, _) => "renewed".to_owned(),
            (false, Some(true)) => "is acquired (exclusive)".to_owned(),
            (false, Some(false)) => "is acquired (shared)".to_owned(),
            (false, None) => format!("is acquired in mode {mode}"),
        };
        writeln!(out, "{service} {what}")?;
        let mut table = crate::output::Table::pairs();
        table.pair("holder", holder);
        table.pair("epoch", epoch);
        table.pair("expires", format!("{} ({})", time::moment(*expires), time::relative(*expires, self.time)));
        if let Some(longest) = self.lease_ms_max {
            let [lease, longest] = [*lease_ms, longest].map(|ms| time::span(ms.saturating_mul(1000)));
            table.pair("lease", format!("{lease} after each message or renewal, at most {longest}"));
        }
        if !givers.is_empty() {
            table.pair("passed on by", givers.join(", then "));
        }
        if !limits.is_none() {
            table.pair("limits", limits_text(limits));
        }
        table.write(out, 2)?;
        if self.kept || self.passed_on {
            return Ok(());
        }
        match self.lease_ms_max {
            Some(longest) if longest > *lease_ms => writeln!(
                out,
                "to hold it longer: ledgerctl renew {service} --for {}, or ledgerctl acquire {service} --keep",
                Milliseconds(longest)
            ),
            Some(_) => writeln!(out, "to hold it longer: ledgerctl acquire {service} --keep"),
            None => Ok(()),
        }
    }
}

/// Limits for people: `50 Hz, 0.5 m/s, within 08:00-18:00 Mon-Fri +02:00`.
pub(in crate::command) fn limits_text(limits: &Limits) -> String {
    let Limits { max_rate_mhz, max_age_ms, max_linear_mm_s, max_angular_mrad_s, between } = limits;
    let thousandths = |value: u64, unit: &str| format!("{} {unit}", decimal(value));
    let mut parts = Vec::new();
    parts.extend(max_rate_mhz.map(|rate| thousandths(rate, "Hz")));
    parts.extend(max_age_ms.map(|age| format!("not older than {age} ms")));
    parts.extend(max_linear_mm_s.map(|speed| thousandths(speed, "m/s")));
    parts.extend(max_angular_mrad_s.map(|speed| thousandths(speed, "rad/s")));
    if !between.is_empty() {
        parts.push(format!("within {}", between.join(" or ")));
    }
    parts.join(", ")
}

/// The words of the command line where the chaincode has other names.
const ACQUIRE: Words =
    Words { arguments: &[("LEASE_MS", "--for"), ("OPTIONS_JSON", "the options")], help: "ledgerctl acquire" };
const RENEW: Words = Words { help: "ledgerctl renew", ..ACQUIRE };
const TAKE: Words = Words { arguments: &[("LEASE_MS", "--for"), ("REASON", "--reason")], help: "ledgerctl take" };
const RELEASE: Words = Words { arguments: &[("HOLDER", "--holder")], help: "ledgerctl release" };

impl Granted {
    fn of(done: &Committed, grant: Grant, renewed: bool) -> Self {
        let Committed { id: transaction, height, time, certified, .. } = *done;
        Self { grant, time, height, transaction, certified, lease_ms_max: None, kept: false, renewed, passed_on: false }
    }

    /// With the longest lease of its service. The grant counts without it: nothing waits for nodes that do not answer.
    async fn with_longest(self, session: &Session) -> Self {
        let service = vec![Bytes::from(self.grant.service.clone())];
        let state = tokio::time::timeout(LONGEST_WITHIN, session.ask(ABAC, "service", service)).await;
        let state = state.ok().and_then(Result::ok);
        let state = state.and_then(|state| answer::parse::<ServiceState>(&state, "a service").ok());
        Self { lease_ms_max: state.map(|state| state.lease_ms_max), ..self }
    }

    /// This command renews it.
    fn for_keeping(self, kept: bool) -> Self {
        Self { kept, ..self }
    }

    /// The grant is somebody else's now.
    fn for_somebody(self, passed_on: bool) -> Self {
        Self { passed_on, ..self }
    }
}

impl Acquire {
    pub(crate) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let session = Session::open(global).await?;
        let Self { lease: Lease { service, span }, others, all_or_none, keep, wait, no_wait, priority } = self;
        if all_or_none {
            let services: Vec<String> = std::iter::once(service).chain(others).collect();
            let options = AcquireOptions { lease_ms: span.map(|span| span.0), priority, ..AcquireOptions::default() };
            let wait = wait.map(|wait| Duration::from_millis(wait.0));
            return together::acquire(&session, &services, &options, wait, keep, output).await;
        }
        let mut args = vec![Bytes::from(service)];
        let wait_ms = if no_wait { Some(0) } else { wait.as_ref().map(|wait| wait.0) };
        if wait_ms.is_some() || priority.is_some() {
            let lease_ms = span.map(|span| span.0);
            args.push(session::argument(&AcquireOptions { lease_ms, wait_ms, priority })?);
        } else {
            args.extend(span.map(|span| Bytes::from(span.0.to_string())));
        }
        let done = session.call(ABAC, "acquire", args).await.map_err(|refused| ACQUIRE.told(refused))?;
        let acquired = answer::parse(&done.response, "a grant or a position in the queue")?;
        match acquired {
            Acquired::Pending { pending } if wait.is_none() => confirm::asked(pending, &done, output),
            Acquired::Queued { queued } if wait.is_none() => line::joined(queued, &done, output),
            acquired => {
                let granted = granted(&session, &done, acquired, output).await?;
                let granted = granted.with_longest(&session).await.for_keeping(keep);
                output.show(&granted)?;
                if !keep {
                    return Ok(());
                }
                let height = granted.height;
                Kept::of(&session, vec![granted.grant]).until_interrupted(height, output).await
            }
        }
    }
}

/// Acquires a service, and waits for it where others are first. Ctrl-C leaves the line.
pub(crate) async fn acquire(session: &Session, service: String, output: &Output) -> Result<Grant, Failure> {
    let done = session.call(ABAC, "acquire", vec![Bytes::from(service)]).await;
    let done = done.map_err(|refused| ACQUIRE.told(refused))?;
    let acquired = answer::parse(&done.response, "a grant or a position in the queue")?;
    Ok(granted(session, &done, acquired, output).await?.grant)
}

/// The grant that `acquire` has given, or gives at the end of a wait.
async fn granted(session: &Session, done: &Committed, acquired: Acquired, output: &Output) -> Result<Granted, Failure> {
    match acquired {
        Acquired::Granted(grant) => Ok(Granted::of(done, *grant, false)),
        Acquired::Queued { queued } => Waiting::in_line(session, queued, done.height).until_granted(output).await,
        Acquired::Pending { pending } => {
            Waiting::for_confirmation(session, pending, done.height).until_granted(output).await
        }
    }
}

impl Renew {
    pub(crate) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let session = Session::open(global).await?;
        let Lease { service, span } = self.lease;
        let args = std::iter::once(service).chain(span.map(|span| span.0.to_string())).map(Bytes::from).collect();
        let done = session.call(ABAC, "renew", args).await.map_err(|refused| RENEW.told(refused))?;
        let grant = answer::parse(&done.response, "a grant")?;
        output.show(&Granted::of(&done, grant, true).with_longest(&session).await)
    }
}

impl Take {
    pub(crate) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let session = Session::open(global).await?;
        let Self { lease: Lease { service, span }, reason } = self;
        let span = span.map(|span| span.0.to_string());
        let args = [service, reason].into_iter().chain(span).map(Bytes::from).collect();
        let done = session.call(ABAC, "take", args).await.map_err(|refused| TAKE.told(refused))?;
        let grant = answer::parse(&done.response, "a grant")?;
        output.show(&Granted::of(&done, grant, false).with_longest(&session).await)
    }
}

impl Queue {
    pub(crate) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let session = Session::open(global).await?;
        let response = session.ask(ABAC, "line", vec![Bytes::from(self.service)]).await;
        let response = response.map_err(|refused| line::WORDS.told(refused))?;
        output.show(&line::Line(answer::parse(&response, "a queue")?, session.client.now()))
    }
}

/// The ended grants, and the transaction that ended them.
#[derive(Serialize)]
struct Ended {
    released: Vec<Released>,
    time: u64,
    height: u64,
    transaction: ledger_base::hash::Hash,
    certified: bool,
}

impl Facts for Ended {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        if self.released.is_empty() {
            writeln!(out, "no grant ended; if you were in the queue, you left it")?;
        }
        for Released { service, holder, epoch, .. } in &self.released {
            writeln!(out, "{service} is released; {holder} held it with epoch {epoch}")?;
        }
        Ok(())
    }
}

impl Release {
    pub(crate) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let session = Session::open(global).await?;
        let args = std::iter::once(self.service).chain(self.holder).map(Bytes::from).collect();
        let Committed { id, height, time, response, certified, .. } =
            session.call(ABAC, "release", args).await.map_err(|refused| RELEASE.told(refused))?;
        let released = answer::parse(&response, "ended grants")?;
        output.show(&Ended { released, time, height, transaction: id, certified })
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use ledger_contract::Mode;

    fn granted(renewed: bool, mode: Mode) -> Granted {
        let grant = Grant {
            service: "Turtlebot4/cmd_vel".into(),
            holder: "Org1/Salma".into(),
            epoch: 3,
            expires: 1_700_000_010_000_000,
            mode,
            acquired_at: 1_700_000_000_000_000,
            lease_ms: 10_000,
            next_seq: 0,
            taken: None,
            limits: Limits::default(),
            givers: Vec::new(),
            may_delegate: false,
            follows: None,
            task: None,
            policy_version: 0,
            policies: Vec::new(),
        };
        let transaction = ledger_base::hash::Hash::ZERO;
        let (time, height, certified) = (1_700_000_000_000_000, 9, true);
        let lease_ms_max = Some(600_000);
        Granted { grant, time, height, transaction, certified, lease_ms_max, kept: false, renewed, passed_on: false }
    }

    fn text(facts: &impl Facts) -> String {
        let mut out = Vec::new();
        facts.text(&mut out).unwrap();
        String::from_utf8(out).unwrap()
    }

    #[test]
    fn a_grant_says_whose_which_epoch_and_how_long() {
        let shown = text(&granted(false, Mode::EXCLUSIVE));
        for part in ["Turtlebot4/cmd_vel is acquired (exclusive)", "holder   Org1/Salma", "epoch    3", "(in 10 s)"] {
            assert!(shown.contains(part), "{part:?} in {shown}");
        }
        for part in
            ["10 s after each message or renewal, at most 10 min", "ledgerctl renew Turtlebot4/cmd_vel --for 10m"]
        {
            assert!(shown.contains(part), "{part:?} in {shown}");
        }
        assert!(
            !text(&granted(false, Mode::EXCLUSIVE).for_keeping(true)).contains("ledgerctl"),
            "it is renewed already"
        );
        assert!(text(&granted(true, Mode::EXCLUSIVE)).contains("renewed"));
        assert!(text(&granted(false, Mode::OPEN)).contains("is acquired (shared)"));
        let newer = text(&granted(false, Mode::LIMITED));
        assert!(newer.contains("Turtlebot4/cmd_vel is acquired in mode limited"), "{newer}");
    }

    #[test]
    fn limits_are_told_in_the_units_of_their_annotations() {
        let limits = Limits {
            max_rate_mhz: Some(12_500),
            max_age_ms: Some(200),
            max_linear_mm_s: Some(500),
            max_angular_mrad_s: Some(1000),
            between: vec!["08:00-18:00 Z".into()],
        };
        let wanted = "12.5 Hz, not older than 200 ms, 0.5 m/s, 1 rad/s, within 08:00-18:00 Z";
        assert_eq!(limits_text(&limits), wanted);
    }

    #[test]
    fn a_grant_in_json_is_flat() {
        let value = serde_json::to_value(granted(false, Mode::EXCLUSIVE)).unwrap();
        for key in ["service", "holder", "epoch", "expires", "mode", "time", "height", "transaction"] {
            assert!(value.get(key).is_some(), "{key}");
        }
        assert!(value.get("renewed").is_none());
    }
}
