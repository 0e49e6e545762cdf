//! `history`: the commands of a service in the past, with their values.

use super::echo::{HEARTBEAT_MS, Message, Shown, messages};
use super::secret::{KEYED, Opening};
use super::senders::Senders;
use crate::answer;
use crate::argument::message::Definitions;
use crate::argument::moment::Moment;
use crate::argument::number;
use crate::command::audit::{moment, since};
use crate::failure::Failure;
use crate::global::Global;
use crate::output::{Facts, Output};
use crate::session::{ABAC, Session};
use crate::time;
use crate::words::Words;
use bytes::Bytes;
use ledger_api::Subscription;
use ledger_api::pages::PageBound;
use ledger_api::v1::AuditRequest;
use ledger_base::rejection::Rejection;
use ledger_contract::ServiceState;
use serde::Serialize;
use std::io::{self, Write};

/// Rows of one question.
const ROWS_AT_ONCE: u32 = 1000;
/// Blocks without a command that are read over rather than asked about.
const GAP: u64 = 500;
/// The words of the command line where the chaincode has other names.
const WORDS: Words = Words { arguments: &[], help: "ledgerctl history" };

/// List past commands of a service with their values.
///
/// The node finds the blocks in its index (`ledgerctl audit`) and sends the signed transactions. The sender's signature
/// is verified. Each line has time, block, sender, epoch, sequence number, and the message.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Example:
  ledgerctl history Turtlebot4/cmd_vel --since 10:00 --until 10:05
  ledgerctl history Turtlebot4/cmd_vel --since 10m -o json")]
pub(crate) struct History {
    /// The service; the robot alone if it offers exactly one
    #[arg(value_name = "ROBOT/TOPIC")]
    service: String,
    /// Start of the period: a span before now such as 10m, a time of today, a time, or a height; one hour ago by
    /// default
    #[arg(long, value_name = "MOMENT", default_value = "1h")]
    since: Moment,
    /// End of the period
    #[arg(long, value_name = "MOMENT")]
    until: Option<Moment>,
    /// End after N messages
    #[arg(long, value_name = "N", value_parser = number::count)]
    count: Option<u64>,
    /// Print the bytes in hexadecimal
    #[arg(long)]
    hex: bool,
    #[command(flatten)]
    definitions: Definitions,
}

/// One command on one line.
#[derive(Serialize)]
#[serde(transparent)]
struct Line(Message);

impl Facts for Line {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let Message { height, sender, epoch, seq, payload, message, .. } = &self.0;
        let values = match message {
            Some(message) => serde_json::to_string(message).map_err(io::Error::from)?,
            None => payload.clone(),
        };
        let moment = time::rfc3339(self.0.time);
        writeln!(out, "{moment}  block {height}  {sender}  epoch {epoch}  seq {seq}  {values}")
    }
}

/// Blocks with commands, and the times between which they count.
struct Stretch {
    from: u64,
    to: u64,
}

impl History {
    pub(crate) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        self.definitions.check(output)?;
        let session = Session::open(global).await?;
        let response = session.ask(ABAC, "service", vec![Bytes::from(self.service.clone())]).await;
        let service: ServiceState = answer::parse(&response.map_err(|refused| WORDS.told(refused))?, "a service")?;
        let since = since(&session, self.since).await?;
        let until = match self.until {
            Some(until) => moment(&session, until).await?,
            None => u64::MAX,
        };
        let shown = Shown::of(&self.definitions, self.hex, &service.type_name, output);
        let mut left = self.count.unwrap_or(u64::MAX);
        let stretches = stretches(&session, &service.service, (since, until)).await?;
        if stretches.is_empty() {
            output.note(&format!("no messages on {} in this period that this node may show you", service.service));
        }
        let mut opening = Opening::enter(&session, std::iter::once(&service)).await?;
        for Stretch { from, to } in stretches {
            let mut senders = Senders::new(&session);
            let mut stream = session.client.subscribe(Subscription {
                from_height: from,
                chaincode: ABAC.to_owned(),
                subjects: vec![service.service.clone()],
                names: vec!["message".to_owned(), KEYED.to_owned()],
                heartbeat: HEARTBEAT_MS,
                ..Subscription::default()
            });
            stream.open().await?;
            loop {
                let delivery = stream.next().await?;
                let counts = (since..=until).contains(&delivery.time) && delivery.height <= to;
                for event in &delivery.events {
                    if event.name == KEYED {
                        opening.keyed(delivery.height, event, &mut senders)?;
                        continue;
                    }
                    let told = messages(&delivery, event, (&mut senders, &mut opening), &shown).await?;
                    for message in told.into_iter().filter(|_| counts) {
                        output.show(&Line(message))?;
                        left -= 1;
                        if left == 0 {
                            return Ok(());
                        }
                    }
                }
                if delivery.height >= to {
                    break;
                }
            }
        }
        Ok(())
    }
}

/// Where the commands are, by the index.
async fn stretches(session: &Session, service: &str, (since, until): (u64, u64)) -> Result<Vec<Stretch>, Rejection> {
    let robot = service.split('/').next().unwrap_or_default().to_owned();
    let until = if until == u64::MAX { 0 } else { until };
    let mut request = AuditRequest { robot, since, until, limit: ROWS_AT_ONCE, ..AuditRequest::default() };
    let mut found: Vec<Stretch> = Vec::new();
    let mut bound = PageBound::default();
    loop {
        let answer = session.client.audit(request.clone()).await?;
        bound.count("the rows of the audit", answer.rows.len())?;
        for row in answer.rows.iter().filter(|row| row.decision == "used" && row.subject == service) {
            match found.last_mut().filter(|last| row.height <= last.to.saturating_add(GAP)) {
                Some(last) => last.to = last.to.max(row.last_height),
                None => found.push(Stretch { from: row.height, to: row.last_height }),
            }
        }
        if !answer.more {
            return Ok(found);
        }
        request.after = answer.after;
    }
}
