//! `policy history`: the numbered sets of an organisation.

use crate::answer;
use crate::failure::Failure;
use crate::global::Global;
use crate::output::{Facts, Output, Table};
use crate::session::{ABAC, Session};
use crate::time;
use bytes::Bytes;
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{PolicyEntry, PolicySet, PolicySetTexts, PolicyText};
use serde::Serialize;
use std::io::{self, Write};

/// List the policy sets of an organisation, newest first.
///
/// Every change creates a new set with the next version number. The newest 32 are stored with their texts.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl policy history\n  ledgerctl policy history Org2")]
pub(crate) struct History {
    /// The organisation; your own by default
    #[arg(value_name = "ORG")]
    organisation: Option<String>,
}

impl History {
    pub(super) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let session = Session::open(global).await?;
        let organisation = match self.organisation {
            Some(organisation) => organisation,
            None => session.identity()?.organisation,
        };
        let response = session.ask(ABAC, "policy_history", vec![Bytes::from(organisation)]).await?;
        output.show(&Sets(answer::parse(&response, "sets of policies")?))
    }
}

/// A policy as it was in a set. `id` is a name, or ORG/NAME.
pub(super) async fn entry(session: &Session, home: &str, id: &str, version: u64) -> Result<PolicyEntry, Failure> {
    let (organisation, id) = id.split_once('/').unwrap_or((home, id));
    let args = vec![Bytes::from(organisation.to_owned()), Bytes::from(version.to_string())];
    let response = session.ask(ABAC, "policy_set", args).await?;
    let PolicySetTexts { policies, .. } = answer::parse(&response, "a set of policies")?;
    let names: Vec<&str> = policies.iter().map(|policy| policy.id.as_str()).collect();
    let found = policies.iter().find(|policy| policy.id == id).cloned();
    let Some(PolicyText { id, text }) = found else {
        let names =
            if names.is_empty() { "no policy: the built-in policy decided".to_owned() } else { names.join(", ") };
        let message = format!("version {version} of {organisation} has no policy of this name");
        return Err(Rejection::new(Code::NotFound, message).found(id).wanted(names).into());
    };
    Ok(PolicyEntry { organisation: organisation.to_owned(), id, text })
}

#[derive(Serialize)]
struct Sets(Vec<PolicySet>);

impl Facts for Sets {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        if self.0.is_empty() {
            return writeln!(out, "no policy sets: the built-in policy decides");
        }
        let mut table = Table::new(["VERSION", "SINCE", "BY", "APPROVED BY", "POLICIES", "NEXT NEEDS", "MESSAGE"]);
        for set in &self.0 {
            let names: Vec<&str> = set.policies.iter().map(|policy| policy.id.as_str()).collect();
            let back = set.restores.map(|version| format!("version {version} again")).unwrap_or_default();
            let message = [back, set.message.clone()].into_iter().filter(|part| !part.is_empty());
            table.row([
                set.version.to_string(),
                time::moment(set.time),
                or_dash(&set.by),
                or_dash(&approved(set)),
                if names.is_empty() { "built-in".to_owned() } else { names.join(", ") },
                or_dash(set.approvals.as_deref().unwrap_or_default()),
                or_dash(&message.collect::<Vec<_>>().join(": ")),
            ]);
        }
        table.write(out, 0)
    }
}

fn approved(set: &PolicySet) -> String {
    let names = set.approved_by.join(", ");
    if set.break_glass { format!("{names} (break-glass)") } else { names }
}

fn or_dash(text: &str) -> String {
    if text.is_empty() { "-".to_owned() } else { text.to_owned() }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use ledger_contract::PolicyDigest;

    #[test]
    fn a_history_tells_who_put_which_set_in_force_and_why() {
        let digest = PolicyDigest { id: "night".into(), sha256: String::new(), bytes: 1 };
        let set = PolicySet {
            organisation: "Org2".into(),
            version: 2,
            hash: String::new(),
            by: "Org2/admin".into(),
            message: "too dark".into(),
            time: 1_795_219_200_000_000,
            height: 7,
            approved_by: vec!["Org2/admin".into()],
            break_glass: true,
            restores: Some(1),
            approvals: Some("admins = 2".into()),
            policies: vec![digest],
        };
        let mut out = Vec::new();
        Sets(vec![set]).text(&mut out).unwrap();
        let text = String::from_utf8(out).unwrap();
        let row = text.lines().nth(1).unwrap();
        for part in ["2 ", "Org2/admin (break-glass)", "night", "admins = 2", "version 1 again: too dark"] {
            assert!(row.contains(part), "{part}: {row}");
        }
        let mut out = Vec::new();
        Sets(vec![]).text(&mut out).unwrap();
        assert_eq!(String::from_utf8(out).unwrap(), "no policy sets: the built-in policy decides\n");
    }
}
