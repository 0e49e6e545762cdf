//! `invoke`, `query`: any function of any chaincode.

use crate::argument::bytes;
use crate::failure::Failure;
use crate::global::Global;
use crate::output::{Facts, Output};
use crate::session::Session;
use crate::time::moment;
use ::bytes::Bytes;
use ledger_api::facts::DecodedBytes;
use ledger_base::hash::Hash;
use ledger_base::rejection::Rejection;
use serde::Serialize;
use std::io::{self, Write};

/// Call a function of a chaincode in a transaction, and wait for its verdict.
///
/// Standard output is the response of the function: JSON with one field per line, text as it is, other bytes in
/// hexadecimal. With `-o json` it is one object that also contains id, height and time.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Example:
  ledgerctl invoke abac acquire Turtlebot4/cmd_vel 30000
  ledgerctl invoke abac set Turtlebot4/cmd_vel 1 7 hex:00010000
  ledgerctl invoke abac setup @robot.json")]
pub(crate) struct Invoke {
    #[command(flatten)]
    call: Call,
}

/// Call a function of a chaincode on the committed state, and discard its writes.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Example:
  ledgerctl query abac robots
  ledgerctl query abac authorize Turtlebot4/cmd_vel")]
pub(crate) struct Query {
    /// Answer from the node's own state, which may be stale; needs no leader
    #[arg(long)]
    stale: bool,
    #[command(flatten)]
    call: Call,
}

/// A call as it is written on a command line.
#[derive(Debug, clap::Args)]
pub(crate) struct Call {
    /// Name of the chaincode; `ledgerctl status` lists the installed ones
    chaincode: String,
    /// Name of the function
    function: String,
    /// Text; hex:BYTES, @FILE or - for standard input; text:… for text that starts like one of these
    #[arg(value_name = "ARG", allow_negative_numbers = true)]
    args: Vec<String>,
}

impl Call {
    /// Chaincode, function and arguments.
    pub(crate) fn read(self) -> Result<(String, String, Vec<Bytes>), Rejection> {
        let args = self.args.iter().map(|text| bytes::argument(text)).collect::<Result<_, _>>()?;
        Ok((self.chaincode, self.function, args))
    }
}

#[derive(Serialize)]
struct Invoked {
    id: Hash,
    height: u64,
    index: u32,
    time: u64,
    certified: bool,
    #[serde(flatten)]
    answer: DecodedBytes,
}

#[derive(Serialize)]
struct Queried {
    /// Height of the state that answered.
    height: u64,
    /// Its block time, microseconds since the UNIX epoch.
    time: u64,
    /// For so long the node has reached no leader, microseconds.
    #[serde(skip_serializing_if = "is_zero")]
    stale_for: u64,
    #[serde(flatten)]
    answer: DecodedBytes,
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde gives a reference")]
fn is_zero(number: &u64) -> bool {
    *number == 0
}

fn write_answer(answer: &DecodedBytes, out: &mut dyn Write) -> io::Result<()> {
    let text = answer.to_text();
    if text.is_empty() { Ok(()) } else { writeln!(out, "{}", text.trim_end_matches('\n')) }
}

impl Facts for Invoked {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        write_answer(&self.answer, out)
    }
}

impl Facts for Queried {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        write_answer(&self.answer, out)
    }
}

impl Invoke {
    pub(crate) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let (chaincode, function, args) = self.call.read()?;
        let done = Session::open(global).await?.call(&chaincode, &function, args).await?;
        output.show(&Invoked {
            id: done.id,
            height: done.height,
            index: done.index,
            time: done.time,
            certified: done.certified,
            answer: DecodedBytes::read(&done.response),
        })?;
        output.note(&format!("executed in block {}, transaction {}", done.height, done.id));
        Ok(())
    }
}

impl Query {
    pub(crate) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let (chaincode, function, args) = self.call.read()?;
        let client = Session::open(global).await?.client;
        let answer = match self.stale {
            true => client.query_at(0, &chaincode, &function, args).await?,
            false => client.query(&chaincode, &function, args).await?,
        };
        let ledger_api::Answer { response, height, time, stale_for } = answer;
        output.show(&Queried { height, time, stale_for, answer: DecodedBytes::read(&response) })?;
        if stale_for > 0 {
            output.note(&format!(
                "as of block {height}, {}: the node has had no contact with a leader for {} s, so this may be stale",
                moment(time),
                stale_for / 1_000_000
            ));
        }
        Ok(())
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn an_invocation_in_json_is_flat_and_keeps_the_response_as_it_is() {
        let answer = DecodedBytes::read(br#"{"b":1,"a":2}"#);
        let text =
            serde_json::to_string(&Invoked { id: Hash::ZERO, height: 3, index: 1, time: 9, certified: true, answer })
                .unwrap();
        assert!(
            text.ends_with(
                r#""height":3,"index":1,"time":9,"certified":true,"encoding":"json","response":{"b":1,"a":2}}"#
            ),
            "{text}"
        );
    }

    #[test]
    fn an_empty_response_prints_nothing() {
        let mut out = Vec::new();
        Queried { height: 0, time: 0, stale_for: 0, answer: DecodedBytes::read(b"") }.text(&mut out).unwrap();
        assert!(out.is_empty());
    }
}
