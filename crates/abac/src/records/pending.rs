//! Contenders that wait to be confirmed, with those who have confirmed them.
//!
//! One more key for each of these people finds the contender by their certificate: a revoked one neither contends nor
//! confirms. They are written and removed together, and only here.

use super::principal::Principal;
use super::store;
use bytes::Bytes;
use ledger::Context;
use ledger_base::rejection::Rejection;
use ledger_contract::AcquireOptions;
use serde::{Deserialize, Serialize};

/// A contender that waits to be confirmed.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Asking {
    pub(crate) principal: Principal,
    /// Until when (block time, microseconds).
    pub(crate) until: u64,
    /// Its wishes.
    pub(crate) options: AcquireOptions,
    /// Those who have confirmed it.
    pub(crate) confirmed: Vec<Principal>,
}

impl Asking {
    /// Those whose confirmation counts at this block time (microseconds).
    pub(crate) fn counted(&self, now: u64) -> impl Iterator<Item = &Principal> {
        self.confirmed.iter().filter(move |principal| principal.not_after > now)
    }
}

/// Everybody who waits to be confirmed for a service.
pub(crate) fn all(ctx: &Context<'_>, service: &str) -> Result<Vec<Asking>, Rejection> {
    let pairs = ctx.range(&store::pending_prefix(service), usize::MAX);
    pairs.iter().map(|(key, value)| store::parse(key, value)).collect()
}

/// Does nobody wait to be confirmed for a service?
pub(crate) fn is_empty(ctx: &Context<'_>, service: &str) -> bool {
    ctx.range(&store::pending_prefix(service), 1).is_empty()
}

/// One of them.
pub(crate) fn of(ctx: &Context<'_>, service: &str, contender: &str) -> Result<Option<Asking>, Rejection> {
    store::read(ctx, &store::pending_key(service, contender))
}

/// Writes one, in the place of what it was.
pub(crate) fn put(ctx: &mut Context<'_>, service: &str, asking: &Asking) -> Result<(), Rejection> {
    let contender = asking.principal.id();
    remove(ctx, service, &contender)?;
    store::write(ctx, &store::pending_key(service, &contender), asking)?;
    for key in certificate_keys(service, asking) {
        ctx.put(&key, Bytes::new());
    }
    Ok(())
}

/// Removes one, if it is there.
pub(crate) fn remove(ctx: &mut Context<'_>, service: &str, contender: &str) -> Result<(), Rejection> {
    if let Some(asking) = of(ctx, service, contender)? {
        ctx.delete(&store::pending_key(service, contender));
        for key in certificate_keys(service, &asking) {
            ctx.delete(&key);
        }
    }
    Ok(())
}

/// The services and contenders for which a certificate asks or has confirmed.
pub(crate) fn of_certificate(ctx: &Context<'_>, issuer: &[u8; 32], serial: &[u8]) -> Vec<(String, String)> {
    let prefix = store::asking_prefix(issuer, serial);
    let keys = ctx.range(&prefix, usize::MAX);
    let parsed = keys.iter().filter_map(|(key, _)| store::parse_certificate_key(key, &prefix));
    parsed.map(|(service, contender)| (service.to_owned(), contender.to_owned())).collect()
}

fn certificate_keys(service: &str, asking: &Asking) -> Vec<Vec<u8>> {
    let suffix = format!("{service}\0{}", asking.principal.id());
    let key = |principal: &Principal| {
        let serial = hex::decode(&principal.serial).unwrap_or_default();
        [store::asking_prefix(&principal.issuer.0, &serial).as_slice(), suffix.as_bytes()].concat()
    };
    [&asking.principal].into_iter().chain(&asking.confirmed).map(key).collect()
}
