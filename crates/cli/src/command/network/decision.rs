//! How a decision is told: done, or who must still approve.

use crate::output::{Facts, Table, printable};
use ledger::governance::{Action, Decision, NodeRole};
use serde::Serialize;
use std::io::{self, Write};

/// The outcome of a wish.
#[derive(Serialize)]
pub(super) struct Decided {
    #[serde(flatten)]
    pub(super) decision: Decision,
    /// Told when it is done.
    #[serde(skip)]
    pub(super) done: String,
}

impl Facts for Decided {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        if self.decision.executed {
            return writeln!(out, "{}", printable(&self.done));
        }
        waiting(&self.decision, out)
    }
}

/// Tells which approvals a decision waits for.
pub(super) fn waiting(decision: &Decision, out: &mut dyn Write) -> io::Result<()> {
    let Some(proposal) = &decision.proposal else { return Ok(()) };
    writeln!(out, "proposed: {}", printable(&what(&proposal.action)))?;
    let mut table = Table::pairs();
    table.pair("proposal", short(&proposal.id.to_string()));
    table.pair("approved by", joined(&proposal.approvals));
    table.pair("missing", format!("{} of {}", decision.missing, joined(&decision.pending)));
    table.pair("ends", crate::time::moment(proposal.expires));
    table.write(out, 2)?;
    writeln!(out, "next, an admin of {} types:", printable(&decision.pending.join(" or ")))?;
    writeln!(out, "  ledgerctl network approve {}", short(&proposal.id.to_string()))
}

/// An action in words.
pub(super) fn what(action: &Action) -> String {
    match action {
        Action::SetNodeRole { id, node, role: NodeRole::Removed } => format!("remove node {node} (id {id})"),
        Action::SetNodeRole { id, node, role } => format!("make node {node} (id {id}) a {role}"),
        Action::InviteOrganisation { name, .. } => format!("invite organisation {name}"),
        Action::RemoveOrganisation { name } => format!("remove organisation {name}"),
        Action::ActivateRules { number, height: None } => format!("activate rules {number}"),
        Action::ActivateRules { number, height: Some(height) } => format!("activate rules {number} at block {height}"),
    }
}

/// The first digits of an id: enough to name a proposal.
pub(super) fn short(id: &str) -> &str {
    id.get(..12).unwrap_or(id)
}

pub(super) fn joined<'a>(names: impl IntoIterator<Item = &'a String>) -> String {
    names.into_iter().map(String::as_str).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use ledger::governance::Proposal;
    use ledger_hash::Hash;

    fn decision(executed: bool) -> Decision {
        let action = Action::SetNodeRole { id: 2, node: "Org2/node2".into(), role: NodeRole::Voter };
        let approvals = ["Org1".to_owned()].into();
        let (by, organisation) = ("Org1/admin".into(), "Org1".into());
        let proposal = Proposal { id: Hash([0xab; 32]), action, by, organisation, approvals, created: 0, expires: 1 };
        let pending = vec!["Org2".to_owned(), "Org3".to_owned()];
        Decision { executed, proposal: Some(proposal), missing: usize::from(!executed), pending }
    }

    fn told(executed: bool) -> String {
        let mut out = Vec::new();
        let done = "node Org2/node2 becomes a voter".to_owned();
        Decided { decision: decision(executed), done }.text(&mut out).unwrap();
        String::from_utf8(out).unwrap()
    }

    #[test]
    fn a_decision_that_waits_says_who_must_approve_and_how() {
        let text = told(false);
        for part in [
            "proposed: make node Org2/node2 (id 2) a voter\n",
            "  approved by  Org1\n",
            "  missing      1 of Org2, Org3\n",
            "next, an admin of Org2 or Org3 types:\n  ledgerctl network approve abababababab\n",
        ] {
            assert!(text.contains(part), "{part:?} in {text}");
        }
    }

    #[test]
    fn a_decision_that_was_taken_says_what_happens() {
        assert_eq!(told(true), "node Org2/node2 becomes a voter\n");
    }

    #[test]
    fn programs_read_the_decision_as_the_ledger_gave_it() {
        let decided = Decided { decision: decision(false), done: String::new() };
        let json = serde_json::to_value(&decided).unwrap();
        assert_eq!(json, serde_json::to_value(decision(false)).unwrap());
    }
}
