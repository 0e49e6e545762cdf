//! Lines: who waits for a service, in order of arrival, and when a service is to be looked at again.
//!
//! A place in line is one key. A contender has one place for itself, and one for each of its tasks. The contender's certificate is another one, needed only when its turn comes: so a long line is
//! quick to read. Two more keys find it by its contender's certificate, and find a service by the time at
//! which it is looked at again. They are written and removed together, and only here.

use super::principal::Principal;
use super::store;
use bytes::Bytes;
use ledger::Context;
use ledger_base::rejection::Rejection;
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
    /// The task that waits there.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) task: Option<u64>,
}

impl Waiting {
    /// The name of its place: that of the contender, or of the contender and the task.
    pub(crate) fn place(&self) -> String {
        self.task.map_or_else(|| self.contender.clone(), |task| place_of(&self.contender, task))
    }
}

/// The name of a task's place in line.
pub(crate) fn place_of(contender: &str, task: u64) -> String {
    format!("{contender}\0{task:016x}")
}

/// The task that waits at a place of this name.
pub(crate) fn task_at(place: &str) -> Option<u64> {
    let (_, task) = place.split_once('\0')?;
    u64::from_str_radix(task, 16).ok()
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

/// The place of that name.
pub(crate) fn of(ctx: &Context<'_>, service: &str, place: &str) -> Result<Option<Waiting>, Rejection> {
    store::read(ctx, &store::line_key(service, place))
}

/// The certificate with which a contender asked for a place.
pub(crate) fn principal(ctx: &Context<'_>, service: &str, place: &str) -> Result<Option<Principal>, Rejection> {
    store::read(ctx, &store::contender_key(service, place))
}

/// Puts a contender in line, or in its place anew.
pub(crate) fn put(
    ctx: &mut Context<'_>,
    service: &str,
    waiting: &Waiting,
    principal: &Principal,
) -> Result<(), Rejection> {
    let place = waiting.place();
    remove(ctx, service, &place)?;
    store::write(ctx, &store::line_key(service, &place), waiting)?;
    store::write(ctx, &store::contender_key(service, &place), principal)?;
    ctx.put(&certificate_key(service, &place, principal), Bytes::new());
    Ok(())
}

/// Takes a place out of the line.
pub(crate) fn remove(ctx: &mut Context<'_>, service: &str, place: &str) -> Result<(), Rejection> {
    if let Some(principal) = principal(ctx, service, place)? {
        ctx.delete(&certificate_key(service, place, &principal));
        ctx.delete(&store::contender_key(service, place));
        ctx.delete(&store::line_key(service, place));
    }
    Ok(())
}

/// The services and the places at which a certificate waits.
pub(crate) fn of_certificate(ctx: &Context<'_>, issuer: &[u8; 32], serial: &[u8]) -> Vec<(String, String)> {
    let prefix = store::waiting_prefix(issuer, serial);
    let keys = ctx.range(&prefix, usize::MAX);
    let parsed = keys.iter().filter_map(|(key, _)| store::parse_certificate_key(key, &prefix));
    parsed.map(|(service, place)| (service.to_owned(), place.to_owned())).collect()
}

fn certificate_key(service: &str, place: &str, principal: &Principal) -> Vec<u8> {
    let serial = hex::decode(&principal.serial).unwrap_or_default();
    let mut key = store::waiting_prefix(&principal.issuer.0, &serial);
    key.extend_from_slice(format!("{service}\0{place}").as_bytes());
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
