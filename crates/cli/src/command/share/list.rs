//! `share list`, `share show`: the shares in force.

use crate::command::policy::meaning::{check, meaning};
use crate::failure::Failure;
use crate::output::{Facts, Output, Table, printable, printable_lines};
use crate::session::{ABAC, Session};
use crate::time;
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{PolicyMeaning, ShareEntry, ShareTerms};
use serde::Serialize;
use std::io::{self, Write};

/// List the shares of every owner.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl share list")]
pub(super) struct List {}

/// Show a share in words and in Cedar.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl share show share-Turtlebot4-Org1")]
pub(super) struct Show {
    /// Name of the share, as in `share list`; ORG/NAME for one of another owner
    id: String,
}

impl List {
    pub(super) async fn run(self, session: &Session, output: &mut Output) -> Result<(), Failure> {
        output.show(&ShareList(session.list(ABAC, "shares").await?))
    }
}

impl Show {
    pub(super) async fn run(self, session: &Session, output: &mut Output) -> Result<(), Failure> {
        let share = find(session, &self.id).await?;
        let meaning = check(session, &share.text).await?.policies;
        output.show(&ShareInWords { share, meaning })
    }
}

/// The share of this name: of the own organisation, unless it names another one.
pub(super) async fn find(session: &Session, name: &str) -> Result<ShareEntry, Rejection> {
    let home = session.identity()?.organisation;
    let (owner, id) = name.split_once('/').unwrap_or((&home, name));
    let all: Vec<ShareEntry> = session.list(ABAC, "shares").await?;
    let known: Vec<&str> =
        all.iter().filter(|share| share.organisation == owner).map(|share| share.id.as_str()).collect();
    if let Some(share) = all.iter().find(|share| share.organisation == owner && share.id == id) {
        return Ok(share.clone());
    }
    let near = ledger_base::nearest::did_you_mean(id, known.iter().copied(), "ledgerctl share list");
    Err(Rejection::new(Code::NotFound, format!("{owner} has no share of this name"))
        .found(id)
        .wanted(if known.is_empty() {
            "a share; it has none".to_owned()
        } else {
            format!("one of {}", known.join(", "))
        })
        .next(near))
}

#[derive(Serialize)]
struct ShareList(Vec<ShareEntry>);

impl Facts for ShareList {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        if self.0.is_empty() {
            return writeln!(out, "no shares; policies may permit more: ledgerctl policy list");
        }
        let mut table = Table::new(["SHARE", "OF", "ROBOT", "WITH", "MAY", "WHEN", "LIMITS"]);
        for share in &self.0 {
            let (id, owner) = (share.id.clone(), share.organisation.clone());
            let row = match &share.terms {
                None => [
                    id,
                    owner,
                    String::new(),
                    String::new(),
                    "edited: see its text".to_owned(),
                    String::new(),
                    String::new(),
                ],
                Some(terms) => {
                    let with = match &terms.attribute {
                        Some(attribute) => format!("{} with {attribute}", terms.with),
                        None => terms.with.clone(),
                    };
                    let may = if terms.read_only { "read" } else { "use" };
                    [id, owner, terms.resource.clone(), with, may.to_owned(), when(terms), limits(terms)]
                }
            };
            table.row(row);
        }
        table.write(out, 0)
    }
}

/// The time of a share in words.
fn when(terms: &ShareTerms) -> String {
    let from = terms.from.map(|from| format!("from {}", time::moment(from)));
    let until = terms.until.map(|until| format!("until {}", time::moment(until)));
    [from, until, terms.hours.clone()].into_iter().flatten().collect::<Vec<_>>().join(", ")
}

/// The limits of a share in words.
fn limits(terms: &ShareTerms) -> String {
    let unit = |value: &Option<String>, unit: &str| value.as_ref().map(|value| format!("{value} {unit}"));
    let parts = [
        unit(&terms.max_linear, "m/s"),
        unit(&terms.max_angular, "rad/s"),
        unit(&terms.rate, "Hz"),
        terms.priority.as_ref().map(|priority| format!("priority {priority}")),
    ];
    parts.into_iter().flatten().collect::<Vec<_>>().join(", ")
}

#[derive(Serialize)]
struct ShareInWords {
    #[serde(flatten)]
    share: ShareEntry,
    meaning: Vec<PolicyMeaning>,
}

impl Facts for ShareInWords {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        writeln!(out, "{} of {}:", printable(&self.share.id), printable(&self.share.organisation))?;
        for policy in &self.meaning {
            meaning(out, policy)?;
        }
        if self.share.edited {
            writeln!(out, "  it was edited: only its text is authoritative")?;
        }
        writeln!(out, "{}", printable_lines(self.share.text.trim()))
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn the_list_says_with_whom_when_and_how_fast() {
        let terms = ShareTerms {
            resource: "Husky/cmd_vel".into(),
            with: "Org1".into(),
            attribute: Some("guest=true".into()),
            hours: Some("08:00-18:00 Z".into()),
            max_linear: Some("0.3".into()),
            ..ShareTerms::default()
        };
        let entry = |text: &str| ShareEntry::of("Org2", "share-x", text).unwrap();
        let mut out = Vec::new();
        ShareList(vec![entry(&terms.text()), entry("@share(\"1\") permit (principal, action, resource);")])
            .text(&mut out)
            .unwrap();
        let wanted = "SHARE    OF    ROBOT          WITH                  MAY                   WHEN           LIMITS\n\
                      share-x  Org2  Husky/cmd_vel  Org1 with guest=true  use                   08:00-18:00 Z  0.3 m/s\n\
                      share-x  Org2                                       edited: see its text\n";
        assert_eq!(String::from_utf8(out).unwrap(), wanted);
    }
}
