//! `status`: how a node and its network are.

use super::code_text;
use crate::failure::Failure;
use crate::global::Global;
use crate::health::{Attention, Certificate, Check, Disk, Voters, print_attention};
use crate::output::{Facts, Output, Table};
use crate::session::Session;
use crate::time;
use ledger_api::v1;
use serde::Serialize;
use std::collections::BTreeMap;
use std::io::{self, Write};

/// Show how the node and the network are.
///
/// Ends with 4 if the node knows no leader, so that nothing can be ordered.
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
        let (own, now) = (Certificate::own(&session.identity()?), time::now());
        node.attention.extend(Attention::own_certificate(&own, now));
        node.certificates.push(own);
        node.now = now;
        output.show(&node)?;
        self.check.judge(node.quorum.quorum, &node.attention)
    }
}

/// How a node is. Counts are keyed by the printed form of their code.
#[derive(Serialize)]
struct Node {
    version: String,
    network: String,
    network_label: String,
    node_id: u64,
    node_name: String,
    organisation: String,
    role: String,
    leader_id: u64,
    term: u64,
    height: u64,
    block_hash: String,
    block_time: u64,
    state_digest: String,
    committed: u64,
    /// It lacks blocks, and fetches up to this one.
    catching_up_to: Option<u64>,
    /// Up to where a majority of the voters has signed what blocks gave.
    certified: u64,
    last_index: u64,
    clock: u64,
    wall_clock: u64,
    uptime_ms: u64,
    chaincodes: Vec<String>,
    refused: BTreeMap<String, u64>,
    executed: BTreeMap<String, u64>,
    peers: Vec<Peer>,
    subscribers: u64,
    payload_bytes_max: u64,
    resident_bytes: u64,
    in_flight: u64,
    in_flight_max: u64,
    waiting_control: u64,
    waiting_data: u64,
    #[serde(flatten)]
    quorum: Voters,
    disk: Option<Disk>,
    certificates: Vec<Certificate>,
    #[serde(skip_serializing_if = "String::is_empty")]
    divergence: String,
    /// Nodes that were caught at a lie.
    #[serde(skip_serializing_if = "String::is_empty")]
    lies: String,
    /// What needs attention.
    attention: Vec<Attention>,
    /// When it was asked.
    #[serde(skip)]
    now: u64,
}

#[derive(Serialize)]
struct Peer {
    node_id: u64,
    name: String,
    organisation: String,
    address: String,
    voter: bool,
    matched: u64,
    connected: bool,
}

fn counts(counts: impl IntoIterator<Item = (u32, u64)>) -> BTreeMap<String, u64> {
    counts.into_iter().map(|(code, count)| (code_text(code), count)).collect()
}

impl From<v1::StatusResponse> for Node {
    fn from(status: v1::StatusResponse) -> Self {
        let led = status.leader_id != 0;
        Self {
            quorum: Voters::new(status.voters.into(), status.voters_connected.into(), led),
            disk: Disk::of(&status),
            certificates: Certificate::of(&status),
            attention: Attention::of(&status),
            divergence: status.divergence,
            lies: status.lies,
            now: 0,
            version: status.version,
            network: hex::encode(status.network),
            network_label: status.network_label,
            node_id: status.node_id,
            node_name: status.node_name,
            organisation: status.organisation,
            role: status.role,
            leader_id: status.leader_id,
            term: status.term,
            height: status.height,
            block_hash: hex::encode(status.block_hash),
            block_time: status.block_time,
            state_digest: hex::encode(status.state_digest),
            committed: status.committed,
            catching_up_to: Some(status.catching_up_to).filter(|height| *height > 0),
            certified: status.certified,
            last_index: status.last_index,
            clock: status.clock,
            wall_clock: status.wall_clock,
            uptime_ms: status.uptime_ms,
            chaincodes: status.chaincodes,
            refused: counts(status.refused),
            executed: counts(status.executed),
            peers: status.peers.into_iter().map(Peer::from).collect(),
            subscribers: status.subscribers,
            payload_bytes_max: status.payload_bytes_max,
            resident_bytes: status.resident_bytes,
            in_flight: status.in_flight,
            in_flight_max: status.in_flight_max,
            waiting_control: status.waiting_control,
            waiting_data: status.waiting_data,
        }
    }
}

impl From<v1::PeerStatus> for Peer {
    fn from(peer: v1::PeerStatus) -> Self {
        Self {
            node_id: peer.node_id,
            name: peer.name,
            organisation: peer.organisation,
            address: peer.address,
            voter: peer.voter,
            matched: peer.matched,
            connected: peer.connected,
        }
    }
}

fn count_list(counts: &BTreeMap<String, u64>) -> String {
    counts.iter().map(|(code, count)| format!("{code} {count}")).collect::<Vec<_>>().join(", ")
}

impl Facts for Node {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let leader = if self.leader_id == 0 { "none known".to_owned() } else { format!("node {}", self.leader_id) };
        let mut table = Table::pairs();
        table.pair("node", format!("{}/{} (id {}), {}", self.organisation, self.node_name, self.node_id, self.role));
        table.pair("version", &self.version);
        table.pair("network", format!("{} {}", self.network_label, self.network).trim_start());
        table.pair("leader", format!("{leader}, term {}", self.term));
        table.pair("voters", self.quorum.text());
        let fetches = self.catching_up_to.map_or_else(String::new, |height| format!(", fetches up to {height}"));
        table.pair("height", format!("{} of {} committed{fetches}", self.height, self.committed));
        table
            .pair("certified", if self.certified == 0 { "nothing yet".to_owned() } else { self.certified.to_string() });
        table.pair("block hash", &self.block_hash);
        table.pair("block time", time::moment(self.block_time));
        table.pair("state digest", &self.state_digest);
        table.pair("chaincodes", self.chaincodes.join(", "));
        table.pair("executed", count_list(&self.executed));
        table.pair("refused", count_list(&self.refused));
        table.pair("in flight", format!("{} of {}", self.in_flight, self.in_flight_max));
        table.pair("waiting", format!("{} urgent, {} messages", self.waiting_control, self.waiting_data));
        table.pair("subscribers", self.subscribers);
        table.pair("largest payload", format!("{} bytes", self.payload_bytes_max));
        table.pair("memory", format!("{} MiB", self.resident_bytes / (1024 * 1024)));
        table.pair("disk", self.disk.as_ref().map_or_else(String::new, Disk::text));
        for certificate in &self.certificates {
            table.pair("certificate", certificate.text(self.now));
        }
        table.pair("clock", time::moment(self.clock));
        table.pair("running for", time::span(self.uptime_ms.saturating_mul(1000)));
        table.write(out, 0)?;
        self.peers(out)?;
        print_attention(&self.attention, out)
    }
}

impl Node {
    fn peers(&self, out: &mut dyn Write) -> io::Result<()> {
        if self.peers.is_empty() {
            return Ok(());
        }
        writeln!(out)?;
        let mut peers = Table::new(["PEER", "ID", "ADDRESS", "VOTES", "CONNECTED", "MATCHED"]);
        for peer in &self.peers {
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
        assert!(text.contains("0 of 0 committed, fetches up to 9"), "{text}");
        assert!(text.ends_with("\nattention: Org1/node1: height 5 of 9\n  try      wait\n"), "{text}");
        let json = serde_json::to_value(&node).unwrap();
        let wanted = serde_json::json!([{
            "nodes": ["Org1/node1"], "check": "state", "severity": "critical", "message": "height 5 of 9", "next": "wait"
        }]);
        assert_eq!(json["attention"], wanted);
        assert_eq!(json["catching_up_to"], 9);
    }
}
