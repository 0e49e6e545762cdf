//! `status`: how a node and its network are.

use super::code_text;
use crate::failure::Failure;
use crate::global::Global;
use crate::health::{Certificate, Check, Disk, Voters, attention, clock_wrong, lag, uncertified};
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
        node.certificates.push(Certificate::own(&session.identity()?));
        node.look(time::now());
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
    /// Why its clock is wrong.
    #[serde(skip_serializing_if = "String::is_empty")]
    clock_wrong: String,
    #[serde(skip_serializing_if = "String::is_empty")]
    divergence: String,
    /// Nodes that were caught at a lie.
    #[serde(skip_serializing_if = "String::is_empty")]
    lies: String,
    /// Points that need attention.
    attention: Vec<String>,
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
            clock_wrong: clock_wrong(&status),
            divergence: status.divergence,
            lies: status.lies,
            attention: Vec::new(),
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

impl Node {
    /// Collects what needs attention.
    fn look(&mut self, now: u64) {
        let name = format!("{}/{}", self.organisation, self.node_name);
        let differs = (!self.divergence.is_empty()).then(|| format!("{name}: {}", self.divergence));
        let lies = (!self.lies.is_empty()).then(|| self.lies.clone());
        let lag = lag(&name, self.height, self.catching_up_to.unwrap_or_default());
        let clock = (!self.clock_wrong.is_empty()).then(|| format!("{name}: {}", self.clock_wrong));
        let disk = self.disk.as_ref().and_then(|disk| disk.attention(&name));
        let ending = self.certificates.iter().filter_map(|certificate| certificate.attention(now));
        let voters = self.quorum.attention().into_iter().chain(uncertified(self.voters()));
        self.attention = voters.chain(lag).chain(clock).chain(disk).chain(differs).chain(lies).chain(ending).collect();
        self.now = now;
    }

    /// The organisation of each voter, and whether it answers. The asked node is one if its peers are not all of them.
    fn voters(&self) -> impl Iterator<Item = (&str, bool)> {
        let others = self.peers.iter().filter(|peer| peer.voter);
        let own = others.clone().count() as u64 != self.quorum.voters;
        others.map(|peer| (&*peer.organisation, peer.connected)).chain(own.then_some((&*self.organisation, true)))
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
        attention(&self.attention, out)
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

    /// Org1/node1 of three voters, with the connections to the two others.
    fn status(org2_answers: bool, org1_answers: bool) -> v1::StatusResponse {
        let peer = |name: &str, organisation: &str, connected| v1::PeerStatus {
            name: name.to_owned(),
            organisation: organisation.to_owned(),
            voter: true,
            connected,
            ..Default::default()
        };
        v1::StatusResponse {
            node_name: "node1".to_owned(),
            organisation: "Org1".to_owned(),
            role: "leader".to_owned(),
            leader_id: 1,
            height: 5,
            peers: vec![peer("node2", "Org2", org2_answers), peer("node3", "Org1", org1_answers)],
            voters: 3,
            voters_connected: 1 + u32::from(org2_answers) + u32::from(org1_answers),
            ..Default::default()
        }
    }

    fn looked(status: v1::StatusResponse) -> Node {
        let mut node = Node::from(status);
        node.look(0);
        node
    }

    #[test]
    fn the_asked_node_counts_as_a_voter_of_its_organisation_whatever_it_does_in_the_ordering() {
        for role in ["leader", "follower", "candidate"] {
            let told = |org2, org1| {
                looked(v1::StatusResponse { role: role.to_owned(), ..status(org2, org1) }).attention.join("; ")
            };
            assert_eq!(told(true, true), "");
            let one_less = told(true, false);
            assert!(one_less.contains("2 of 3 answer") && !one_less.contains("only those of"), "{one_less}");
            let alone = told(false, true);
            assert!(alone.contains("only those of Org1 answer; without one of Org2"), "{alone}");
        }
    }

    #[test]
    fn an_asked_node_that_only_follows_is_no_voter_that_answers() {
        let learner =
            v1::StatusResponse { role: "learner".to_owned(), voters: 2, voters_connected: 1, ..status(true, false) };
        let told = looked(learner).attention.join("; ");
        assert!(told.contains("only those of Org2 answer; without one of Org1"), "{told}");
    }

    #[test]
    fn a_node_that_lags_says_so_in_text_and_json_and_needs_attention() {
        let node = looked(v1::StatusResponse { catching_up_to: 9, ..status(true, true) });
        assert_eq!(node.attention, ["Org1/node1 lags: it has block 5 and fetches up to 9"]);
        let mut text = Vec::new();
        node.text(&mut text).unwrap();
        assert!(String::from_utf8_lossy(&text).contains("5 of 0 committed, fetches up to 9"));
        let told = serde_json::to_value(&node).unwrap();
        assert_eq!(told.get("catching_up_to").and_then(serde_json::Value::as_u64), Some(9));
        assert!(looked(status(true, true)).attention.is_empty());
    }

    #[test]
    fn a_node_whose_clock_is_behind_block_time_needs_attention() {
        let late = v1::StatusResponse { wall_clock: 1, block_time: 240_000_001, ..status(true, true) };
        assert_eq!(looked(late).attention, ["Org1/node1: block time is 4 min ahead of its clock"]);
    }
}
