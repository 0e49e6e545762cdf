//! Quotas: how much of what the network stores one organisation may fill, and how fast.
//!
//! They begin with the same defaults for everybody. Another one is set by a proposal. A smaller quota
//! removes nothing: nothing more is added. Nodes enforce what is counted for each second where transactions enter.

use super::SET_QUOTA;
use super::caller::{admin, object};
use super::organisations;
use super::own_call::own_call;
use super::proposals::decide;
use super::store::{self, json, quota_key};
use crate::chaincode::Context;
use bytes::Bytes;
use ledger_base::rejection::{Code, Rejection};
use ledger_storage::state::StateRead;
use serde::{Deserialize, Serialize};

/// The most that an organisation may have of each kind.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Quotas {
    /// Robots.
    pub robots: u64,
    /// Policies.
    pub policies: u64,
    /// Registered names.
    pub identities: u64,
    /// Bytes of transactions a second, of all its identities together.
    pub bytes_per_s: u64,
    /// Messages a second, of all its identities together. A call that publishes none counts as one.
    pub messages_per_s: u64,
    /// Bytes of transactions a second, of each of its identities.
    pub identity_bytes_per_s: u64,
    /// Messages a second, of each of its identities.
    pub identity_messages_per_s: u64,
    /// Bytes a second that all publishers together publish on each of its services; its owner can set less.
    pub service_bytes_per_s: u64,
    /// Messages a second on each of its services; its owner can set less.
    pub service_messages_per_s: u64,
}

/// The quotas of an organisation that has none of its own. One identity alone does not use up a service, and one service not
/// an organisation.
pub const QUOTAS: Quotas = Quotas {
    robots: 128,
    policies: 64,
    identities: 10_000,
    bytes_per_s: 32 << 20,
    messages_per_s: 40_000,
    identity_bytes_per_s: 8 << 20,
    identity_messages_per_s: 10_000,
    service_bytes_per_s: 16 << 20,
    service_messages_per_s: 20_000,
};
/// The largest that can be set.
pub const QUOTAS_MAX: Quotas = Quotas {
    robots: 1024,
    policies: 64,
    identities: 100_000,
    bytes_per_s: 1 << 30,
    messages_per_s: 1_000_000,
    identity_bytes_per_s: 1 << 30,
    identity_messages_per_s: 1_000_000,
    service_bytes_per_s: 1 << 30,
    service_messages_per_s: 1_000_000,
};

/// Argument of `set_quota`, and what stands on the ledger; a kind that is left out has its default.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SetQuota {
    /// Name of the organisation.
    pub organisation: String,
    /// Most robots.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub robots: Option<u64>,
    /// Most policies.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub policies: Option<u64>,
    /// Most registered names.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub identities: Option<u64>,
    /// As [`Quotas::bytes_per_s`]; so for the others.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bytes_per_s: Option<u64>,
    /// Most messages a second of all its identities.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub messages_per_s: Option<u64>,
    /// Most bytes a second of each identity.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub identity_bytes_per_s: Option<u64>,
    /// Most messages a second of each identity.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub identity_messages_per_s: Option<u64>,
    /// Most bytes a second on each of its services.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub service_bytes_per_s: Option<u64>,
    /// Most messages a second on each of its services.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub service_messages_per_s: Option<u64>,
}

/// The quotas of an organisation.
pub(super) fn of(ctx: &Context<'_>, organisation: &str) -> Result<Quotas, Rejection> {
    Ok(store::read::<SetQuota>(ctx, &quota_key(organisation))?.unwrap_or_default().quotas())
}

/// The quotas of an organisation, read from a world state.
///
/// # Errors
/// A fault of the store; [`Code::Corrupt`] if the record cannot be read.
pub fn quotas_of(state: &dyn StateRead, organisation: &str) -> Result<Quotas, Rejection> {
    Ok(store::read_state::<SetQuota>(state, &quota_key(organisation))?.unwrap_or_default().quotas())
}

impl SetQuota {
    /// With the default of each kind that is left out.
    fn quotas(&self) -> Quotas {
        Quotas {
            robots: self.robots.unwrap_or(QUOTAS.robots),
            policies: self.policies.unwrap_or(QUOTAS.policies),
            identities: self.identities.unwrap_or(QUOTAS.identities),
            bytes_per_s: self.bytes_per_s.unwrap_or(QUOTAS.bytes_per_s),
            messages_per_s: self.messages_per_s.unwrap_or(QUOTAS.messages_per_s),
            identity_bytes_per_s: self.identity_bytes_per_s.unwrap_or(QUOTAS.identity_bytes_per_s),
            identity_messages_per_s: self.identity_messages_per_s.unwrap_or(QUOTAS.identity_messages_per_s),
            service_bytes_per_s: self.service_bytes_per_s.unwrap_or(QUOTAS.service_bytes_per_s),
            service_messages_per_s: self.service_messages_per_s.unwrap_or(QUOTAS.service_messages_per_s),
        }
    }

    /// Each kind that it sets, with its name and the most that can be set.
    fn kinds(&self) -> [(&'static str, Option<u64>, u64); 9] {
        let most = QUOTAS_MAX;
        [
            ("robots", self.robots, most.robots),
            ("policies", self.policies, most.policies),
            ("identities", self.identities, most.identities),
            ("bytes_per_s", self.bytes_per_s, most.bytes_per_s),
            ("messages_per_s", self.messages_per_s, most.messages_per_s),
            ("identity_bytes_per_s", self.identity_bytes_per_s, most.identity_bytes_per_s),
            ("identity_messages_per_s", self.identity_messages_per_s, most.identity_messages_per_s),
            ("service_bytes_per_s", self.service_bytes_per_s, most.service_bytes_per_s),
            ("service_messages_per_s", self.service_messages_per_s, most.service_messages_per_s),
        ]
    }
}

/// `quotas ORGANISATION`
pub(super) fn show(ctx: &Context<'_>, organisation: &Bytes) -> Result<Bytes, Rejection> {
    let name = String::from_utf8_lossy(organisation);
    check_organisation(ctx, &name)?;
    json(&of(ctx, &name)?)
}

/// `set_quota {organisation, KIND: NUMBER, …}`
pub(super) fn set(ctx: &mut Context<'_>, argument: &Bytes) -> Result<Bytes, Rejection> {
    let wanted = "{\"organisation\": NAME, KIND: NUMBER, …} with kinds robots, policies, identities, bytes_per_s, messages_per_s, \
                  identity_bytes_per_s, identity_messages_per_s, service_bytes_per_s, service_messages_per_s";
    let set: SetQuota = object(SET_QUOTA, argument, wanted)?;
    if ctx.approved_by().is_none() {
        let caller = admin(ctx, "change a quota")?;
        check(ctx, &set)?;
        return json(&decide(ctx, caller, own_call(SET_QUOTA, &set)?)?);
    }
    check(ctx, &set)?;
    store::write(ctx, &quota_key(&set.organisation), &set)?;
    let event = json(&set)?;
    ctx.emit("quota_changed", &set.organisation, event.clone());
    Ok(event)
}

/// The quotas of an organisation that leaves.
pub(super) fn forget_organisation(ctx: &mut Context<'_>, name: &str) {
    let key = quota_key(name);
    if ctx.get(key.as_bytes()).is_some() {
        ctx.delete(key.as_bytes());
    }
}

/// The refusal of what would be beyond a quota. `kind` is the field of [`Quotas`]; `free` says what makes room.
pub fn quota_reached(organisation: &str, kind: &str, quota: u64, free: &str) -> Rejection {
    Rejection::new(Code::QuotaReached, format!("{organisation} has reached its quota of {kind}"))
        .found(format!("{quota} {kind}"))
        .wanted(format!("at most {quota}: the quota of {kind} of {organisation}"))
        .next(format!("{free}; or propose a larger quota: ledgerctl network propose msp set_quota '{{\"organisation\":\"{organisation}\",\"{kind}\":NUMBER}}'"))
}

fn check(ctx: &Context<'_>, set: &SetQuota) -> Result<(), Rejection> {
    check_organisation(ctx, &set.organisation)?;
    for (kind, quota, most) in set.kinds() {
        // With a rate of 0 no proposal to raise it could be sent.
        let least = u64::from(kind.ends_with("_per_s"));
        if let Some(quota) = quota.filter(|quota| !(least..=most).contains(quota)) {
            return Err(Rejection::new(Code::BadArgument, format!("a quota of {kind} is out of range"))
                .found(quota.to_string())
                .wanted(format!("{least} to {most}")));
        }
    }
    Ok(())
}

fn check_organisation(ctx: &Context<'_>, name: &str) -> Result<(), Rejection> {
    if organisations::find(ctx, name)?.is_some() {
        return Ok(());
    }
    let name: String = name.chars().take(128).collect();
    Err(Rejection::new(Code::NotFound, "the network has no such organisation")
        .found(format!("{name:?}"))
        .wanted(format!("one of {}", organisations::names(ctx)?.join(", "))))
}
