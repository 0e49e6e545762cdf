//! `audit`: who did what, who was refused, and under which policies.

mod row;

use crate::argument::moment::{Instant, Moment};
use crate::argument::number;
use crate::failure::Failure;
use crate::global::Global;
use crate::output::{Format, Output};
use crate::session::Session;
use crate::time;
use bytes::Bytes;
use ledger_api::facts::AuditFacts;
use ledger_api::pages::PageBound;
use ledger_api::v1::{AuditRequest, AuditResponse};
use ledger_base::rejection::{Code, Rejection};
use row::Rows;
use std::time::Duration;

/// Rows of one question.
const ROWS_AT_ONCE: u32 = 1000;
/// Most rows that are shown without `--limit`. A node could go on without end.
const ROWS_MAX: u64 = 10_000;
/// Pause between two questions while new rows are waited for.
const FOLLOW_PAUSE: Duration = Duration::from_millis(500);
/// The decision of rows about commands.
const COMMANDS: &str = "used";

/// Show commands, rejections and changes of permissions, each with its identity and policy.
///
/// The node answers from an index that includes old blocks. Commands and rejections within one minute are one row with
/// a count. A rejection before ordering is a report of the node that rejected it; the row names that node. Grants are
/// visible to all members. Rows about commands and rejections are visible to admins, to the organisations that they
/// concern, and to the owner of the robot. With `-o json` each row is one line.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Example:
  ledgerctl audit --robot Turtlebot4 --since 10:00 --until 10:05
  ledgerctl audit --user Org1/Farhad --code LGR-3001 --since 7d --csv
  ledgerctl audit --organisation Org1 --follow -o json")]
pub(crate) struct Audit {
    #[command(flatten)]
    about: About,
    /// Start of the period: a span before now such as 10m, a time of today, a time, or a height; one day ago by default
    #[arg(long, value_name = "MOMENT", default_value = "1d")]
    since: Moment,
    /// End of the period
    #[arg(long, value_name = "MOMENT", conflicts_with = "follow")]
    until: Option<Moment>,
    /// Print at most N rows; 10000 by default, without a limit with --follow
    #[arg(long, value_name = "N", value_parser = number::count)]
    limit: Option<u64>,
    /// Continue with new rows until Ctrl-C
    #[arg(long)]
    follow: bool,
    /// The same as -o csv
    #[arg(long)]
    csv: bool,
    /// Start now, without rows about commands: the output of `ledgerctl watch`
    #[arg(skip)]
    from_now: bool,
}

/// Conditions on the rows; a row must meet all of them.
#[derive(Debug, clap::Args)]
pub(super) struct About {
    /// Only rows about this robot
    #[arg(long, value_name = "ROBOT")]
    robot: Option<String>,
    /// Only actions of this identity and actions on it; a name without an organisation is one of your own
    #[arg(long, value_name = "[ORG/]NAME")]
    user: Option<String>,
    /// Only rows about identities of this organisation
    #[arg(long, value_name = "ORG")]
    organisation: Option<String>,
    /// Only rejections with this code
    #[arg(long, value_name = "LGR-NNNN", value_parser = code)]
    code: Option<Code>,
}

/// A code as `LGR-3001` or `3001`.
fn code(text: &str) -> Result<Code, String> {
    let number = text.strip_prefix("LGR-").unwrap_or(text).parse::<u16>().ok();
    let known = number.and_then(Code::from_number).filter(|code| *code != Code::Ok);
    known.ok_or_else(|| "wanted the code of a rejection, such as LGR-3001".to_owned())
}

impl Audit {
    /// The changes from now on.
    pub(super) fn from_now(about: About) -> Self {
        let (since, until, limit, csv) = (Moment::At(0), None, None, false);
        Self { about, since, until, limit, follow: true, csv, from_now: true }
    }

    pub(crate) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let session = Session::open(global).await?;
        let mut request = self.request(&session).await?;
        let mut budget = Budget::new(self.limit, self.follow);
        let (mut told_behind, mut shown) = (false, Vec::new());
        if self.csv {
            output.set_format(Format::Csv);
        }
        let ended = loop {
            request.limit = budget.ask();
            let AuditResponse { mut rows, after, more, from_height, height, executed } =
                session.client.audit(request.clone()).await?;
            if !told_behind {
                told_behind = true;
                extent(output, (from_height, height, executed));
            }
            let next = budget.took(&mut rows, more)?;
            let rows =
                rows.into_iter().filter(|row| !(self.from_now && row.decision == COMMANDS)).map(AuditFacts::from);
            match output.format() {
                Format::Json | Format::Csv => rows.into_iter().try_for_each(|row| output.show(&row))?,
                Format::Table if self.follow => rows.into_iter().try_for_each(|row| output.show(&row))?,
                Format::Table => shown.extend(rows),
            }
            request.after = after;
            match next {
                Next::Ask => {}
                Next::Wait => tokio::select! {
                    () = tokio::time::sleep(FOLLOW_PAUSE) => {}
                    _ = tokio::signal::ctrl_c() => return Ok(()),
                },
                Next::End => break Ok(()),
                Next::Cut => break Err(cut().into()),
            }
        };
        if output.format() == Format::Table && !self.follow {
            output.show(&Rows(shown))?;
        }
        ended
    }

    async fn request(&self, session: &Session) -> Result<AuditRequest, Rejection> {
        let own = &session.context().organisation;
        let user = self.about.user.as_ref().map(|user| match user.contains('/') {
            true => user.clone(),
            false => format!("{own}/{user}"),
        });
        let until = match self.until {
            Some(until) => moment(session, until).await?,
            None => 0,
        };
        Ok(AuditRequest {
            robot: self.about.robot.clone().unwrap_or_default(),
            user: user.unwrap_or_default(),
            organisation: self.about.organisation.clone().unwrap_or_default(),
            code: self.about.code.map(|code| code.number().into()).unwrap_or_default(),
            since: if self.from_now { session.client.now() } else { since(session, self.since).await? },
            until,
            after: Bytes::new(),
            limit: 0,
        })
    }
}

/// A moment as block time, microseconds.
pub(super) async fn moment(session: &Session, moment: Moment) -> Result<u64, Rejection> {
    match moment.seen_from(time::now()) {
        Instant::Time(time) => Ok(time),
        Instant::Height(height) => Ok(session.client.block(height).await?.time),
    }
}

/// The beginning of what is asked for, as block time in microseconds.
///
/// # Errors
/// [`Code::BadArgument`] if it is in the future: an empty answer would look as if nothing had happened.
pub(super) async fn since(session: &Session, since: Moment) -> Result<u64, Rejection> {
    let (at, now) = (moment(session, since).await?, session.client.now());
    if at > now { Err(in_the_future(at, now)) } else { Ok(at) }
}

fn in_the_future(at: u64, now: u64) -> Rejection {
    Rejection::new(Code::BadArgument, "--since is in the future")
        .found(format!("{} ({})", time::moment(at), time::relative(at, now)))
        .wanted("a time before now")
        .next("check the date and the time zone, or give a span before now, such as --since 10m")
}

/// The rows that may still be shown, of a node that need not be honest.
struct Budget {
    left: u64,
    is_given: bool,
    follow: bool,
    bound: PageBound,
}

/// The step after an answer.
#[derive(Debug, PartialEq, Eq)]
enum Next {
    /// The next page.
    Ask,
    /// Later rows, after a pause.
    Wait,
    /// All that was wanted was shown.
    End,
    /// The node has more rows than are shown.
    Cut,
}

impl Budget {
    fn new(limit: Option<u64>, follow: bool) -> Self {
        let most = if follow { u64::MAX } else { ROWS_MAX };
        Self { left: limit.unwrap_or(most), is_given: limit.is_some(), follow, bound: PageBound::default() }
    }

    /// The rows to ask for.
    fn ask(&self) -> u32 {
        u32::try_from(self.left).unwrap_or(u32::MAX).min(ROWS_AT_ONCE)
    }

    /// Takes an answer, of which no more rows stay than were asked for.
    ///
    /// # Errors
    /// [`Code::TooLarge`] if the node sends pages without end.
    fn took<T>(&mut self, rows: &mut Vec<T>, more: bool) -> Result<Next, Rejection> {
        rows.truncate(usize::try_from(self.ask()).unwrap_or(usize::MAX));
        self.left = self.left.saturating_sub(rows.len() as u64);
        match (self.left, more) {
            (0, true) if !self.is_given => return Ok(Next::Cut),
            (0, _) => return Ok(Next::End),
            (_, false) => {
                self.bound = PageBound::default();
                return Ok(if self.follow { Next::Wait } else { Next::End });
            }
            (_, true) => {}
        }
        // Rows without end are what was asked for; empty pages without end are not.
        self.bound.count("the rows", if self.follow || self.is_given { rows.len().min(1) } else { rows.len() })?;
        Ok(Next::Ask)
    }
}

/// There is more than is shown.
fn cut() -> Rejection {
    Rejection::new(Code::TooLarge, "the audit has more rows than the limit")
        .found(format!("the first {ROWS_MAX} rows, and the node has more"))
        .wanted(format!("at most {ROWS_MAX} rows without --limit"))
        .next("narrow the query with --since, --until, --robot, --user or --code, or set a larger --limit")
}

/// Tells which part of the past the node does not know.
fn extent(output: &Output, (from, height, executed): (u64, u64, u64)) {
    if from > 1 {
        output.note(&format!("this node has no records from before block {from}"));
    }
    if height < executed {
        output.note(&format!("this node is still building its index: block {height} of {executed}"));
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    /// The answers of a node that always has more, until the command ends; the rows that it has shown.
    fn endless(mut budget: Budget, rows_at_once: usize) -> (u64, Result<Next, Rejection>) {
        let mut shown = 0;
        loop {
            let mut rows = vec![(); rows_at_once];
            let next = budget.took(&mut rows, true);
            shown += rows.len() as u64;
            if next != Ok(Next::Ask) {
                return (shown, next);
            }
        }
    }

    #[test]
    fn a_node_that_never_ends_is_left_and_more_rows_than_were_asked_for_are_dropped() {
        for rows_at_once in [1000, 100_000] {
            let (shown, next) = endless(Budget::new(None, false), rows_at_once);
            assert_eq!((shown, next.unwrap()), (ROWS_MAX, Next::Cut));
            let (shown, next) = endless(Budget::new(Some(2500), false), rows_at_once);
            assert_eq!((shown, next.unwrap()), (2500, Next::End));
        }
        for follow in [false, true] {
            let (shown, next) = endless(Budget::new(None, follow), 0);
            assert!(shown == 0 && next.unwrap_err().code == Code::TooLarge);
        }
        let mut following = Budget::new(None, true);
        assert_eq!(following.took(&mut vec![(); 10], false), Ok(Next::Wait));
    }
}
