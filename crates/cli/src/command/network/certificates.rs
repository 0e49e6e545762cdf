//! `network certificates`: how many signatures make a certificate, and which organisations are under one hand.

use super::change::decide;
use super::{ask, json};
use crate::failure::Failure;
use crate::output::{Facts, Output, Table};
use crate::session::Session;
use ledger::msp::{Nodes, SetCertificateRule};
use ledger_api::facts::CertificateRuleFacts;
use ledger_base::rejection::{Code, Rejection};
use serde::Serialize;
use std::collections::BTreeSet;
use std::io::{self, Write};

/// Show how many signatures certify a block, and which faults the voters tolerate; for admins, change the rule.
///
/// Strict certificates need more than (N + m) / 2 signatures of N voters, where m is the number of voters of the
/// largest organisation. One organisation then cannot have two different blocks certified, even if all its voters lie.
/// Certificates become strict automatically once enough voters remain after the loss of any one, for example with four
/// organisations that have one voter each. A change needs the approval of the organisations.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Example:
  ledgerctl network certificates
  ledgerctl network certificates --set strict
  ledgerctl network certificates --one-hand OrgA,OrgB")]
pub(crate) struct Certificates {
    /// Propose strict certificates or their end, or approve an existing proposal for it
    #[arg(long, value_name = "strict|majority")]
    set: Option<String>,
    /// Propose to count these organisations as one, because they are under common control; repeat it for other sets,
    /// "none" removes all
    #[arg(long, value_name = "ORGANISATION,ORGANISATION", allow_hyphen_values = true)]
    one_hand: Vec<String>,
}

impl Certificates {
    pub(super) async fn run(self, session: &Session, output: &mut Output) -> Result<(), Failure> {
        let strict = self.set.as_deref().map(read).transpose()?;
        let hands = (!self.one_hand.is_empty()).then(|| hands(&self.one_hand));
        if strict.is_none() && hands.is_none() {
            let nodes: Nodes = ask(session, "nodes", vec![], "the nodes").await?;
            let hands = nodes.certificates.hands.clone();
            return output.show(&Known { rule: CertificateRuleFacts::of(&nodes.voters()), hands });
        }
        let done = "the certificate rule is changed: ledgerctl network certificates".to_owned();
        decide(session, output, "set_certificate_rule", json(&SetCertificateRule { strict, hands })?, done).await
    }
}

fn read(text: &str) -> Result<bool, Rejection> {
    match text {
        "strict" => Ok(true),
        "majority" => Ok(false),
        _ => Err(Rejection::new(Code::BadArgument, "unknown certificate rule")
            .found(format!("{text:?}"))
            .wanted("strict or majority")
            .next("ledgerctl network certificates --help explains both")),
    }
}

/// The sets of `--one-hand`; `none` is no set.
fn hands(texts: &[String]) -> Vec<BTreeSet<String>> {
    let set = |text: &String| text.split(',').map(|name| name.trim().to_owned()).collect();
    texts.iter().filter(|text| *text != "none").map(set).collect()
}

/// The rule in force.
#[derive(Serialize)]
struct Known {
    #[serde(flatten)]
    rule: CertificateRuleFacts,
    hands: Vec<BTreeSet<String>>,
}

impl Facts for Known {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let mut table = Table::pairs();
        table.pair("certificates", self.rule.rule());
        table.pair("survives", self.rule.survives());
        for hand in &self.hands {
            table.pair("one hand", hand.iter().map(String::as_str).collect::<Vec<_>>().join(", "));
        }
        table.write(out, 0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn organisations_under_one_hand_are_read_from_lists_and_none_ends_all() {
        let set = |names: &[&str]| names.iter().map(|name| (*name).to_owned()).collect::<BTreeSet<_>>();
        let typed = |texts: &[&str]| hands(&texts.iter().map(|text| (*text).to_owned()).collect::<Vec<_>>());
        assert_eq!(typed(&["OrgA,OrgB", "OrgC, OrgD"]), [set(&["OrgA", "OrgB"]), set(&["OrgC", "OrgD"])]);
        assert!(typed(&["none"]).is_empty());
        assert!(read("loose").is_err());
    }
}
