//! Readers of confidential services, and the content keys that publishers have shared with them.
//!
//! A content key is good while its service has the readers for which it was wrapped. That is not looked up reader by reader with
//! each message. All that may change them changes a number of the service, its owner's policies or the robot's description. A
//! key remembers these three.
//!
//! The loss of the right to read ends a key at once. A reader that comes, or goes of its own accord, ends it after a grace only. Else
//! any reader could keep a publisher from all others by coming and going all the time. A revocation ends that grace, whoever is
//! revoked: it may be the one that has just gone.

use super::principal::Principal;
use super::robot::Robot;
use super::store;
use bytes::Bytes;
use ledger::Context;
use ledger_base::hash::Hash;
use ledger_base::rejection::Rejection;
use ledger_contract::{KeyPlace, READERS_MAX, ReaderTold, Reason};
use serde::{Deserialize, Serialize};

/// A key is good for so long after a reader has come, or gone of its own accord (microseconds): a new one is under way meanwhile.
pub(crate) const GRACE_US: u64 = 2_000_000;
/// Most publishers of a service whose newest keys are listed.
const PUBLISHERS_MAX: usize = 256;

/// A reader that has entered: key `reader/…`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Entered {
    pub(crate) principal: Principal,
    /// Its reading key, in hexadecimal digits.
    pub(crate) key: String,
}

/// The newest content key of a publisher: key `shared/…`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct SharedKey {
    /// The height of its block: its name in envelopes.
    pub(crate) key: u64,
    /// For which readers.
    pub(crate) made_for: MadeFor,
    /// How many had come, and gone of their own accord, until then.
    pub(crate) moves: u64,
    /// When it must be replaced at the latest (block time, microseconds).
    pub(crate) until: u64,
}

/// How often the readers of a service have changed: key `readers/…`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Changes {
    /// By the loss of the right to read.
    pub(crate) losses: u64,
    /// By coming, and by going of one's own accord.
    pub(crate) moves: u64,
    /// When that was last (block time, microseconds).
    pub(crate) moved_at: u64,
}

/// The state of all that takes the right to read a service away.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct MadeFor {
    /// How often a reader has lost it.
    pub(crate) losses: u64,
    /// The policies of its owner.
    pub(crate) policies: Hash,
    /// The description of its robot.
    pub(crate) robot: Hash,
}

/// How often the readers of a service have changed.
pub(crate) fn changes(ctx: &Context<'_>, service: &str) -> Result<Changes, Rejection> {
    Ok(store::read(ctx, &store::readers_key(service))?.unwrap_or_default())
}

/// A reader has lost the right to read: content keys of before are not good any more.
fn lost(ctx: &mut Context<'_>, service: &str) -> Result<(), Rejection> {
    let before = changes(ctx, service)?;
    let losses = before.losses.saturating_add(1);
    store::write(ctx, &store::readers_key(service), &Changes { losses, ..before })
}

/// A reader has come, or gone of its own accord: content keys of before are good for a grace.
fn moved(ctx: &mut Context<'_>, service: &str) -> Result<(), Rejection> {
    let before = changes(ctx, service)?;
    let (moves, moved_at) = (before.moves.saturating_add(1), ctx.block_time());
    store::write(ctx, &store::readers_key(service), &Changes { moves, moved_at, ..before })
}

/// Somebody was revoked, or an organisation left, in this block.
pub(crate) fn note_revocation(ctx: &mut Context<'_>) -> Result<(), Rejection> {
    store::write(ctx, store::REVOKED, &ctx.height())
}

/// Was somebody revoked since the block of that height, or in it?
pub(crate) fn revoked_since(ctx: &Context<'_>, height: u64) -> Result<bool, Rejection> {
    Ok(store::read::<u64>(ctx, store::REVOKED)?.is_some_and(|newest| newest >= height))
}

/// A place of a subscriber has ended. Its holder may let it end, and take it again, as often as it likes. An end that others
/// decided is a loss.
pub(crate) fn place_ended(ctx: &mut Context<'_>, service: &str, reason: Reason) -> Result<(), Rejection> {
    let is_taken = matches!(reason, Reason::Overridden | Reason::Policy | Reason::Revoked | Reason::Taken);
    match ctx.get(&store::readers_key(service)) {
        None => Ok(()),
        Some(_) if is_taken => lost(ctx, service),
        Some(_) => moved(ctx, service),
    }
}

/// All readers of a service, in order of their names.
pub(crate) fn all(ctx: &Context<'_>, service: &str) -> Result<Vec<Entered>, Rejection> {
    let pairs = ctx.range(&store::reader_key(service, ""), READERS_MAX);
    pairs.iter().map(|(key, value)| store::parse(key, value)).collect()
}

/// One reader of a service.
pub(crate) fn find(ctx: &Context<'_>, service: &str, id: &str) -> Result<Option<Entered>, Rejection> {
    store::read(ctx, &store::reader_key(service, id))
}

/// Enters a reader, in the place of what it was before.
pub(crate) fn enter(ctx: &mut Context<'_>, service: &str, entered: &Entered) -> Result<ReaderTold, Rejection> {
    let id = entered.principal.id();
    if let Some(before) = find(ctx, service, &id)? {
        remove(ctx, service, &before);
    }
    store::write(ctx, &store::reader_key(service, &id), entered)?;
    ctx.put(&with_certificate(&entered.principal, service), Bytes::from(id.clone()));
    moved(ctx, service)?;
    tell(ctx, service, id, "entered")
}

/// A reader leaves of its own accord.
pub(crate) fn leave(ctx: &mut Context<'_>, service: &str, entered: &Entered) -> Result<ReaderTold, Rejection> {
    remove(ctx, service, entered);
    moved(ctx, service)?;
    tell(ctx, service, entered.principal.id(), "left")
}

/// A reader is taken out.
pub(crate) fn take_out(ctx: &mut Context<'_>, service: &str, entered: &Entered) -> Result<ReaderTold, Rejection> {
    remove(ctx, service, entered);
    lost(ctx, service)?;
    tell(ctx, service, entered.principal.id(), "left")
}

fn remove(ctx: &mut Context<'_>, service: &str, entered: &Entered) {
    ctx.delete(&store::reader_key(service, &entered.principal.id()));
    ctx.delete(&with_certificate(&entered.principal, service));
}

fn with_certificate(principal: &Principal, service: &str) -> Vec<u8> {
    let serial = hex::decode(&principal.serial).unwrap_or_default();
    [store::reading_prefix(&principal.issuer.0, &serial), service.as_bytes().to_vec()].concat()
}

fn tell(ctx: &mut Context<'_>, service: &str, reader: String, change: &str) -> Result<ReaderTold, Rejection> {
    let told = ReaderTold { service: service.to_owned(), reader, change: change.to_owned() };
    ctx.emit("reader", service, store::json(&told)?);
    Ok(told)
}

/// A certificate was revoked: with it nobody reads any more.
pub(crate) fn revoked(ctx: &mut Context<'_>, issuer: &[u8; 32], serial: &[u8]) -> Result<(), Rejection> {
    let prefix = store::reading_prefix(issuer, serial);
    for (key, id) in ctx.range(&prefix, usize::MAX) {
        let service = key.strip_prefix(&prefix[..]).and_then(|name| std::str::from_utf8(name).ok());
        if let (Some(service), Ok(id)) = (service, std::str::from_utf8(&id))
            && let Some(entered) = find(ctx, service, id)?
        {
            take_out(ctx, service, &entered)?;
        } else {
            ctx.delete(&key);
        }
    }
    Ok(())
}

/// Members of an organisation that left read nothing any more.
pub(crate) fn members_left(ctx: &mut Context<'_>, service: &str, organisation: &str) -> Result<(), Rejection> {
    for entered in all(ctx, service)? {
        if entered.principal.organisation == organisation {
            take_out(ctx, service, &entered)?;
        }
    }
    Ok(())
}

/// Forgets the readers of services that `before` offers and `after` does not. Their number of changes stays, so that no old
/// content key is good again.
pub(crate) fn forget(ctx: &mut Context<'_>, before: &Robot, after: Option<&Robot>) -> Result<(), Rejection> {
    for service in &before.services {
        let stays = after.is_some_and(|after| after.services.iter().any(|kept| kept.topic == service.topic));
        let id = before.service_id(service);
        let readers = if stays { Vec::new() } else { all(ctx, &id)? };
        for entered in &readers {
            take_out(ctx, &id, entered)?;
        }
    }
    Ok(())
}

/// The newest content key of a publisher.
pub(crate) fn shared(ctx: &Context<'_>, service: &str, publisher: &str) -> Result<Option<SharedKey>, Rejection> {
    store::read(ctx, &store::shared_key(service, publisher))
}

/// Puts a content key in the place of the publisher's last one.
pub(crate) fn share(
    ctx: &mut Context<'_>,
    service: &str,
    publisher: &str,
    shared: &SharedKey,
) -> Result<(), Rejection> {
    store::write(ctx, &store::shared_key(service, publisher), shared)
}

/// The newest content keys of a service's publishers.
pub(crate) fn keys(ctx: &Context<'_>, service: &str) -> Result<Vec<KeyPlace>, Rejection> {
    let prefix = store::shared_key(service, "");
    let place = |(key, value): &(Bytes, Bytes)| {
        let SharedKey { key: height, .. } = store::parse(key, value)?;
        let publisher = key.strip_prefix(&prefix[..]).unwrap_or_default();
        Ok(KeyPlace { publisher: String::from_utf8_lossy(publisher).into_owned(), key: height })
    };
    ctx.range(&prefix, PUBLISHERS_MAX).iter().map(place).collect()
}
