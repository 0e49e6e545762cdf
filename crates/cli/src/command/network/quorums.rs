//! `network quorums`: how many must approve what.

use super::change::decide;
use super::{ask, json};
use crate::failure::Failure;
use crate::output::{Facts, Output, Table};
use crate::session::Session;
use ledger::Quorum;
use ledger::msp::{FunctionQuorum, SetQuorum};
use ledger_base::rejection::{Code, Rejection};
use serde::Serialize;
use std::io::{self, Write};

/// Show the quorum of each function that needs approval; for admins, change it.
///
/// A quorum is "organisations = majority", "organisations = all", "organisations = N", "admins of ORGANISATION = N", or
/// "admins = N" for N admins of the organisation that proposes. If the network has fewer than N organisations, all of
/// them must approve. A change needs the current quorum of the function. "default" restores the default.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Example:
  ledgerctl network quorums
  ledgerctl network quorums --set msp remove_organisation 'organisations = all'
  ledgerctl network quorums --set msp remove_organisation default")]
pub(crate) struct Quorums {
    /// Propose another quorum for a function, or approve an existing proposal for it
    #[arg(long, num_args = 3, value_names = ["CHAINCODE", "FUNCTION", "QUORUM"])]
    set: Option<Vec<String>>,
}

impl Quorums {
    pub(super) async fn run(self, session: &Session, output: &mut Output) -> Result<(), Failure> {
        let Some([chaincode, function, quorum]) = self.set.and_then(|set| <[String; 3]>::try_from(set).ok()) else {
            return output.show(&Known(ask(session, "quorums", vec![], "the quorums").await?));
        };
        let quorum = read(&quorum)?;
        let of = quorum.as_ref().map_or_else(|| "its default".to_owned(), Quorum::to_string);
        let done = format!("{chaincode} {function} now needs {of}");
        decide(session, output, "set_quorum", json(&SetQuorum { chaincode, function, quorum })?, done).await
    }
}

/// The quorum that somebody types; none for the default.
fn read(text: &str) -> Result<Option<Quorum>, Rejection> {
    if text == "default" {
        return Ok(None);
    }
    text.parse().map(Some).map_err(|wanted: ledger::NotAQuorum| {
        Rejection::new(Code::BadArgument, "this is not a quorum")
            .found(format!("{text:?}"))
            .wanted(format!("{wanted}, or \"default\""))
            .next("ledgerctl network quorums --help has examples")
    })
}

/// The quorums in force.
#[derive(Serialize)]
struct Known(Vec<FunctionQuorum>);

impl Facts for Known {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let mut table = Table::new(["CHAINCODE", "FUNCTION", "NEEDS", "SET BY"]);
        for FunctionQuorum { chaincode, function, quorum, set } in &self.0 {
            let by = if *set { "the network" } else { "default" };
            table.row([chaincode.clone(), function.clone(), quorum.to_string(), by.to_owned()]);
        }
        table.write(out, 0)
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn the_table_tells_what_was_set_from_what_is_the_default() {
        let quorum = |function: &str, quorum: &str, set| FunctionQuorum {
            chaincode: "msp".into(),
            function: function.into(),
            quorum: quorum.parse().unwrap(),
            set,
        };
        let mut out = Vec::new();
        let known = Known(vec![
            quorum("activate_rules", "organisations = majority", false),
            quorum("remove_organisation", "admins of Org1 = 2", true),
        ]);
        known.text(&mut out).unwrap();
        let text = String::from_utf8(out).unwrap();
        let lines = text.lines().skip(1).map(|line| line.split_whitespace().collect::<Vec<_>>().join(" "));
        assert_eq!(
            lines.collect::<Vec<_>>(),
            [
                "msp activate_rules organisations = majority default",
                "msp remove_organisation admins of Org1 = 2 the network"
            ]
        );
    }

    #[test]
    fn what_is_no_quorum_is_refused_with_those_that_there_are() {
        assert_eq!(read("default").unwrap(), None);
        assert_eq!(read("organisations=2").unwrap(), Some(Quorum::Organisations(2)));
        let refused = read("two of three").unwrap_err();
        assert!(
            refused.wanted.contains("admins of ORGANISATION = N") && refused.wanted.contains("default"),
            "{refused}"
        );
    }
}
