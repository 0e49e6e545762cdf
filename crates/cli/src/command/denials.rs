//! `denials`: what was refused before it was ordered.

use crate::argument::number;
use crate::failure::Failure;
use crate::global::Global;
use crate::output::{Facts, Output, Table};
use crate::session::Session;
use crate::time;
use ledger_api::facts::DenialFacts;
use serde::Serialize;
use std::io::{self, Write};

/// Show what the node rejected recently before ordering, newest first; for admins.
///
/// Calls that were rejected after ordering are in the blocks: `ledgerctl block N`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl denials --limit 20")]
pub(crate) struct Denials {
    /// Print at most N rejections
    #[arg(long, default_value_t = 100, value_name = "N", value_parser = number::count)]
    limit: u64,
}

impl Denials {
    pub(crate) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let denials =
            Session::open(global).await?.client.denials(u32::try_from(self.limit).unwrap_or(u32::MAX)).await?;
        output.show(&Shown(denials.into_iter().map(DenialFacts::from).collect()))
    }
}

#[derive(Serialize)]
struct Shown(Vec<DenialFacts>);

impl Facts for Shown {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        if self.0.is_empty() {
            return writeln!(out, "no rejections");
        }
        let mut table = Table::new(["TIME", "WHO", "CALL", "CODE", "TIMES", "WHY"]);
        for denial in &self.0 {
            table.row([
                time::moment(denial.time),
                denial.who.clone(),
                format!("{} {} {}", denial.chaincode, denial.function, denial.subject).trim_end().to_owned(),
                denial.code.clone(),
                denial.count.to_string(),
                denial.message.clone(),
            ]);
        }
        table.write(out, 0)
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use ledger_api::v1;

    #[test]
    fn a_denial_says_who_wanted_what_and_why_not() {
        let verdict =
            v1::Verdict { code: 3001, message: "Org1/Farhad may not acquire Husky".into(), ..Default::default() };
        let denial = v1::Denial {
            time: 1,
            who: "Org1/Farhad".into(),
            chaincode: "abac".into(),
            function: "acquire".into(),
            subject: "Husky".into(),
            verdict: Some(verdict),
            count: 3,
        };
        let mut out = Vec::new();
        Shown(vec![denial.into()]).text(&mut out).unwrap();
        let text = String::from_utf8(out).unwrap();
        for part in ["Org1/Farhad", "abac acquire Husky", "LGR-3001", "3 ", "may not acquire"] {
            assert!(text.contains(part), "{part:?} in {text}");
        }
    }
}
