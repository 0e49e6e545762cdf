//! `tx`: one transaction of the chain.

use super::code_text;
use super::event::EventFacts;
use crate::answer::Answer;
use crate::failure::Failure;
use crate::global::Global;
use crate::output::{Facts, Output, Table};
use crate::session::Session;
use crate::time;
use ledger::transaction::Transaction;
use ledger_api::v1;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use serde::Serialize;
use std::io::{self, Write};

/// Show where a transaction is and what became of it.
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
                .next("copy the id from `ledgerctl block N`, or from the answer to `ledgerctl invoke -o json`")
        })?;
        let record = Session::open(global).await?.client.transaction(id).await?;
        output.show(&TransactionFacts::from(record))
    }
}

/// A transaction: who called what, where it stands, and its verdict.
#[derive(Serialize)]
pub(super) struct TransactionFacts {
    pub(super) id: String,
    height: u64,
    pub(super) index: u32,
    time: u64,
    pub(super) creator: String,
    chaincode: String,
    function: String,
    args: Vec<Answer>,
    pub(super) code: String,
    message: String,
    pub(super) events: Vec<EventFacts>,
    #[serde(flatten)]
    response: Answer,
}

impl From<v1::TransactionRecord> for TransactionFacts {
    fn from(record: v1::TransactionRecord) -> Self {
        // A transaction that a node sends and we cannot read still has its place and its verdict.
        let body = Transaction::decode(record.transaction).map(|t| t.body().clone()).unwrap_or_default();
        let verdict = record.verdict.unwrap_or_default();
        Self {
            id: hex::encode(record.id),
            height: record.height,
            index: record.index,
            time: record.time,
            creator: record.creator,
            chaincode: body.chaincode,
            function: body.function,
            args: body.args.iter().map(|arg| Answer::read(arg)).collect(),
            code: code_text(verdict.code),
            message: verdict.message,
            events: record.events.into_iter().map(EventFacts::from).collect(),
            response: Answer::read(&record.response),
        }
    }
}

impl TransactionFacts {
    /// `abac acquire Turtlebot4/cmd_vel`; long arguments are cut.
    pub(super) fn call(&self) -> String {
        let mut words = vec![self.chaincode.clone(), self.function.clone()];
        words.extend(self.args.iter().map(brief));
        words.join(" ")
    }
}

/// An argument in at most `BRIEF_CHARS_MAX` characters.
fn brief(answer: &Answer) -> String {
    const BRIEF_CHARS_MAX: usize = 40;
    let text = match answer {
        Answer::Json(value) => value.get().to_owned(),
        Answer::Text(text) => text.clone(),
        Answer::Hex(digits) => format!("hex:{digits}"),
    };
    if text.chars().count() <= BRIEF_CHARS_MAX {
        return text;
    }
    text.chars().take(BRIEF_CHARS_MAX - 1).chain(['…']).collect()
}

impl Facts for TransactionFacts {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let mut table = Table::pairs();
        table.pair("transaction", &self.id);
        table.pair("block", format!("{}, index {}", self.height, self.index));
        table.pair("time", time::moment(self.time));
        table.pair("creator", &self.creator);
        table.pair("call", self.call());
        table.pair("verdict", format!("{} {}", self.code, self.message).trim_end());
        for event in &self.events {
            table.pair("event", format!("{}  {}  {}", event.what(), event.subject, event.details()));
        }
        table.write(out, 0)?;
        let response = self.response.to_text();
        if response.is_empty() { Ok(()) } else { writeln!(out, "response\n{response}") }
    }
}
