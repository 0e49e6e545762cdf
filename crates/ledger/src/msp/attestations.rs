//! Attestations of nodes about their computation: height, block hash, state digest, and the content of their snapshots.
//!
//! The ledger keeps what each node said last and judges nothing. Nodes compare it with what they computed themselves;
//! auditors and newcomers ask for nodes of two organisations that say the same.

use super::caller::{node, object};
use super::nodes::{self, NodeRecord};
use super::store::{self, ATTESTATIONS, attestation_key, json};
use crate::chaincode::Context;
use crate::members::NODES_MAX;
use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// Most attestations: one of each node.
pub(super) const ATTESTATIONS_MAX: usize = NODES_MAX;

/// Argument of `attest`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Attest {
    /// A height that the node has executed.
    pub height: u64,
    /// Hash of the block there.
    pub hash: Hash,
    /// State digest after it.
    pub digest: Hash,
    /// SHA-256 of the manifest of its snapshot at that height, if it made one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub content: Option<Hash>,
}

/// One statement of a node, and where it stands.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Attestation {
    /// The attestation.
    #[serde(flatten)]
    pub attest: Attest,
    /// Block time at which it said so, microseconds.
    pub time: u64,
    /// The transaction that it signed.
    pub transaction: Hash,
}

/// The last attestation of a node.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct AttestationRecord {
    /// Its organisation.
    pub organisation: String,
    /// Its name.
    pub node: String,
    /// Its number.
    pub id: u64,
    /// The greatest height it attested.
    pub latest: Attestation,
    /// The newest snapshot it attested.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub snapshot: Option<Attestation>,
    /// The newest before it that a node of another organisation attests, too. So there is always one that two organisations
    /// attest, once there was.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shared: Option<Attestation>,
}

impl AttestationRecord {
    /// The snapshots that the node attests.
    pub fn snapshots(&self) -> impl Iterator<Item = &Attestation> {
        self.snapshot.iter().chain(&self.shared)
    }
}

/// Height and content of the newest snapshot that nodes of so many organisations attest.
pub fn shared_snapshot(records: &[AttestationRecord], organisations: usize) -> Option<(u64, Hash)> {
    let mut attested: BTreeMap<(u64, Hash), BTreeSet<&str>> = BTreeMap::new();
    for record in records {
        for Attestation { attest, .. } in record.snapshots() {
            let content = attest.content.unwrap_or(Hash::ZERO);
            attested.entry((attest.height, content)).or_default().insert(&record.organisation);
        }
    }
    attested.into_iter().rfind(|(_, by)| by.len() >= organisations).map(|(snapshot, _)| snapshot)
}

/// `attestations`
pub(super) fn list(ctx: &Context<'_>) -> Result<Bytes, Rejection> {
    json(&store::list::<AttestationRecord>(ctx, ATTESTATIONS.as_bytes(), ATTESTATIONS_MAX)?)
}

/// `attest {height, hash, digest, content?}`
pub(super) fn attest(ctx: &mut Context<'_>, argument: &Bytes) -> Result<Bytes, Rejection> {
    let wanted = "{\"height\": NUMBER, \"hash\": HASH, \"digest\": HASH, \"content\": HASH if a snapshot was made}";
    let attest: Attest = object("attest", argument, wanted)?;
    let caller = node(ctx, "sign the state of the network")?;
    let Some(record) = nodes::present(ctx, &caller.organisation, &caller.name)? else {
        return Err(Rejection::new(Code::NotAMember, format!("{} is not a node of this network", caller.id()))
            .wanted("a node that is a member"));
    };
    // Before ordering, this is the committed height, which may be attested; in the block, it is the block itself,
    // whose hash nobody could know when they signed.
    if attest.height > ctx.height() {
        return Err(Rejection::new(Code::BadArgument, "only executed blocks can be signed")
            .found(format!("height {}", attest.height))
            .wanted(format!("at most {}", ctx.height())));
    }
    let key = attestation_key(&caller.organisation, &caller.name);
    let before: Option<AttestationRecord> = store::read(ctx, &key)?;
    let latest_height = before.as_ref().map_or(0, |before| before.latest.attest.height);
    let snapshot_height = before.as_ref().and_then(|before| before.snapshot.as_ref()).map_or(0, |s| s.attest.height);
    // A snapshot takes a while to make: by then the node may have attested greater heights.
    let floor = if attest.content.is_some() { snapshot_height } else { latest_height };
    if attest.height < floor {
        return Err(Rejection::new(Code::BadArgument, "the node has already signed a greater height")
            .found(format!("height {}", attest.height))
            .wanted(format!("at least {floor}")));
    }
    let statement = Attestation { time: ctx.block_time(), transaction: ctx.transaction(), attest };
    let snapshot = statement.attest.content.is_some().then(|| statement.clone());
    let (latest, snapshot, shared) = match before {
        Some(before) => {
            let shared = still_shared(ctx, &before, snapshot.as_ref())?;
            let latest = if statement.attest.height < latest_height { before.latest } else { statement.clone() };
            (latest, snapshot.or(before.snapshot), shared)
        }
        None => (statement.clone(), snapshot, None),
    };
    let record = AttestationRecord {
        organisation: caller.organisation.clone(),
        node: caller.name.clone(),
        id: record.id,
        latest,
        snapshot,
        shared,
    };
    store::write(ctx, &key, &record)?;
    ctx.emit("attested", &caller.id(), json(&statement)?);
    Ok(Bytes::new())
}

/// The snapshot that a node keeps on attesting beside a newer one: its last one, if another organisation attests that.
fn still_shared(
    ctx: &Context<'_>,
    before: &AttestationRecord,
    newer: Option<&Attestation>,
) -> Result<Option<Attestation>, Rejection> {
    let (Some(last), Some(newer)) = (&before.snapshot, newer) else { return Ok(before.shared.clone()) };
    if last.attest.height == newer.attest.height {
        return Ok(before.shared.clone());
    }
    let same =
        |said: &Attestation| (said.attest.height, said.attest.content) == (last.attest.height, last.attest.content);
    let records = store::list::<AttestationRecord>(ctx, ATTESTATIONS.as_bytes(), ATTESTATIONS_MAX)?;
    let others = records.iter().filter(|record| record.organisation != before.organisation);
    let is_shared = others.flat_map(AttestationRecord::snapshots).any(same);
    Ok(if is_shared { Some(last.clone()) } else { before.shared.clone() })
}

/// Forgets what a node said that was removed.
pub(super) fn forget(ctx: &mut Context<'_>, node: &NodeRecord) {
    ctx.delete(attestation_key(&node.organisation, &node.name).as_bytes());
}
