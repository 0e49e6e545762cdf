//! Confidential services: `reader`, `readers`, `share`, and what `set` takes on them.
//!
//! The ledger never sees a content key. It sees that one was wrapped for exactly those who may read, among them the owner, and
//! takes no message under a key that was made for others. That a publisher has wrapped the key in which it encrypts, and not
//! noise, only a reader can see: see docs/security.md.

use super::{follow, publish};
use crate::arguments::{Arguments, shown};
use crate::policy::decider::Decider;
use crate::policy::texts;
use crate::records::principal::Principal;
use crate::records::reader::{self, Entered, GRACE_US, MadeFor, SharedKey};
use crate::records::robot::Robot;
use crate::records::service::{self, Target};
use crate::records::store;
use bytes::Bytes;
use ledger::Context;
use ledger_base::mutation::{Mutation, active};
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{Keyed, READERS_MAX, READING_KEY_BYTES, Reader, Readers, Share, WRAPPED_BYTES, Wrapped};
use ledger_identity::Role;

/// A content key is replaced after this long at the latest (microseconds): policies may speak of the time.
const KEY_LIFE_US: u64 = 3_600_000_000;
/// Longest JSON of a share, in bytes.
const SHARE_BYTES_MAX: usize = 64 * 1024;
/// The place of a key: the word that takes a reader out.
const NONE: &str = "none";

/// `reader SERVICE KEY|none [READER]`: enters the caller with its reading key, or takes a reader out: the caller itself, or any
/// by an admin of the owner.
pub(crate) fn reader(ctx: &mut Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("reader SERVICE KEY|none [READER]", args, 2, 3)?;
    let target = of_messages(service::resolve(ctx, args.text(0, "SERVICE")?)?)?;
    let caller = Principal::of(ctx.submitter()?);
    let key = args.text(1, "KEY")?;
    let who = if args.has(2) { args.text(2, "READER")?.to_owned() } else { caller.id() };
    if who != caller.id() && !(key == NONE && caller.governs(&target.robot)) {
        return Err(Rejection::new(
            Code::NotOwner,
            format!("{} may not change the reader {}", caller.id(), shown(&who)),
        )
        .found(format!("role {} of {}", caller.role, caller.organisation))
        .wanted(format!("the reader itself, or an admin of {} who takes it out", target.robot.organisation))
        .next("leave READER out to enter yourself"));
    }
    let before = reader::find(ctx, &target.id, &who)?;
    if key == NONE {
        let before = before.ok_or_else(|| {
            Rejection::new(Code::NotFound, format!("{} is no reader of {}", shown(&who), target.id))
                .found("no reader of that name")
                .wanted("one of the service's readers")
                .next(format!("ledgerctl readers {}", target.id))
        })?;
        let goes = if who == caller.id() { reader::leave } else { reader::take_out };
        return store::json(&goes(ctx, &target.id, &before)?);
    }
    if !is_hex(key, READING_KEY_BYTES) {
        let wanted = format!("{} lower-case hexadecimal digits, or none", 2 * READING_KEY_BYTES);
        return Err(args.bad(1, "KEY", shown(key), &wanted));
    }
    may_read(ctx, decider, &caller, &target)?;
    if before.is_none() {
        make_room(ctx, &target)?;
    }
    let entered = Entered { principal: caller, key: key.to_owned() };
    store::json(&reader::enter(ctx, &target.id, &entered)?)
}

/// `readers SERVICE`: who has entered, who of them may read now, and where the newest content keys are.
pub(crate) fn readers(ctx: &Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("readers SERVICE", args, 1, 1)?;
    let target = service::resolve(ctx, args.text(0, "SERVICE")?)?;
    let mut readers = Vec::new();
    for Entered { principal, key } in reader::all(ctx, &target.id)? {
        let may_read = until(ctx, decider, &principal, &target)?.is_some();
        let (reader, serial) = (principal.id(), principal.serial.clone());
        readers.push(Reader { reader, key, serial, may_read });
    }
    store::json(&Readers { keys: reader::keys(ctx, &target.id)?, service: target.id, readers })
}

/// `share SERVICE EPOCH SHARE_JSON`: the publisher's new content key, wrapped for everybody who may read now.
pub(crate) fn share(ctx: &mut Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("share SERVICE EPOCH SHARE_JSON", args, 3, 3)?;
    let target = service::resolve(ctx, args.text(0, "SERVICE")?)?;
    let (epoch, submitter) = (args.number(1, "EPOCH")?, ctx.submitter()?);
    if !target.service.sharing.is_confidential() {
        return Err(Rejection::new(Code::BadArgument, format!("{} is not confidential", target.id))
            .found("a service whose messages are not encrypted")
            .wanted("a service with confidential=true")
            .next(format!("publish without a content key, or: ledgerctl robot set {} confidential=true", target.id)));
    }
    let document = args.document(2, "SHARE_JSON", SHARE_BYTES_MAX)?;
    let wanted = r#"{"readers":[{"reader":"ORG/NAME","key":"HEX","wrapped":"HEX"}, ...]}"#;
    let share: Share =
        serde_json::from_str(document).map_err(|fault| args.bad(2, "SHARE_JSON", fault.to_string(), wanted))?;
    publish::may_publish(ctx, decider, submitter, &target, Some(epoch))?;
    let publisher = submitter.id();
    if reader::shared(ctx, &target.id, &publisher)?.is_some_and(|shared| shared.key >= ctx.height()) {
        return Err(Rejection::new(Code::LimitExceeded, format!("{publisher} has shared a key in this block already"))
            .found("a second content key of one publisher in one block")
            .wanted("one in a block: its height names it")
            .next("use the first one, or share again"));
    }
    let until = check_share(ctx, decider, &target, &share)?;
    let (key, made_for) = (ctx.height(), made_for(ctx, &target)?);
    let moves = reader::changes(ctx, &target.id)?.moves;
    reader::share(ctx, &target.id, &publisher, &SharedKey { key, made_for, moves, until })?;
    let keyed = store::json(&Keyed { key, until, readers: share.readers.len() as u64 })?;
    ctx.emit("keyed", &target.id, keyed.clone());
    Ok(keyed)
}

/// May this publisher send these payloads on the service? On a confidential one they are envelopes under its newest content key,
/// and that was made for those who read now.
///
/// # Errors
/// [`Code::BadArgument`] for a message that is not encrypted, [`Code::ReadersChanged`] for a key that is not good.
pub(crate) fn check_key(
    ctx: &Context<'_>,
    target: &Target,
    publisher: &str,
    envelope: Option<u64>,
) -> Result<(), Rejection> {
    let id = &target.id;
    if !target.service.sharing.is_confidential() {
        return if envelope.is_none() { Ok(()) } else { Err(not_confidential(id)) };
    }
    let key = envelope.ok_or_else(|| {
        Rejection::new(Code::BadArgument, format!("{id} is confidential, and this message is not encrypted"))
            .found("a message that everybody can read")
            .wanted("an envelope of format.md, under a content key that was shared")
            .next("publish with a client that encrypts: ledgerctl publish, or a bridge of this version")
    })?;
    let stale = |found: String| {
        Rejection::new(
            Code::ReadersChanged,
            format!("the readers of {id} are others than the content key was made for"),
        )
        .found(found)
        .wanted("the newest content key of this publisher, shared with those who read now")
        .next("share a new content key and send the message again; ledgerctl and bridges do so by themselves")
    };
    let Some(shared) = reader::shared(ctx, id, publisher)?.filter(|shared| shared.key == key) else {
        return Err(stale(format!("key {key}, which is not the newest one of {publisher}")));
    };
    if shared.until <= ctx.block_time() {
        return Err(stale(format!("key {key}, which was good until {} µs", shared.until)));
    }
    if shared.made_for != made_for(ctx, target)? && !active(Mutation::KeepAnOldContentKey) {
        return Err(stale(format!("key {key}, from before a change of readers, policies or the robot")));
    }
    let changes = reader::changes(ctx, id)?;
    if shared.moves == changes.moves {
        return Ok(());
    }
    if changes.moved_at.saturating_add(GRACE_US) <= ctx.block_time() {
        return Err(stale(format!(
            "key {key}, from before a reader came or went {} s ago or more",
            GRACE_US / 1_000_000
        )));
    }
    if reader::revoked_since(ctx, shared.key)? {
        return Err(stale(format!("key {key}, from before a reader came or went and somebody was revoked")));
    }
    Ok(())
}

/// The state of all that takes the right to read away, as it is now.
fn made_for(ctx: &Context<'_>, target: &Target) -> Result<MadeFor, Rejection> {
    let robot = &target.robot;
    let policies = texts::version(ctx, &robot.organisation)?.hash;
    Ok(MadeFor { losses: reader::changes(ctx, &target.id)?.losses, policies, robot: robot.version })
}

fn not_confidential(id: &str) -> Rejection {
    Rejection::new(Code::BadArgument, format!("{id} is not confidential, and this message is encrypted"))
        .found("an envelope")
        .wanted("CDR with its encapsulation header")
        .next("publish it as it is")
}

/// A share is for exactly those who may read now, with the keys that they have now. Answers until when it is good.
fn check_share(ctx: &Context<'_>, decider: &Decider, target: &Target, share: &Share) -> Result<u64, Rejection> {
    let (mut wanted, mut good) = (Vec::new(), ctx.block_time().saturating_add(KEY_LIFE_US));
    let mut is_owners = false;
    for Entered { principal, key } in reader::all(ctx, &target.id)? {
        if let Some(until) = until(ctx, decider, &principal, target)? {
            is_owners |= governs(&principal, &target.robot);
            good = good.min(until);
            wanted.push((principal.id(), key));
        }
    }
    let (id, owner) = (&target.id, &target.robot.organisation);
    if !is_owners {
        return Err(Rejection::new(
            Code::ReadersChanged,
            format!("{owner}, the owner of {id}, has no reading key there"),
        )
        .found("no reader that is an admin, a node or the robot of the owner")
        .wanted(format!("one of {owner} at least: the owner always reads"))
        .next(format!("as an admin of {owner}: ledgerctl readers {id} --enter")));
    }
    let given = share.readers.iter().map(|Wrapped { reader, key, .. }| (reader.as_str(), key.as_str()));
    let is_exact = given.eq(wanted.iter().map(|(reader, key)| (reader.as_str(), key.as_str())));
    if !is_exact && !active(Mutation::ShareWithAnybody) {
        let names = |names: Vec<&str>| if names.is_empty() { "nobody".to_owned() } else { names.join(", ") };
        let given: Vec<&str> = share.readers.iter().take(READERS_MAX).map(|one| one.reader.as_str()).collect();
        return Err(Rejection::new(
            Code::ReadersChanged,
            format!("the content key is not for those who read {id} now"),
        )
        .found(shown(&names(given)))
        .wanted(names(wanted.iter().map(|(reader, _)| reader.as_str()).collect()))
        .next("wrap it for each of them with the key that they have now, in this order"));
    }
    if let Some(bad) = share.readers.iter().find(|one| !is_hex(&one.wrapped, WRAPPED_BYTES)) {
        return Err(Rejection::new(Code::BadArgument, format!("the content key for {} is not wrapped", bad.reader))
            .found(format!("{} bytes of text", bad.wrapped.len()))
            .wanted(format!("{} lower-case hexadecimal digits", 2 * WRAPPED_BYTES)));
    }
    Ok(good)
}

/// Until when this reader may read (block time, microseconds), as far as that is known; none if it may not now.
fn until(
    ctx: &Context<'_>,
    decider: &Decider,
    principal: &Principal,
    target: &Target,
) -> Result<Option<u64>, Rejection> {
    if principal.not_after <= ctx.block_time() {
        return Ok(None);
    }
    match may_read(ctx, decider, principal, target) {
        Ok(closes) => Ok(Some(closes.unwrap_or(u64::MAX).min(principal.not_after))),
        Err(refused) if refused.code == Code::Corrupt => Err(refused),
        Err(_) => Ok(None),
    }
}

/// May they have the content keys of a service? The owner always; others as policies and places of subscribers say. Answers when
/// the window of the policies closes.
fn may_read(
    ctx: &Context<'_>,
    decider: &Decider,
    principal: &Principal,
    target: &Target,
) -> Result<Option<u64>, Rejection> {
    if governs(principal, &target.robot) {
        return Ok(None);
    }
    follow::may_be_sent(ctx, decider, principal, target)
}

/// Does the reader stand for the owner: an admin, a node, or a robot of its organisation?
fn governs(principal: &Principal, robot: &Robot) -> bool {
    principal.organisation == robot.organisation && principal.role != Role::Member
}

/// Refuses what has no messages to read.
fn of_messages(target: Target) -> Result<Target, Rejection> {
    if !target.is_for_readers() {
        return Ok(target);
    }
    let service = target.service_id();
    Err(Rejection::new(Code::UnknownService, format!("{} has no messages, it is the places of subscribers", target.id))
        .found("places for reading")
        .wanted(service)
        .next(format!("enter as a reader of {service}")))
}

/// Room for one more reader: those whose certificates have expired leave.
fn make_room(ctx: &mut Context<'_>, target: &Target) -> Result<(), Rejection> {
    let readers = reader::all(ctx, &target.id)?;
    if readers.len() < READERS_MAX {
        return Ok(());
    }
    let now = ctx.block_time();
    let expired: Vec<&Entered> = readers.iter().filter(|entered| entered.principal.not_after <= now).collect();
    if expired.is_empty() {
        return Err(Rejection::new(Code::LimitExceeded, format!("{} has no room for another reader", target.id))
            .found(format!("{} readers", readers.len()))
            .wanted(format!("at most {READERS_MAX}"))
            .next(format!("an admin of the owner takes one out: ledgerctl readers {} --remove READER", target.id)));
    }
    for entered in expired {
        reader::leave(ctx, &target.id, entered)?;
    }
    Ok(())
}

fn is_hex(text: &str, bytes: usize) -> bool {
    text.len() == 2 * bytes && text.bytes().all(|b| b.is_ascii_digit() || (b'a'..=b'f').contains(&b))
}
