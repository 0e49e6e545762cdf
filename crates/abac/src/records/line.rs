//! Lines: who waits for a service, in order of arrival, and when a service is to be looked at again.
//!
//! A place in line is one key. The contender's certificate is another one, needed only when its turn comes: so a long line is
//! quick to read. Two more keys find it by its contender's certificate, and find a service by the time at
//! which it is looked at again. They are written and removed together, and only here.

use super::principal::Principal;
use super::store;
use bytes::Bytes;
use ledger::Context;
use ledger_rejection::Rejection;
use serde::{Deserialize, Serialize};

/// A contender in line.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Waiting {
    /// `Org1/Salma`.
    pub(crate) contender: String,
    /// The order of arrival.
    pub(crate) ticket: u64,
    pub(crate) priority: i64,
    /// Block time, microseconds.
    pub(crate) since: u64,
    /// When it drops out (block time, microseconds).
    pub(crate) until: u64,
    /// The lease that it asked for, milliseconds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) lease_ms: Option<u64>,
}

/// Everybody in line, in order of arrival.
pub(crate) fn all(ctx: &Context<'_>, service: &str) -> Result<Vec<Waiting>, Rejection> {
    let pairs = ctx.range(&store::line_prefix(service), usize::MAX);
    let mut line: Vec<Waiting> = pairs.iter().map(|(key, value)| store::parse(key, value)).collect::<Result<_, _>>()?;
    line.sort_by_key(|waiting| waiting.ticket);
    Ok(line)
}

/// Does anybody wait?
pub(crate) fn is_empty(ctx: &Context<'_>, service: &str) -> bool {
    ctx.range(&store::line_prefix(service), 1).is_empty()
}

/// The place of one contender.
pub(crate) fn of(ctx: &Context<'_>, service: &str, contender: &str) -> Result<Option<Waiting>, Rejection> {
    store::read(ctx, &store::line_key(service, contender))
}

/// The certificate with which a contender asked.
pub(crate) fn principal(ctx: &Context<'_>, service: &str, contender: &str) -> Result<Option<Principal>, Rejection> {
    store::read(ctx, &store::contender_key(service, contender))
}

/// Puts a contender in line, or in its place anew.
pub(crate) fn put(
    ctx: &mut Context<'_>,
    service: &str,
    waiting: &Waiting,
    principal: &Principal,
) -> Result<(), Rejection> {
    remove(ctx, service, &waiting.contender)?;
    store::write(ctx, &store::line_key(service, &waiting.contender), waiting)?;
    store::write(ctx, &store::contender_key(service, &waiting.contender), principal)?;
    ctx.put(&certificate_key(service, principal), Bytes::new());
    Ok(())
}

/// Takes a contender out of the line.
pub(crate) fn remove(ctx: &mut Context<'_>, service: &str, contender: &str) -> Result<(), Rejection> {
    if let Some(principal) = principal(ctx, service, contender)? {
        ctx.delete(&certificate_key(service, &principal));
        ctx.delete(&store::contender_key(service, contender));
        ctx.delete(&store::line_key(service, contender));
    }
    Ok(())
}

/// The services and the names under which a certificate waits.
pub(crate) fn of_certificate(ctx: &Context<'_>, issuer: &[u8; 32], serial: &[u8]) -> Vec<(String, String)> {
    let prefix = store::waiting_prefix(issuer, serial);
    let keys = ctx.range(&prefix, usize::MAX);
    let parsed = keys.iter().filter_map(|(key, _)| store::parse_certificate_key(key, &prefix));
    parsed.map(|(service, contender)| (service.to_owned(), contender.to_owned())).collect()
}

fn certificate_key(service: &str, principal: &Principal) -> Vec<u8> {
    let serial = hex::decode(&principal.serial).unwrap_or_default();
    let mut key = store::waiting_prefix(&principal.issuer.0, &serial);
    key.extend_from_slice(format!("{service}\0{}", principal.id()).as_bytes());
    key
}

/// The service is looked at again at this block time (microseconds) at the latest.
pub(crate) fn look_by(ctx: &mut Context<'_>, service: &str, time: u64) -> Result<(), Rejection> {
    let known: Option<u64> = store::read(ctx, &store::look_key(service))?;
    if known.is_some_and(|known| known <= time) {
        return Ok(());
    }
    looked_at(ctx, service)?;
    store::write(ctx, &store::look_key(service), &time)?;
    ctx.put(&store::looks_key(time, service), Bytes::new());
    Ok(())
}

/// Forgets when the service was to be looked at.
pub(crate) fn looked_at(ctx: &mut Context<'_>, service: &str) -> Result<(), Rejection> {
    if let Some(time) = store::read(ctx, &store::look_key(service))? {
        ctx.delete(&store::looks_key(time, service));
        ctx.delete(&store::look_key(service));
    }
    Ok(())
}

/// The services that are to be looked at next, with the times: at most so many.
pub(crate) fn next_looks(ctx: &Context<'_>, most: usize) -> Vec<(u64, String)> {
    let keys = ctx.range(store::LOOKS, most);
    let parsed = keys.iter().filter_map(|(key, _)| store::parse_looks_key(key));
    parsed.map(|(time, service)| (time, service.to_owned())).collect()
}
