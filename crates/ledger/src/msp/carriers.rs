//! Which nodes carry the key of which organisation's CA.
//!
//! A node says so itself and proves it with a signature of that key. A client that wants to enrol at a node without the
//! CA is sent to one that carries it.

use super::caller::{admin, node, object};
use super::identities::{self, KnownIdentity};
use super::nodes::{self, NodeRecord};
use super::organisations;
use super::store::{self, CARRIERS, carrier_key, json};
use crate::chaincode::Context;
use crate::members::NODES_MAX;
use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::certificate::Certificate;
use ledger_identity::key::{PublicKey, SigningKey};
use ledger_identity::{Identity, NAME_BYTES_MAX, Role};
use ledger_storage::state::StateRead;
use serde::{Deserialize, Serialize};

/// Most records that are read: every node might carry the CAs of several organisations.
const CARRIERS_MAX: usize = NODES_MAX * 16;
/// Most names that one call may bring along.
pub const ADOPTED_MAX: usize = 64;
/// Longest name of an admin with its organisation.
const COPIED_BY_BYTES_MAX: usize = 2 * NAME_BYTES_MAX + 1;
/// Separates these signatures from everything else that is signed.
const SIGNATURE_DOMAIN: &[u8] = b"ledgerd carries the CA v1\0";

/// A node that carries the key of an organisation's CA.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct CarrierRecord {
    /// The organisation of the CA.
    pub organisation: String,
    /// Organisation of the node; another one only where the organisation runs no node.
    pub node_organisation: String,
    /// Name of the node.
    pub node: String,
    /// Since when, block time in microseconds.
    pub since: u64,
    /// The newest copy of the key that an admin has taken there.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub copied: Option<Copied>,
}

/// A copy of a CA's key, for the safe.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Copied {
    /// The admin who took it, `ORGANISATION/NAME`.
    pub by: String,
    /// When the ledger heard of it, block time in microseconds.
    pub at: u64,
}

impl CarrierRecord {
    /// The node as people see it: `Org1/node1`.
    pub fn full_name(&self) -> String {
        format!("{}/{}", self.node_organisation, self.node)
    }
}

/// Argument of `carry_ca`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CarryCa {
    /// The organisation of the CA.
    pub organisation: String,
    /// Signature of the CA's key over network, organisation and node, in hexadecimal (see [`CarryCa::prove`]).
    pub proof: String,
    /// Facts that the node knows from its own disk, and the ledger does not yet.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub identities: Vec<KnownIdentity>,
    /// The admin, `ORGANISATION/NAME`, who takes a copy of the key now.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub copied_by: Option<String>,
}

impl CarryCa {
    /// The statement of the node `ORGANISATION/NAME` that it holds this key of that organisation's CA.
    pub fn prove(network: &Hash, organisation: &str, node: &str, key: &SigningKey) -> Self {
        let proof = hex::encode(key.sign(&signed_bytes(network, organisation, node)));
        Self { organisation: organisation.to_owned(), proof, identities: Vec::new(), copied_by: None }
    }
}

fn signed_bytes(network: &Hash, organisation: &str, node: &str) -> Vec<u8> {
    let mut bytes = SIGNATURE_DOMAIN.to_vec();
    for part in [&network.0[..], organisation.as_bytes(), node.as_bytes()] {
        bytes.extend_from_slice(&(part.len() as u64).to_be_bytes());
        bytes.extend_from_slice(part);
    }
    bytes
}

/// Argument of `uncarry_ca`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct UncarryCa {
    /// The organisation of the CA.
    pub organisation: String,
    /// The node as `ORGANISATION/NAME`; the caller if left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub node: Option<String>,
}

/// The nodes that carry a CA, in order of organisations.
///
/// # Errors
/// A fault of the store, a record that cannot be read.
pub fn carriers(state: &dyn StateRead) -> Result<Vec<CarrierRecord>, Rejection> {
    store::list_state(state, CARRIERS, CARRIERS_MAX)
}

fn all(ctx: &Context<'_>) -> Result<Vec<CarrierRecord>, Rejection> {
    store::list(ctx, CARRIERS.as_bytes(), CARRIERS_MAX)
}

/// `carriers`
pub(super) fn list(ctx: &Context<'_>) -> Result<Bytes, Rejection> {
    json(&all(ctx)?)
}

/// `carry_ca {organisation, proof, identities?, copied_by?}`: a node of the network, for itself.
pub(super) fn carry(ctx: &mut Context<'_>, argument: &Bytes) -> Result<Bytes, Rejection> {
    let carry: CarryCa = object("carry_ca", argument, "{\"organisation\", \"proof\", \"identities\"}")?;
    let caller = node(ctx, "hold a CA key")?;
    if nodes::present(ctx, &caller.organisation, &caller.name)?.is_none() {
        return Err(Rejection::new(Code::NotAMember, format!("{} is not a node of this network", caller.id()))
            .wanted("a node that is a member"));
    }
    if carry.identities.len() > ADOPTED_MAX {
        return Err(Rejection::new(Code::TooLarge, "too many names in one call")
            .found(carry.identities.len().to_string())
            .wanted(format!("at most {ADOPTED_MAX}")));
    }
    check_proof(ctx, &carry, caller)?;
    let key = carrier_key(&carry.organisation, &caller.organisation, &caller.name);
    if ctx.get(key.as_bytes()).is_none() {
        if all(ctx)?.len() >= CARRIERS_MAX {
            return Err(Rejection::new(Code::LimitExceeded, "too many nodes hold CA keys")
                .wanted(format!("at most {CARRIERS_MAX}")));
        }
        let record = CarrierRecord {
            organisation: carry.organisation.clone(),
            node_organisation: caller.organisation.clone(),
            node: caller.name.clone(),
            since: ctx.block_time(),
            copied: None,
        };
        store::write(ctx, &key, &record)?;
        ctx.emit("ca_carried", &record.full_name(), json(&record)?);
    }
    if let Some(by) = carry.copied_by {
        note_copy(ctx, &key, by)?;
    }
    for known in carry.identities {
        identities::adopt(ctx, caller, &carry.organisation, known)?;
    }
    Ok(Bytes::new())
}

/// An admin takes a copy of the key from this node.
fn note_copy(ctx: &mut Context<'_>, key: &str, by: String) -> Result<(), Rejection> {
    if by.len() > COPIED_BY_BYTES_MAX {
        return Err(Rejection::new(Code::TooLarge, "the name of the backup's owner is too long")
            .found(format!("{} bytes", by.len()))
            .wanted(format!("at most {COPIED_BY_BYTES_MAX}")));
    }
    let at = ctx.block_time();
    if let Some(record) = store::read::<CarrierRecord>(ctx, key)? {
        let record = CarrierRecord { copied: Some(Copied { by, at }), ..record };
        store::write(ctx, key, &record)?;
        ctx.emit("ca_copied", &record.full_name(), json(&record)?);
    }
    Ok(())
}

/// The signature must be by the key of one of the organisation's authorities.
fn check_proof(ctx: &Context<'_>, carry: &CarryCa, caller: &Identity) -> Result<(), Rejection> {
    let organisation = organisations::find(ctx, &carry.organisation)?.ok_or_else(|| {
        Rejection::new(Code::NotFound, "the network has no such organisation")
            .found(format!("{:?}", carry.organisation.chars().take(80).collect::<String>()))
    })?;
    let signature = hex::decode(&carry.proof).unwrap_or_default();
    let message = signed_bytes(&ctx.network(), &carry.organisation, &caller.id());
    let signed_by = |der: &Bytes| {
        let key = Certificate::parse(der).ok().and_then(|ca| PublicKey::from_spki(&ca.public_key_info).ok());
        key.is_some_and(|key| key.verify(&message, &signature).is_ok())
    };
    if organisation.roots.iter().chain(&organisation.intermediates).any(signed_by) {
        return Ok(());
    }
    Err(Rejection::new(Code::BadSignature, format!("{} has not proved that it holds the CA key", caller.id()))
        .found(format!("a signature with another key than that of {}", carry.organisation))
        .wanted(format!("a signature with the CA key of {}", carry.organisation)))
}

/// `uncarry_ca {organisation, node?}`: a node for itself, or an admin of the organisation for a node that has lost it.
pub(super) fn uncarry(ctx: &mut Context<'_>, argument: &Bytes) -> Result<Bytes, Rejection> {
    let UncarryCa { organisation, node: meant } =
        object("uncarry_ca", argument, "{\"organisation\": NAME, \"node\": \"ORGANISATION/NAME\"}")?;
    let caller = super::caller::submitter(ctx)?;
    let meant = meant.unwrap_or_else(|| caller.id());
    let itself = caller.role == Role::Node && caller.id() == meant;
    if !itself && admin(ctx, "record that a node no longer holds the CA key")?.organisation != organisation {
        return Err(Rejection::new(
            Code::NotAdmin,
            format!("{} may not decide which nodes hold the CA key of {organisation}", caller.id()),
        )
        .found(format!("role {} of {}", caller.role, caller.organisation))
        .wanted(format!("an admin of {organisation}, or the node itself")));
    }
    let Some(record) = all(ctx)?.into_iter().find(|r| r.organisation == organisation && r.full_name() == meant) else {
        let names = names(&all(ctx)?, &organisation);
        return Err(Rejection::new(Code::NotFound, format!("{meant} does not hold the CA key of {organisation}"))
            .wanted(if names.is_empty() { "no node does".to_owned() } else { format!("one of {names}") }));
    };
    drop_record(ctx, &record)?;
    Ok(Bytes::new())
}

/// The nodes that carry an organisation's CA, for people.
fn names(carriers: &[CarrierRecord], organisation: &str) -> String {
    let own = carriers.iter().filter(|carrier| carrier.organisation == organisation);
    own.map(CarrierRecord::full_name).collect::<Vec<_>>().join(", ")
}

fn drop_record(ctx: &mut Context<'_>, record: &CarrierRecord) -> Result<(), Rejection> {
    ctx.delete(carrier_key(&record.organisation, &record.node_organisation, &record.node).as_bytes());
    ctx.emit("ca_dropped", &record.full_name(), json(record)?);
    Ok(())
}

/// A node that was removed carries nothing any more.
pub(super) fn forget(ctx: &mut Context<'_>, node: &NodeRecord) -> Result<(), Rejection> {
    for record in all(ctx)? {
        if record.node_organisation == node.organisation && record.node == node.name {
            drop_record(ctx, &record)?;
        }
    }
    Ok(())
}
