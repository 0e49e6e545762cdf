//! Grants: leases with an epoch that fences off every earlier holder.
//!
//! A grant is *live* while its expiry lies after block time and nothing has ended it. A grant that is no longer live
//! counts nowhere, even while it still lies in the state waiting to be swept.
//!
//! Two more keys find a grant: by the time at which it is due, and by its holder's certificate. They are written, moved
//! and removed with it, and only here.

use super::principal::Principal;
use super::store;
use bytes::Bytes;
use ledger::Context;
use ledger_contract::{Grant, Reason};
use ledger_mutation::lease_clock;
use ledger_rejection::Rejection;
use serde::{Deserialize, Serialize};

/// Most holders of one service.
pub(crate) const HOLDERS_MAX: usize = 256;

/// A grant as the state holds it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Holding {
    pub(crate) grant: Grant,
    pub(crate) principal: Principal,
    /// Set when the grant has ended and its event is still to come.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) ending: Option<Reason>,
}

impl Holding {
    /// Does it count at this block time?
    pub(crate) fn is_live(&self, now: u64) -> bool {
        self.ending.is_none() && self.grant.expires > lease_clock(now)
    }

    /// Why it ended, if it is not live.
    pub(crate) fn reason(&self) -> Reason {
        self.ending.unwrap_or(Reason::Expired)
    }

    /// When the lease ends if it is renewed `now`; never after the holder's certificate.
    pub(crate) fn extended(&self, now: u64) -> u64 {
        now.saturating_add(self.grant.lease_ms.saturating_mul(1000)).min(self.principal.not_after)
    }

    /// Extends the lease from `now`.
    pub(crate) fn extend(&mut self, now: u64) {
        self.grant.expires = self.extended(now);
    }
}

/// Every grant of a service in the state, live or not, oldest first.
pub(crate) fn stored(ctx: &Context<'_>, service: &str) -> Result<Vec<Holding>, Rejection> {
    let pairs = ctx.range(&store::grants_prefix(service), HOLDERS_MAX);
    let mut holdings: Vec<Holding> =
        pairs.iter().map(|(key, value)| store::parse(key, value)).collect::<Result<_, _>>()?;
    holdings.sort_by_key(|holding| holding.grant.epoch);
    Ok(holdings)
}

/// The live grants of a service, oldest first.
pub(crate) fn live(ctx: &Context<'_>, service: &str) -> Result<Vec<Holding>, Rejection> {
    let now = ctx.block_time();
    Ok(stored(ctx, service)?.into_iter().filter(|holding| holding.is_live(now)).collect())
}

/// The live grant of one holder.
pub(crate) fn held_by(ctx: &Context<'_>, service: &str, holder: &str) -> Result<Option<Holding>, Rejection> {
    let holding: Option<Holding> = store::read(ctx, &store::grant_key(service, holder))?;
    Ok(holding.filter(|holding| holding.is_live(ctx.block_time())))
}

/// The newest epoch that was ever given for a service; 0 before the first.
pub(crate) fn newest_epoch(ctx: &Context<'_>, service: &str) -> Result<u64, Rejection> {
    Ok(store::read(ctx, &store::epoch_key(service))?.unwrap_or(0))
}

/// Writes a grant that was not there, and its index keys.
pub(crate) fn put(ctx: &mut Context<'_>, holding: &Holding) -> Result<(), Rejection> {
    let (service, holder) = (&holding.grant.service, &holding.grant.holder);
    store::write(ctx, &store::grant_key(service, holder), holding)?;
    ctx.put(&due_key(holding), Bytes::new());
    ctx.put(&certificate_key(holding), Bytes::new());
    Ok(())
}

/// Replaces a grant by itself with another expiry or state.
pub(crate) fn replace(ctx: &mut Context<'_>, before: &Holding, after: &Holding) -> Result<(), Rejection> {
    ctx.delete(&due_key(before));
    put(ctx, after)
}

/// Removes a grant and its index keys.
pub(crate) fn remove(ctx: &mut Context<'_>, holding: &Holding) {
    ctx.delete(&store::grant_key(&holding.grant.service, &holding.grant.holder));
    ctx.delete(&due_key(holding));
    ctx.delete(&certificate_key(holding));
}

fn due_key(holding: &Holding) -> Vec<u8> {
    store::due_key(holding.grant.expires, &holding.grant.service, &holding.grant.holder)
}

fn certificate_key(holding: &Holding) -> Vec<u8> {
    let serial = hex::decode(&holding.principal.serial).unwrap_or_default();
    let mut key = store::certificate_prefix(&holding.principal.issuer.0, &serial);
    key.extend_from_slice(format!("{}\0{}", holding.grant.service, holding.grant.holder).as_bytes());
    key
}
