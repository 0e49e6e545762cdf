//! The description of a node.

use super::{code_text, utc};
use ledger_api::v1;
use serde::Serialize;
use std::collections::BTreeMap;

/// A node, as `ledgerctl status -o json` prints it. Counts are keyed by code.
#[derive(Serialize)]
pub(in crate::clients::http) struct StatusFacts {
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
    block_time_utc: Option<String>,
    state_digest: String,
    committed: u64,
    catching_up_to: Option<u64>,
    certified: u64,
    first_height: u64,
    snapshot_height: u64,
    last_index: u64,
    clock: u64,
    clock_utc: Option<String>,
    wall_clock: u64,
    wall_clock_utc: Option<String>,
    uptime_ms: u64,
    chaincodes: Vec<String>,
    refused: BTreeMap<String, u64>,
    executed: BTreeMap<String, u64>,
    peers: Vec<PeerFacts>,
    subscribers: u64,
    payload_bytes_max: u64,
    resident_bytes: u64,
    in_flight: u64,
    in_flight_max: u64,
    waiting_control: u64,
    waiting_data: u64,
    voters: u32,
    voters_reachable: u32,
    disk: DiskFacts,
    certificates: Vec<CertificateFacts>,
    attention: Vec<AttentionFacts>,
    #[serde(skip_serializing_if = "String::is_empty")]
    divergence: String,
    #[serde(skip_serializing_if = "String::is_empty")]
    lies: String,
    #[serde(skip_serializing_if = "String::is_empty")]
    console: String,
}

/// Another node, as this one sees it.
#[derive(Serialize)]
struct PeerFacts {
    node_id: u64,
    name: String,
    organisation: String,
    address: String,
    role: String,
    voter: bool,
    matched: u64,
    connected: bool,
    clock_offset_us: i64,
    clock_error_us: u64,
}

/// The disk of the data directory.
#[derive(Serialize)]
struct DiskFacts {
    path: String,
    free_bytes: u64,
    total_bytes: u64,
    accepts: String,
}

/// A certificate or a revocation list on which the node depends.
#[derive(Serialize)]
struct CertificateFacts {
    kind: String,
    name: String,
    not_before: u64,
    not_before_utc: Option<String>,
    not_after: u64,
    not_after_utc: Option<String>,
}

/// What needs attention at the node.
#[derive(Serialize)]
struct AttentionFacts {
    check: String,
    severity: String,
    message: String,
    next: String,
}

fn counts(counts: impl IntoIterator<Item = (u32, u64)>) -> BTreeMap<String, u64> {
    counts.into_iter().map(|(code, count)| (code_text(code), count)).collect()
}

impl From<v1::StatusResponse> for StatusFacts {
    fn from(status: v1::StatusResponse) -> Self {
        Self {
            disk: DiskFacts {
                path: status.data_directory,
                free_bytes: status.disk_free_bytes,
                total_bytes: status.disk_total_bytes,
                accepts: status.disk_accepts,
            },
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
            block_time_utc: utc(status.block_time),
            state_digest: hex::encode(status.state_digest),
            committed: status.committed,
            catching_up_to: Some(status.catching_up_to).filter(|height| *height > 0),
            certified: status.certified,
            first_height: status.first_height,
            snapshot_height: status.snapshot_height,
            last_index: status.last_index,
            clock: status.clock,
            clock_utc: utc(status.clock),
            wall_clock: status.wall_clock,
            wall_clock_utc: utc(status.wall_clock),
            uptime_ms: status.uptime_ms,
            chaincodes: status.chaincodes,
            refused: counts(status.refused),
            executed: counts(status.executed),
            peers: status.peers.into_iter().map(PeerFacts::from).collect(),
            subscribers: status.subscribers,
            payload_bytes_max: status.payload_bytes_max,
            resident_bytes: status.resident_bytes,
            in_flight: status.in_flight,
            in_flight_max: status.in_flight_max,
            waiting_control: status.waiting_control,
            waiting_data: status.waiting_data,
            voters: status.voters,
            voters_reachable: status.voters_connected,
            certificates: status.certificates.into_iter().map(CertificateFacts::from).collect(),
            attention: status.attention.into_iter().map(AttentionFacts::from).collect(),
            divergence: status.divergence,
            lies: status.lies,
            console: status.console,
        }
    }
}

impl From<v1::PeerStatus> for PeerFacts {
    fn from(peer: v1::PeerStatus) -> Self {
        Self {
            node_id: peer.node_id,
            name: peer.name,
            organisation: peer.organisation,
            address: peer.address,
            role: peer.role,
            voter: peer.voter,
            matched: peer.matched,
            connected: peer.connected,
            clock_offset_us: peer.clock_offset_us,
            clock_error_us: peer.clock_error_us,
        }
    }
}

impl From<v1::CertificateStatus> for CertificateFacts {
    fn from(certificate: v1::CertificateStatus) -> Self {
        Self {
            kind: certificate.kind,
            name: certificate.name,
            not_before: certificate.not_before,
            not_before_utc: utc(certificate.not_before),
            not_after: certificate.not_after,
            not_after_utc: utc(certificate.not_after),
        }
    }
}

impl From<v1::Attention> for AttentionFacts {
    fn from(item: v1::Attention) -> Self {
        Self { check: item.check, severity: item.severity, message: item.message, next: item.next }
    }
}

/// A node of the network by its own report, which this node has not checked.
#[derive(Serialize)]
pub(in crate::clients::http) struct NodeFacts {
    id: u64,
    name: String,
    organisation: String,
    reachable: bool,
    #[serde(skip_serializing_if = "String::is_empty")]
    reason: String,
    status: Option<StatusFacts>,
}

impl From<v1::NodeStatus> for NodeFacts {
    fn from(node: v1::NodeStatus) -> Self {
        Self {
            id: node.node_id,
            name: node.name,
            organisation: node.organisation,
            reachable: node.status.is_some(),
            reason: node.unreachable,
            status: node.status.map(StatusFacts::from),
        }
    }
}
