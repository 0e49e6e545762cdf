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
use ledger_api::v1::{AuditRequest, AuditResponse};
use ledger_base::rejection::{Code, Rejection};
use row::Rows;
use std::time::Duration;

/// Rows of one question.
const ROWS_AT_ONCE: u32 = 1000;
/// Pause between two questions while new rows are waited for.
const FOLLOW_PAUSE: Duration = Duration::from_millis(500);
/// The decision of rows about commands.
const COMMANDS: &str = "used";

/// Show who did what, who was refused, and under which policies.
///
/// The node answers from an index, also for blocks of long ago. Commands and refusals of one minute are one row, with how many they
/// were. A refusal before ordering is the word of the node that made it, which the row names. Everybody sees who holds what. Rows
/// about commands and refusals are shown to admins, to those whose organisation they concern, and to the owner of the robot.
/// With `-o json` each row is one line.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Example:
  ledgerctl audit --robot Turtlebot4 --since 10:00 --until 10:05
  ledgerctl audit --user Org1/Farhad --code LGR-3001 --since 7d --csv
  ledgerctl audit --organisation Org1 --follow -o json")]
pub(crate) struct Audit {
    #[command(flatten)]
    about: About,
    /// From this moment on: a span ago such as 10m, a time of today, a time, or a height; one day ago by default
    #[arg(long, value_name = "MOMENT", default_value = "1d")]
    since: Moment,
    /// Up to this moment
    #[arg(long, value_name = "MOMENT", conflicts_with = "follow")]
    until: Option<Moment>,
    /// At most so many rows
    #[arg(long, value_name = "N", value_parser = number::count)]
    limit: Option<u64>,
    /// Go on with what happens, until Ctrl-C
    #[arg(long)]
    follow: bool,
    /// The same as -o csv
    #[arg(long)]
    csv: bool,
    /// From now on, and without commands: what `ledgerctl watch` shows
    #[arg(skip)]
    from_now: bool,
}

/// The rows that are wanted: all that are named must fit.
#[derive(Debug, clap::Args)]
pub(super) struct About {
    /// Only about this robot
    #[arg(long, value_name = "ROBOT")]
    robot: Option<String>,
    /// Only what this identity did, or what was done to it; without an organisation one of your own
    #[arg(long, value_name = "[ORG/]NAME")]
    user: Option<String>,
    /// Only what concerns identities of this organisation
    #[arg(long, value_name = "ORG")]
    organisation: Option<String>,
    /// Only refusals with this code
    #[arg(long, value_name = "LGR-NNNN", value_parser = code)]
    code: Option<Code>,
}

/// A code as `LGR-3001` or `3001`.
fn code(text: &str) -> Result<Code, String> {
    let number = text.strip_prefix("LGR-").unwrap_or(text).parse::<u16>().ok();
    let known = number.and_then(Code::from_number).filter(|code| *code != Code::Ok);
    known.ok_or_else(|| "wanted the code of a refusal, such as LGR-3001".to_owned())
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
        let mut left = self.limit.unwrap_or(u64::MAX);
        let (mut told_behind, mut shown) = (false, Vec::new());
        if self.csv {
            output.set_format(Format::Csv);
        }
        loop {
            request.limit = u32::try_from(left).unwrap_or(u32::MAX).min(ROWS_AT_ONCE);
            let AuditResponse { rows, after, more, from_height, height, executed } =
                session.client.audit(request.clone()).await?;
            if !told_behind {
                told_behind = true;
                extent(output, (from_height, height, executed));
            }
            left -= rows.len() as u64;
            let rows =
                rows.into_iter().filter(|row| !(self.from_now && row.decision == COMMANDS)).map(AuditFacts::from);
            match output.format() {
                Format::Json | Format::Csv => rows.into_iter().try_for_each(|row| output.show(&row))?,
                Format::Table if self.follow => rows.into_iter().try_for_each(|row| output.show(&row))?,
                Format::Table => shown.extend(rows),
            }
            if left == 0 || !(more || self.follow) {
                break;
            }
            request.after = after;
            if !more {
                tokio::select! {
                    () = tokio::time::sleep(FOLLOW_PAUSE) => {}
                    _ = tokio::signal::ctrl_c() => return Ok(()),
                }
            }
        }
        if output.format() == Format::Table && !self.follow {
            output.show(&Rows(shown))?;
        }
        Ok(())
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
            since: if self.from_now { session.client.now() } else { moment(session, self.since).await? },
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

/// Tells which part of the past the node does not know.
fn extent(output: &Output, (from, height, executed): (u64, u64, u64)) {
    if from > 1 {
        output.note(&format!("this node knows nothing of what happened before block {from}"));
    }
    if height < executed {
        output.note(&format!("this node is still making its index: it is at block {height} of {executed}"));
    }
}
