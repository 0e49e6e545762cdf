//! `tx`: one transaction of the chain.

use crate::failure::Failure;
use crate::global::Global;
use crate::output::{self, Facts, Output, Table};
use crate::session::Session;
use crate::time;
use ledger_api::facts::{CallFacts, DecodedBytes, EventFacts, TransactionFacts};
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use std::io::{self, Write};

/// Show a transaction with its block, verdict and events.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Example:
  ledgerctl tx 9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08")]
pub(crate) struct Tx {
    /// Id of the transaction, 64 hexadecimal digits
    id: String,
}

impl Tx {
    pub(crate) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let id = Hash::from_hex(&self.id).ok_or_else(|| {
            Rejection::new(Code::BadArgument, "the id of the transaction cannot be read")
                .found(format!("{:?}", self.id))
                .wanted("64 hexadecimal digits")
                .next("copy the id from `ledgerctl block N`, or from the output of `ledgerctl invoke -o json`")
        })?;
        let record = Session::open(global).await?.client.transaction(id).await?;
        output.show(&TransactionFacts::from(record))
    }
}

/// `abac acquire Turtlebot4/cmd_vel`; long arguments are cut.
pub(super) fn call(call: &CallFacts) -> String {
    let mut words = vec![call.chaincode.clone(), call.function.clone()];
    words.extend(call.args.iter().map(brief));
    words.join(" ")
}

/// An event: `abac granted`, its subject, and its payload on one line.
pub(super) fn event_cells(event: &EventFacts) -> [String; 3] {
    let name = format!("{} {}", event.chaincode, event.name);
    let payload = match &event.payload {
        DecodedBytes::Json(value) => brief_json(value.get()),
        other => other.to_text().replace('\n', " "),
    };
    [name, event.subject.clone(), payload]
}

fn brief_json(json: &str) -> String {
    output::brief(json).unwrap_or_else(|| json.to_owned())
}

/// An argument in at most `BRIEF_CHARS_MAX` characters.
fn brief(arg: &DecodedBytes) -> String {
    const BRIEF_CHARS_MAX: usize = 40;
    let text = match arg {
        DecodedBytes::Json(value) => brief_json(value.get()),
        DecodedBytes::Hex(digits) => format!("hex:{digits}"),
        _ => arg.to_text(),
    };
    if text.chars().count() <= BRIEF_CHARS_MAX {
        return text;
    }
    text.chars().take(BRIEF_CHARS_MAX - 1).chain(['…']).collect()
}

impl Facts for TransactionFacts {
    fn omitted(&self) -> &'static [&'static str] {
        &["not_after", "not_after_utc"]
    }

    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let mut table = Table::pairs();
        table.pair("transaction", &self.id);
        table.pair("block", format!("{}, index {}", self.height, self.index));
        table.pair("time", time::moment(self.time));
        table.pair("creator", &self.creator);
        table.pair("call", call(&self.call));
        table.pair("verdict", format!("{} {}", self.code, self.message).trim_end());
        for event in &self.events {
            table.pair("event", event_cells(event).join("  "));
        }
        table.write(out, 0)?;
        let response = self.response.to_text();
        if response.is_empty() { Ok(()) } else { writeln!(out, "response\n{response}") }
    }
}
