//! Recorded decisions, asked once more under other policies: `policy shadow`, and `policy diff --decisions`.

use crate::argument::moment::Moment;
use crate::argument::{number, policies};
use crate::cli::Global;
use crate::command::audit::moment;
use crate::command::can::asked;
use crate::failure::Failure;
use crate::output::{Facts, Output, Table};
use crate::session::{ABAC, Session};
use crate::time;
use ledger_api::v1::{AuditRequest, AuditRow};
use ledger_contract::{Ask, PolicyText, RobotAsset};
use ledger_rejection::{Code, Rejection};
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::io::{self, Write};
use std::path::PathBuf;

/// Rows of one question.
const ROWS_AT_ONCE: u32 = 1000;
/// Most different decisions that are asked about again.
const DECISIONS_MAX: u64 = 1000;

/// Tell which recorded decisions policies in files would have changed, before they rule.
///
/// Takes the grants and the refusals by policies from the audit, about robots of your organisation. Each is asked again under
/// the files as the whole set of your organisation, at its own time, with the attributes that people have now. Nothing is
/// changed. Grants count as allowed, refusals with LGR-3001 and LGR-3002 as denied.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl policy shadow night.cedar guests.cedar --since 7d")]
pub(crate) struct Shadow {
    /// Files with policies in Cedar
    #[arg(value_name = "FILE", required = true)]
    files: Vec<PathBuf>,
    /// Decisions from this moment on: a span ago such as 10m, a time of today, a time, or a height
    #[arg(long, value_name = "MOMENT", default_value = "1d")]
    since: Moment,
    /// The last so many different decisions
    #[arg(long, value_name = "N", default_value_t = 100, value_parser = number::count)]
    most: u64,
}

/// The decisions that would be others.
#[derive(Serialize)]
pub(super) struct Compared {
    /// Different decisions: the same one for the same person and service counts once.
    decisions: usize,
    /// How many times they were made.
    times: u64,
    differ: Vec<Differs>,
    /// Decisions that cannot be asked about again: the person or the service is not known any more, or never was by its name.
    unknown: usize,
}

/// A decision that would be another one.
#[derive(Serialize)]
struct Differs {
    who: String,
    service: String,
    /// As it was decided.
    was: &'static str,
    /// Under the other policies: `LGR-0000` if allowed.
    code: String,
    reason: String,
    policies: Vec<String>,
    /// How many times it was decided so, and when last, microseconds since the UNIX epoch.
    times: u64,
    last: u64,
    height: u64,
}

/// A decision of the past.
struct Decided {
    who: String,
    service: String,
    allowed: bool,
    times: u64,
    last: u64,
    height: u64,
}

impl Shadow {
    pub(super) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let policies = policies::read(&self.files)?.unwrap_or_default();
        let session = Session::open(global).await?;
        let since = moment(&session, self.since).await?;
        output.show(&compare(&session, policies, since, self.most).await?)
    }
}

/// Asks about the last decisions since a time again.
pub(super) async fn compare(
    session: &Session,
    policies: Vec<PolicyText>,
    since: u64,
    most: u64,
) -> Result<Compared, Rejection> {
    let decided = decided(session, since, most.min(DECISIONS_MAX)).await?;
    let mut compared = Compared { decisions: decided.len(), times: 0, differ: Vec::new(), unknown: 0 };
    for Decided { who, service, allowed, times, last, height } in decided {
        compared.times += times;
        let ask = Ask {
            who: Some(who.clone()),
            action: "acquire".to_owned(),
            service: service.clone(),
            at: Some(last),
            policies: Some(policies.clone()),
        };
        let answer = match asked(session, &ask).await {
            Ok(answer) => answer,
            Err(refused) if is_unknown(&refused) => {
                compared.unknown += 1;
                continue;
            }
            Err(refused) => return Err(refused),
        };
        if answer.allowed != allowed {
            let was = if allowed { "allowed" } else { "denied" };
            let (code, reason, policies) = (answer.code.clone(), answer.reason.clone(), answer.policies.clone());
            compared.differ.push(Differs { who, service, was, code, reason, policies, times, last, height });
        }
    }
    Ok(compared)
}

/// The robot or the person is gone, or nobody has registered the person.
fn is_unknown(refused: &Rejection) -> bool {
    matches!(refused.code, Code::NotFound | Code::UnknownRobot | Code::UnknownService)
}

/// The last different decisions about robots of the own organisation, the newest last.
async fn decided(session: &Session, since: u64, most: u64) -> Result<VecDeque<Decided>, Rejection> {
    let own = &session.context().organisation;
    let robots: Vec<RobotAsset> = session.list(ABAC, "robots").await?;
    let mine: BTreeSet<&str> =
        robots.iter().filter(|robot| robot.organisation == *own).map(|robot| robot.name.as_str()).collect();
    let mut found: BTreeMap<(String, String, bool), Decided> = BTreeMap::new();
    let mut request = AuditRequest { since, limit: ROWS_AT_ONCE, ..AuditRequest::default() };
    loop {
        let answer = session.client.audit(request.clone()).await?;
        for row in answer.rows.iter().filter(|row| mine.contains(row.robot.as_str()) && row.who.contains('/')) {
            let Some(allowed) = verdict(row) else { continue };
            let key = (row.who.clone(), row.subject.clone(), allowed);
            let known = found.entry(key).or_insert_with(|| Decided {
                who: row.who.clone(),
                service: row.subject.clone(),
                allowed,
                times: 0,
                last: row.last,
                height: row.height,
            });
            (known.times, known.last, known.height) = (known.times + row.count, row.last, row.height);
        }
        if !answer.more {
            break;
        }
        request.after = answer.after;
    }
    let mut decided: Vec<Decided> = found.into_values().collect();
    decided.sort_by_key(|decided| (decided.last, decided.height));
    let beyond = decided.len().saturating_sub(usize::try_from(most).unwrap_or(usize::MAX));
    Ok(decided.split_off(beyond).into())
}

/// Was it allowed? None if policies did not decide.
fn verdict(row: &AuditRow) -> Option<bool> {
    let denied = [Code::MissingAttribute, Code::DeniedByPolicy].map(|code| u32::from(code.number()));
    match row.decision.as_str() {
        "granted" => Some(true),
        "refused" if denied.contains(&row.code) => Some(false),
        _ => None,
    }
}

impl Facts for Compared {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let Self { decisions, times, differ, unknown } = self;
        writeln!(
            out,
            "recorded decisions that this set would change: {} of {decisions}, made {times} times",
            differ.len()
        )?;
        if *unknown > 0 {
            writeln!(out, "not asked again, as the ledger knows the person or the service no more: {unknown}")?;
        }
        if differ.is_empty() {
            return Ok(());
        }
        let mut table = Table::new(["WHO", "SERVICE", "WAS", "WOULD BE", "TIMES", "LAST", "WHY"]);
        for one in differ {
            let would = if one.was == "allowed" { format!("denied {}", one.code) } else { "allowed".to_owned() };
            let why = if one.reason.is_empty() { one.policies.join(", ") } else { one.reason.clone() };
            let (times, last) = (one.times.to_string(), time::moment(one.last));
            table.row([one.who.clone(), one.service.clone(), one.was.to_owned(), would, times, last, why]);
        }
        table.write(out, 2)
    }
}
