//! Recorded decisions, asked once more under other policies: `policy shadow`, and `policy diff --decisions`.

use super::propose;
use crate::argument::moment::Moment;
use crate::argument::{number, policies};
use crate::command::audit;
use crate::command::can::asked;
use crate::failure::Failure;
use crate::global::Global;
use crate::output::{Facts, Output, Table};
use crate::session::{ABAC, Session};
use crate::time;
use ledger_api::pages::PageBound;
use ledger_api::v1::{AuditRequest, AuditRow};
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{Ask, PolicyProposalTexts, PolicyText, RobotAsset};
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::io::{self, Write};
use std::path::PathBuf;
use std::time::Duration;

/// Rows of one question.
const ROWS_AT_ONCE: u32 = 1000;
/// Most different decisions that are asked about again.
const DECISIONS_MAX: u64 = 1000;
/// Decisions of this time are compared with files, microseconds.
const DAY: u64 = 86_400_000_000;
/// Time between two looks of who follows.
const BETWEEN_LOOKS: Duration = Duration::from_secs(2);
/// The action of a grant that was taken.
const OVERRIDE: &str = "override";

/// Show which recorded decisions a policy set would have changed, before it is in force.
///
/// The set is a proposed one (`ledgerctl policy propose --shadow`), evaluated from the block of its proposal on, as
/// long as the proposal is pending. Without a proposal and without files, it is each proposed set of your organisation.
/// Files are a set without a proposal, evaluated for the last day, or since `--since`.
///
/// Reads grants, commands in open mode and policy rejections from the audit, for robots of your organisation. Each
/// decision is evaluated again at its own time, with this set as the complete set of your organisation and with the
/// current attributes of identities. Nothing is changed. Rejections with LGR-3001 and LGR-3002 count as denied, all
/// others as allowed. Overrides are omitted.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Example:
  ledgerctl policy shadow
  ledgerctl policy shadow --proposal 3f9a0c77 --follow
  ledgerctl policy shadow night.cedar guests.cedar --since 7d")]
pub(crate) struct Shadow {
    /// Files with policies in Cedar; by default the proposed sets
    #[arg(value_name = "FILE", conflicts_with = "proposal")]
    files: Vec<PathBuf>,
    /// Only the proposed set with this id, or at least its first 8 digits
    #[arg(long, value_name = "ID")]
    proposal: Option<String>,
    /// Start of the period: a span before now such as 10m, a time of today, a time, or a height
    #[arg(long, value_name = "MOMENT")]
    since: Option<Moment>,
    /// Evaluate the last N different decisions
    #[arg(long, value_name = "N", default_value_t = DECISIONS_MAX, value_parser = number::count)]
    most: u64,
    /// Continue, and print the result again whenever a count changes
    #[arg(long)]
    follow: bool,
}

/// A set that is compared with the one in force.
struct Candidate {
    /// Of the proposal; none of files.
    id: Option<String>,
    policies: Vec<PolicyText>,
    /// Decisions since this time, microseconds since the UNIX epoch.
    since: u64,
}

/// The set in force beside a candidate.
#[derive(PartialEq, Eq, Serialize)]
struct Beside {
    /// The proposal; none of files.
    #[serde(skip_serializing_if = "Option::is_none")]
    proposal: Option<String>,
    /// From when on decisions are compared, microseconds since the UNIX epoch.
    since: u64,
    #[serde(flatten)]
    compared: Compared,
}

/// One or more of them.
#[derive(PartialEq, Eq, Serialize)]
struct All(Vec<Beside>);

/// The decisions that would be others.
#[derive(PartialEq, Eq, Serialize)]
pub(super) struct Compared {
    /// Different decisions: the same one for the same person and service counts once.
    decisions: usize,
    /// How many times they were made.
    times: u64,
    differ: Vec<Differs>,
    /// Decisions that cannot be asked about again: the person, the service or the action is not known.
    unknown: usize,
}

/// A decision that would be another one.
#[derive(PartialEq, Eq, Serialize)]
struct Differs {
    who: String,
    action: String,
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
    /// Empty if it is not known.
    action: String,
    allowed: bool,
    times: u64,
    last: u64,
    height: u64,
}

impl Shadow {
    pub(super) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let session = Session::open(global).await?;
        let mut told = None;
        loop {
            let all = self.compare(&session).await?;
            if told.as_ref() != Some(&all) {
                output.show(&all)?;
            }
            if !self.follow {
                return Ok(());
            }
            told = Some(all);
            tokio::time::sleep(BETWEEN_LOOKS).await;
        }
    }

    async fn compare(&self, session: &Session) -> Result<All, Failure> {
        let mut all = Vec::new();
        for Candidate { id, policies, since } in self.candidates(session).await? {
            let compared = compare(session, policies, since, self.most).await?;
            all.push(Beside { proposal: id, since, compared });
        }
        Ok(All(all))
    }

    /// The sets to compare, and since when.
    async fn candidates(&self, session: &Session) -> Result<Vec<Candidate>, Failure> {
        let since = match self.since {
            Some(since) => Some(audit::since(session, since).await?),
            None => None,
        };
        if let Some(policies) = policies::read(&self.files)? {
            let since = since.unwrap_or_else(|| time::now().saturating_sub(DAY));
            return Ok(vec![Candidate { id: None, policies, since }]);
        }
        let ids = match &self.proposal {
            Some(id) => vec![propose::resolve(session, id).await?],
            None => propose::of_own_organisation(session).await?,
        };
        let mut candidates = Vec::new();
        for id in ids {
            let PolicyProposalTexts { proposal, policies } = propose::whole(session, id).await?;
            let since = since.unwrap_or(proposal.created);
            candidates.push(Candidate { id: Some(proposal.id), policies, since });
        }
        Ok(candidates)
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
    for Decided { who, service, action, allowed, times, last, height } in decided {
        compared.times += times;
        if action.is_empty() {
            compared.unknown += 1;
            continue;
        }
        let ask = Ask {
            who: Some(who.clone()),
            action: action.clone(),
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
            compared.differ.push(Differs { who, action, service, was, code, reason, policies, times, last, height });
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
    let mut found: BTreeMap<(String, String, String, bool), Decided> = BTreeMap::new();
    let mut request = AuditRequest { since, limit: ROWS_AT_ONCE, ..AuditRequest::default() };
    let mut bound = PageBound::default();
    loop {
        let answer = session.client.audit(request.clone()).await?;
        bound.count("the rows of the audit", answer.rows.len())?;
        for row in answer.rows.iter().filter(|row| mine.contains(row.robot.as_str()) && row.who.contains('/')) {
            let Some((action, allowed)) = verdict(row) else { continue };
            let key = (row.who.clone(), row.subject.clone(), action.to_owned(), allowed);
            let known = found.entry(key).or_insert_with(|| Decided {
                who: row.who.clone(),
                service: row.subject.clone(),
                action: action.to_owned(),
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

/// The action that policies decided about, and whether they allowed it. None if they did not decide. Commands under a grant are
/// decided with it. A service may be taken without a policy.
fn verdict(row: &AuditRow) -> Option<(&str, bool)> {
    let denied = [Code::MissingAttribute, Code::DeniedByPolicy].map(|code| u32::from(code.number()));
    match row.decision.as_str() {
        "granted" if row.action != OVERRIDE => Some((&row.action, true)),
        "used" if row.epoch == 0 => Some((&row.action, true)),
        "refused" if denied.contains(&row.code) => Some((&row.action, false)),
        _ => None,
    }
}

impl Facts for All {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        if self.0.is_empty() {
            return writeln!(out, "no policy set is proposed: ledgerctl policy propose FILE… --shadow");
        }
        for Beside { proposal, since, compared } in &self.0 {
            if let Some(id) = proposal {
                writeln!(
                    out,
                    "proposed set {} in parallel with the one in force, since {}",
                    propose::short(id),
                    time::moment(*since)
                )?;
            }
            compared.text(out)?;
        }
        Ok(())
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
            writeln!(out, "not evaluated, because the identity, the service or the action is unknown: {unknown}")?;
        }
        if differ.is_empty() {
            return Ok(());
        }
        let mut table = Table::new(["WHO", "ACTION", "SERVICE", "WAS", "WOULD BE", "TIMES", "LAST", "WHY"]);
        for one in differ {
            let would = if one.was == "allowed" { format!("denied {}", one.code) } else { "allowed".to_owned() };
            let why = if one.reason.is_empty() { one.policies.join(", ") } else { one.reason.clone() };
            let (times, last) = (one.times.to_string(), time::moment(one.last));
            let [who, action, service] = [&one.who, &one.action, &one.service].map(String::clone);
            table.row([who, action, service, one.was.to_owned(), would, times, last, why]);
        }
        table.write(out, 2)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_decision_is_asked_again_as_the_action_that_it_was_and_a_takeover_is_not() {
        let row = |decision: &str, action: &str, code: u32, epoch: u64| AuditRow {
            decision: decision.into(),
            action: action.into(),
            code,
            epoch,
            ..AuditRow::default()
        };
        for (row, wanted) in [
            (row("granted", "acquire", 0, 3), Some(("acquire", true))),
            (row("granted", "override", 0, 3), None),
            (row("used", "publish", 0, 0), Some(("publish", true))),
            (row("used", "", 0, 3), None),
            (row("refused", "stop", 3002, 0), Some(("stop", false))),
            (row("refused", "subscribe", 3001, 0), Some(("subscribe", false))),
            (row("refused", "", 3002, 0), Some(("", false))),
            (row("refused", "acquire", 3005, 0), None),
            (row("stopped", "", 0, 0), None),
        ] {
            assert_eq!(verdict(&row), wanted, "{row:?}");
        }
    }
}
