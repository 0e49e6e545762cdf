//! Quotas: how much of what the network stores one organisation may fill.
//!
//! They begin with the same defaults for everybody. Another one is set by a proposal. A smaller quota
//! removes nothing: nothing more is added.

use super::SET_QUOTA;
use super::caller::{admin, object};
use super::organisations;
use super::own_call::own_call;
use super::proposals::decide;
use super::store::{self, json, quota_key};
use crate::chaincode::Context;
use bytes::Bytes;
use ledger_base::rejection::{Code, Rejection};
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
}

/// The quotas of an organisation that has none of its own.
pub const QUOTAS: Quotas = Quotas { robots: 128, policies: 64, identities: 10_000 };
/// The largest that can be set.
pub const QUOTAS_MAX: Quotas = Quotas { robots: 1024, policies: 64, identities: 100_000 };

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
}

/// The quotas of an organisation.
pub(super) fn of(ctx: &Context<'_>, organisation: &str) -> Result<Quotas, Rejection> {
    let set: SetQuota = store::read(ctx, &quota_key(organisation))?.unwrap_or_default();
    Ok(Quotas {
        robots: set.robots.unwrap_or(QUOTAS.robots),
        policies: set.policies.unwrap_or(QUOTAS.policies),
        identities: set.identities.unwrap_or(QUOTAS.identities),
    })
}

/// `quotas ORGANISATION`
pub(super) fn show(ctx: &Context<'_>, organisation: &Bytes) -> Result<Bytes, Rejection> {
    let name = String::from_utf8_lossy(organisation);
    check_organisation(ctx, &name)?;
    json(&of(ctx, &name)?)
}

/// `set_quota {organisation, robots?, policies?, identities?}`
pub(super) fn set(ctx: &mut Context<'_>, argument: &Bytes) -> Result<Bytes, Rejection> {
    let wanted = "{\"organisation\": NAME, \"robots\": NUMBER, \"policies\": NUMBER, \"identities\": NUMBER}, of which numbers \
                  may be left out";
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
    Rejection::new(Code::QuotaReached, format!("{organisation} has as many {kind} as its quota allows"))
        .found(format!("{quota} {kind}"))
        .wanted(format!("at most {quota}: the quota of {kind} of {organisation}"))
        .next(format!("{free}; or propose a larger quota: ledgerctl network propose msp set_quota '{{\"organisation\":\"{organisation}\",\"{kind}\":NUMBER}}'"))
}

fn check(ctx: &Context<'_>, set: &SetQuota) -> Result<(), Rejection> {
    check_organisation(ctx, &set.organisation)?;
    let kinds = [
        ("robots", set.robots, QUOTAS_MAX.robots),
        ("policies", set.policies, QUOTAS_MAX.policies),
        ("identities", set.identities, QUOTAS_MAX.identities),
    ];
    for (kind, quota, most) in kinds {
        if let Some(quota) = quota.filter(|quota| *quota > most) {
            return Err(Rejection::new(Code::BadArgument, format!("a quota of {kind} is too large"))
                .found(quota.to_string())
                .wanted(format!("at most {most}")));
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
