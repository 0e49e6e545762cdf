//! The status of a node.

use super::{code_text, utc};
use crate::v1;
use ledger_light::{Survives, Voters};
use serde::Serialize;
use std::collections::BTreeMap;

/// Severity of a problem that keeps a node from its work: it is not ready.
pub const CRITICAL: &str = "critical";
/// Severity of a problem that keeps members from something, although the node is ready.
pub const ERROR: &str = "error";
/// Severity of a problem that may become one of the others.
pub const WARNING: &str = "warning";

/// A node. Counts are keyed by code.
#[derive(Debug, Serialize)]
pub struct StatusFacts {
    /// Its release.
    pub version: String,
    /// Name of the network: SHA-256 of its genesis.
    pub network: String,
    /// Label of the network.
    pub network_label: String,
    /// Its number in the ordering.
    pub node_id: u64,
    /// Its name in its organisation.
    pub node_name: String,
    /// Its organisation.
    pub organisation: String,
    /// `leader`, `follower`, `candidate`, `learner`, `joining`, `leaving` or `removed`.
    pub role: String,
    /// The leader; 0 if none is known.
    pub leader_id: u64,
    /// Term of the ordering.
    pub term: u64,
    /// Height of the last executed block.
    pub height: u64,
    /// Hash of that block.
    pub block_hash: String,
    /// Its block time.
    pub block_time: u64,
    block_time_utc: Option<String>,
    /// Digest of the world state after it.
    pub state_digest: String,
    /// Height up to which the ordering log is known to be committed.
    pub committed: u64,
    /// Height up to which it fetches blocks or a snapshot; none if it follows as usual.
    pub catching_up_to: Option<u64>,
    /// Newest height with a quorum certificate; 0 if there is none.
    pub certified: u64,
    /// Oldest block that it keeps.
    pub first_height: u64,
    /// Height of its newest snapshot; 0 if there is none.
    pub snapshot_height: u64,
    /// Last index of its ordering log.
    pub last_index: u64,
    /// The node's clock, which is never behind block time.
    pub clock: u64,
    clock_utc: Option<String>,
    /// The clock of its machine.
    pub wall_clock: u64,
    wall_clock_utc: Option<String>,
    /// Time since it started.
    pub uptime_ms: u64,
    /// Names of the installed chaincodes.
    pub chaincodes: Vec<String>,
    /// Transactions that it rejected before ordering.
    pub refused: BTreeMap<String, u64>,
    /// Transactions that it executed since it started, by the code of the verdict.
    pub executed: BTreeMap<String, u64>,
    /// The other nodes.
    pub peers: Vec<PeerFacts>,
    /// Open subscriptions.
    pub subscribers: u64,
    /// Size of the largest payload.
    pub payload_bytes_max: u64,
    /// Resident memory.
    pub resident_bytes: u64,
    /// Transactions without a verdict yet.
    pub in_flight: u64,
    /// Limit of these.
    pub in_flight_max: u64,
    /// Urgent transactions that wait to be ordered.
    pub waiting_control: u64,
    /// Messages that wait to be ordered.
    pub waiting_data: u64,
    /// Number of voters.
    pub voters: u32,
    /// Voters that it has a connection to, itself counted.
    pub voters_reachable: u32,
    /// How many signatures make a certificate, and the faults that the voters survive.
    pub certificate_rule: CertificateRuleFacts,
    /// The disk of its data directory.
    pub disk: DiskFacts,
    /// Certificates and revocation lists on which it depends.
    pub certificates: Vec<CertificateFacts>,
    /// Problems of the node. None where a client lists them in another form.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub attention: Option<Vec<AttentionFacts>>,
    /// Report about nodes whose state digest differs; empty if all agree.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub divergence: String,
    /// Members that have signed two different blocks of one height, or two votes in one term; empty if there are none.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub lies: String,
    /// Members that have signed two different results of one block; empty if there are none.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub faults: String,
    /// Signed stops without a verdict, as far as it knows.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub open_stops: Vec<OpenStopFacts>,
    /// Address of its console; empty if it has none.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub console: String,
}

/// How many signatures make a certificate, and the faults that the voters survive.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct CertificateRuleFacts {
    /// Signatures that are needed.
    pub signatures_needed: u32,
    /// Height of the block that made certificates strict; none if they are not.
    pub strict_since: Option<u64>,
    /// So many voters may crash at once.
    pub survives_crashes: u32,
    /// One organisation may lie with all its voters.
    pub survives_lie: bool,
    /// One organisation may be silent with all its voters.
    pub survives_silence: bool,
}

/// A signed stop of which robots were notified, and that has no verdict yet.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct OpenStopFacts {
    /// Id of its transaction.
    pub transaction: String,
    /// The robot, or `*`.
    pub robot: String,
    /// Its signer.
    pub by: String,
    /// Until when it may be executed.
    pub not_after: u64,
}

impl From<v1::OpenStop> for OpenStopFacts {
    fn from(stop: v1::OpenStop) -> Self {
        Self { transaction: hex::encode(&stop.id), robot: stop.robot, by: stop.by, not_after: stop.not_after }
    }
}

/// Another node, as this one sees it.
#[derive(Debug, Serialize)]
pub struct PeerFacts {
    /// Its number in the ordering.
    pub node_id: u64,
    /// Its name in its organisation.
    pub name: String,
    /// Its organisation.
    pub organisation: String,
    /// `HOST:PORT`.
    pub address: String,
    /// `voter`, `learner`, `joining` or `leaving`.
    pub role: String,
    /// Does it vote?
    pub voter: bool,
    /// Last log index known to be on its disk; only the leader knows.
    pub matched: u64,
    /// Is there a connection?
    pub connected: bool,
    /// The clock of its machine minus that of this node's; 0 if nothing is known.
    pub clock_offset_us: i64,
    /// How far off that may be.
    pub clock_error_us: u64,
}

/// The disk of the data directory.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct DiskFacts {
    /// The data directory.
    pub path: String,
    /// Free space.
    pub free_bytes: u64,
    /// Size of the disk; 0 if it is unknown.
    pub total_bytes: u64,
    /// Calls that this space allows: `all`, `ends` or `nothing`.
    pub accepts: String,
}

/// A certificate or a revocation list on which the node depends.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
pub struct CertificateFacts {
    /// `node`, `ca` or `list`; `own` for that of a client.
    pub kind: String,
    /// `ORGANISATION/NAME`, the subject of a CA, or the issuer of a list.
    pub name: String,
    /// First moment at which it is valid.
    pub not_before: u64,
    not_before_utc: Option<String>,
    /// Last moment at which it is valid.
    pub not_after: u64,
    not_after_utc: Option<String>,
}

/// A problem of the node (docs/operations.md).
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct AttentionFacts {
    /// The check that found it, such as `disk`.
    pub check: String,
    /// [`CRITICAL`], [`ERROR`] or [`WARNING`].
    pub severity: String,
    /// The finding, in one line.
    pub message: String,
    /// The next step.
    pub next: String,
}

fn counts(counts: impl IntoIterator<Item = (u32, u64)>) -> BTreeMap<String, u64> {
    counts.into_iter().map(|(code, count)| (code_text(code), count)).collect()
}

impl From<v1::StatusResponse> for StatusFacts {
    fn from(status: v1::StatusResponse) -> Self {
        Self {
            disk: DiskFacts::from(&status),
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
            certificate_rule: status.certificate_rule.unwrap_or_default().into(),
            certificates: status.certificates.into_iter().map(CertificateFacts::from).collect(),
            attention: Some(status.attention.into_iter().map(AttentionFacts::from).collect()),
            divergence: status.divergence,
            lies: status.lies,
            faults: status.faults,
            open_stops: status.open_stops.into_iter().map(OpenStopFacts::from).collect(),
            console: status.console,
        }
    }
}

impl From<v1::CertificateRule> for CertificateRuleFacts {
    fn from(rule: v1::CertificateRule) -> Self {
        Self {
            signatures_needed: rule.needed,
            strict_since: rule.strict_since,
            survives_crashes: rule.survives_crashes,
            survives_lie: rule.survives_lie,
            survives_silence: rule.survives_silence,
        }
    }
}

impl CertificateRuleFacts {
    /// Of these voters.
    pub fn of(voters: &Voters) -> Self {
        let number = |count: usize| u32::try_from(count).unwrap_or(u32::MAX);
        let Survives { crashes, lie, silence } = voters.survives();
        Self {
            signatures_needed: number(voters.quorum()),
            strict_since: voters.rule.strict_since,
            survives_crashes: number(crashes),
            survives_lie: lie,
            survives_silence: silence,
        }
    }

    /// The rule in one line: `3 signatures, strict since block 12`.
    pub fn rule(&self) -> String {
        let signatures = if self.signatures_needed == 1 { "signature" } else { "signatures" };
        let rule = match self.strict_since {
            Some(since) => format!("strict since block {since}"),
            None => "not strict: of two organisations, if voters have two".to_owned(),
        };
        format!("{} {signatures}, {rule}", self.signatures_needed)
    }

    /// The faults in one line: `1 crash, lies of one organisation, silence of one organisation`.
    pub fn survives(&self) -> String {
        let crashes = usize::try_from(self.survives_crashes).unwrap_or(usize::MAX);
        Survives { crashes, lie: self.survives_lie, silence: self.survives_silence }.to_string()
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

impl From<&v1::StatusResponse> for DiskFacts {
    fn from(status: &v1::StatusResponse) -> Self {
        Self {
            path: status.data_directory.clone(),
            free_bytes: status.disk_free_bytes,
            total_bytes: status.disk_total_bytes,
            accepts: status.disk_accepts.clone(),
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
