//! `network rules`: the rules of execution, who speaks which, and the activation of newer ones.

use super::change::decide;
use super::{ask, json};
use crate::failure::Failure;
use crate::output::{Facts, Output, Table};
use crate::session::Session;
use ledger::Activation;
use ledger::msp::{ActivateRules, NodeRole, RulesOverview, SpokenBy};
use serde::Serialize;
use std::io::{self, Write};

/// Show the execution rules and the versions that each node supports; for admins, activate newer rules.
///
/// Every block is executed by the rules that its network had at that height. A newer release may support newer rules.
/// They are activated when more than half of the organisations approve, and only if every voter supports them. A node
/// that does not support them stops before their first block.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Example:
  ledgerctl network rules
  ledgerctl network rules --activate 2
  ledgerctl network rules --activate 2 --from 120000")]
pub(crate) struct Rules {
    /// Propose newer rules, or approve an existing proposal for them
    #[arg(long, value_name = "NUMBER")]
    activate: Option<u32>,
    /// First block that uses them; the next one by default
    #[arg(long, value_name = "HEIGHT", requires = "activate")]
    from: Option<u64>,
}

impl Rules {
    pub(super) async fn run(self, session: &Session, output: &mut Output) -> Result<(), Failure> {
        let Some(number) = self.activate else {
            let overview = ask(session, "rules", vec![], "the rules").await?;
            let asked = session.client.status().await?.node_id;
            return output.show(&Known { overview, asked });
        };
        let args = json(&ActivateRules { number, height: self.from })?;
        let done = format!("rules {number} are activated; ledgerctl network rules shows from which block");
        decide(session, output, "activate_rules", args, done).await
    }
}

/// The rules of the network.
#[derive(Serialize)]
struct Known {
    #[serde(flatten)]
    overview: RulesOverview,
    /// Id of the node that was asked.
    asked: u64,
}

impl Known {
    /// The newest rules that every voter speaks.
    fn by_all_voters(&self) -> Option<u32> {
        let voters = self.overview.nodes.iter().filter(|node| node.role == NodeRole::Voter);
        voters.map(|node| node.newest).min()
    }
}

impl Facts for Known {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let RulesOverview { active, pending, activations, nodes } = &self.overview;
        let of_block = |at: &Activation| format!("{}, from block {}", at.number, at.height);
        let in_force = activations.iter().rfind(|at| at.number == *active);
        let mut table = Table::pairs();
        table.pair("in force", in_force.map_or_else(|| format!("{active}, since the first block"), of_block));
        table.pair("pending", pending.as_ref().map_or_else(|| "none".to_owned(), of_block));
        if let Some(asked) = nodes.iter().find(|node| node.id == self.asked) {
            table.pair("this node", format!("{} supports up to {}", asked.node, asked.newest));
        }
        table.write(out, 0)?;
        writeln!(out)?;
        let mut table = Table::new(["NODE", "TARGET", "SUPPORTS UP TO", "RELEASE"]);
        for SpokenBy { node, role, newest, release, .. } in nodes {
            let release = release.clone().unwrap_or_else(|| "-".to_owned());
            table.row([node.clone(), role.to_string(), newest.to_string(), release]);
        }
        table.write(out, 0)?;
        match self.by_all_voters().filter(|newest| newest > active && pending.is_none()) {
            Some(newest) => {
                writeln!(out, "\nevery voter supports rules {newest}; to activate them, an admin runs:")?;
                writeln!(out, "  ledgerctl network rules --activate {newest}")
            }
            None => Ok(()),
        }
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    fn node(id: u64, role: NodeRole, newest: u32) -> SpokenBy {
        SpokenBy { id, node: format!("Org1/node{id}"), role, newest, release: (newest > 2).then(|| "0.2.0".to_owned()) }
    }

    fn told(pending: Option<Activation>, nodes: Vec<SpokenBy>) -> String {
        let activations = pending.into_iter().collect();
        let overview = RulesOverview { active: 2, pending, activations, nodes };
        let mut out = Vec::new();
        Known { overview, asked: 1 }.text(&mut out).unwrap();
        String::from_utf8(out).unwrap()
    }

    #[test]
    fn newer_rules_are_offered_when_every_voter_speaks_them_and_none_are_pending() {
        let (voter, learner) = (NodeRole::Voter, NodeRole::Learner);
        let all = || vec![node(1, voter, 3), node(2, voter, 3), node(3, learner, 2)];
        let text = told(None, all());
        for part in ["in force   2, since", "Org1/node1 supports up to 3", "--activate 3\n", "0.2.0"] {
            assert!(text.contains(part), "{part:?} in {text}");
        }
        let silent = told(None, vec![node(1, voter, 3), node(2, voter, 2)]);
        assert!(!silent.contains("--activate"), "{silent}");
        let pending = told(Some(Activation { number: 3, height: 70 }), all());
        assert!(pending.contains("3, from block 70") && !pending.contains("--activate"), "{pending}");
    }
}
