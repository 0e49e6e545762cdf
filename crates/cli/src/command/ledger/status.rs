//! `status`: how a node and its network are.

use crate::failure::Failure;
use crate::global::Global;
use crate::health::{Attention, Check, Voters, certificate_text, disk_text, own_certificate, print_attention};
use crate::output::{Facts, Output, Table};
use crate::session::Session;
use crate::time;
use ledger_api::facts::{PeerFacts, StatusFacts};
use ledger_api::v1;
use serde::Serialize;
use std::collections::BTreeMap;
use std::io::{self, Write};

/// Show the state of the node and the network.
///
/// Exits with 4 if the node has no leader, so that nothing can be ordered.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl status\n  ledgerctl status --check")]
pub(crate) struct Status {
    #[command(flatten)]
    check: Check,
}

impl Status {
    pub(crate) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let session = Session::open(global).await?;
        let mut node = Node::from(session.client.status().await?);
        let (own, now) = (own_certificate(&session.identity()?), time::now());
        node.attention.extend(Attention::own_certificate(&own, now));
        node.facts.certificates.push(own);
        node.now = now;
        output.show(&node)?;
        self.check.judge(node.quorum, &node.attention)
    }
}

/// A node.
#[derive(Serialize)]
struct Node {
    #[serde(flatten)]
    facts: StatusFacts,
    failures_tolerated: u64,
    quorum: bool,
    /// Problems, with the nodes that report them.
    attention: Vec<Attention>,
    #[serde(skip)]
    voters: Voters,
    /// When it was asked.
    #[serde(skip)]
    now: u64,
}

impl From<v1::StatusResponse> for Node {
    fn from(status: v1::StatusResponse) -> Self {
        let attention = Attention::of(&status);
        let mut facts = StatusFacts::from(status);
        facts.attention = None;
        let voters = Voters::new(facts.voters.into(), facts.voters_reachable.into(), facts.leader_id != 0);
        let (failures_tolerated, quorum) = (voters.failures_tolerated, voters.quorum);
        Self { facts, failures_tolerated, quorum, attention, voters, now: 0 }
    }
}

fn count_list(counts: &BTreeMap<String, u64>) -> String {
    counts.iter().map(|(code, count)| format!("{code} {count}")).collect::<Vec<_>>().join(", ")
}

impl Facts for Node {
    fn omitted(&self) -> &'static [&'static str] {
        &["first_height", "snapshot_height", "console", "peers.role", "peers.clock_offset_us", "peers.clock_error_us"]
    }

    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let facts = &self.facts;
        let leader = if facts.leader_id == 0 { "none".to_owned() } else { format!("node {}", facts.leader_id) };
        let mut table = Table::pairs();
        table
            .pair("node", format!("{}/{} (id {}), {}", facts.organisation, facts.node_name, facts.node_id, facts.role));
        table.pair("version", &facts.version);
        table.pair("network", format!("{} {}", facts.network_label, facts.network).trim_start());
        table.pair("leader", format!("{leader}, term {}", facts.term));
        table.pair("voters", self.voters.text());
        let fetches = facts.catching_up_to.map_or_else(String::new, |height| format!(", fetching up to {height}"));
        table.pair("height", format!("{} of {} committed{fetches}", facts.height, facts.committed));
        table.pair("certified", if facts.certified == 0 { "none yet".to_owned() } else { facts.certified.to_string() });
        table.pair("certificates", facts.certificate_rule.rule());
        table.pair("survives", facts.certificate_rule.survives());
        table.pair("block hash", &facts.block_hash);
        table.pair("block time", time::moment(facts.block_time));
        table.pair("state digest", &facts.state_digest);
        table.pair("chaincodes", facts.chaincodes.join(", "));
        table.pair("executed", count_list(&facts.executed));
        table.pair("refused", count_list(&facts.refused));
        table.pair("in flight", format!("{} of {}", facts.in_flight, facts.in_flight_max));
        table.pair("waiting", format!("{} urgent, {} messages", facts.waiting_control, facts.waiting_data));
        table.pair("subscribers", facts.subscribers);
        table.pair("largest payload", format!("{} bytes", facts.payload_bytes_max));
        table.pair("memory", format!("{} MiB", facts.resident_bytes / (1024 * 1024)));
        table.pair("disk", disk_text(&facts.disk));
        for certificate in &facts.certificates {
            table.pair("certificate", certificate_text(certificate, self.now));
        }
        for stop in &facts.open_stops {
            let until = time::moment(stop.not_after);
            table.pair("stop without a verdict", format!("of {}, by {}, open until {until}", stop.robot, stop.by));
        }
        table.pair("clock", time::moment(facts.clock));
        table.pair("running for", time::span(facts.uptime_ms.saturating_mul(1000)));
        table.write(out, 0)?;
        print_peers(&facts.peers, out)?;
        print_attention(&self.attention, out)
    }
}

fn print_peers(all: &[PeerFacts], out: &mut dyn Write) -> io::Result<()> {
    if all.is_empty() {
        return Ok(());
    }
    writeln!(out)?;
    let mut peers = Table::new(["PEER", "ID", "ADDRESS", "VOTES", "CONNECTED", "REPLICATED"]);
    for peer in all {
        peers.row([
            format!("{}/{}", peer.organisation, peer.name),
            peer.node_id.to_string(),
            peer.address.clone(),
            yes_no(peer.voter),
            yes_no(peer.connected),
            if peer.matched == 0 { "-".to_owned() } else { peer.matched.to_string() },
        ]);
    }
    peers.write(out, 0)
}

fn yes_no(value: bool) -> String {
    if value { "yes" } else { "no" }.to_owned()
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn what_the_node_reports_is_shown_in_text_and_json() {
        let item = v1::Attention {
            check: "state".into(),
            severity: "critical".into(),
            message: "height 5 of 9".into(),
            next: "wait".into(),
        };
        let node = Node::from(v1::StatusResponse {
            node_name: "node1".to_owned(),
            organisation: "Org1".to_owned(),
            catching_up_to: 9,
            attention: vec![item],
            ..Default::default()
        });
        let mut text = Vec::new();
        node.text(&mut text).unwrap();
        let text = String::from_utf8_lossy(&text);
        assert!(text.contains("0 of 0 committed, fetching up to 9"), "{text}");
        assert!(text.ends_with("\nattention: Org1/node1: height 5 of 9\n  try      wait\n"), "{text}");
        let json = serde_json::to_string(&node).unwrap();
        assert_eq!(json.matches(r#""attention":"#).count(), 1, "{json}");
        let json: serde_json::Value = serde_json::from_str(&json).unwrap();
        let wanted = serde_json::json!([{
            "nodes": ["Org1/node1"], "check": "state", "severity": "critical", "message": "height 5 of 9", "next": "wait"
        }]);
        assert_eq!(json.get("attention"), Some(&wanted));
        assert_eq!(json.get("catching_up_to"), Some(&9.into()));
    }
}
