//! `reader`: entering and leaving as a reader of a confidential service.

use crate::arguments::{Arguments, shown};
use crate::lifecycle::content_keys;
use crate::policy::decider::Decider;
use crate::records::principal::Principal;
use crate::records::reader::Entered;
use crate::records::target::Target;
use crate::records::{reader, store, target};
use bytes::Bytes;
use ledger::Context;
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{READERS_MAX, READING_KEY_BYTES};

/// The place of a key: the word that takes a reader out.
const NONE: &str = "none";

/// `reader SERVICE KEY|none [READER]`: enters the caller with its reading key, or takes a reader out: the caller itself, or any
/// by an admin of the owner.
pub(crate) fn reader(ctx: &mut Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("reader SERVICE KEY|none [READER]", args, 2, 3)?;
    let target = of_messages(target::resolve(ctx, args.text(0, "SERVICE")?)?)?;
    let caller = Principal::of(ctx.submitter()?);
    let key = args.text(1, "KEY")?;
    let who = if args.has(2) { args.text(2, "READER")?.to_owned() } else { caller.id() };
    if who != caller.id() && !(key == NONE && caller.governs(&target.robot)) {
        return Err(Rejection::new(
            Code::NotOwner,
            format!("{} may not change the reader {}", caller.id(), shown(&who)),
        )
        .found(format!("role {} of {}", caller.role, caller.organisation))
        .wanted(format!("the reader itself, or an admin of {} to remove it", target.robot.organisation))
        .next("omit READER to register yourself"));
    }
    let before = reader::find(ctx, &target.id, &who)?;
    if key == NONE {
        let before = before.ok_or_else(|| {
            Rejection::new(Code::NotFound, format!("{} is not a reader of {}", shown(&who), target.id))
                .found("no reader of that name")
                .wanted("one of the service's readers")
                .next(format!("ledgerctl readers {}", target.id))
        })?;
        let goes = if who == caller.id() { reader::leave } else { reader::take_out };
        return store::json(&goes(ctx, &target.id, &before)?);
    }
    if !content_keys::is_hex(key, READING_KEY_BYTES) {
        let wanted = format!("{} lower-case hexadecimal digits, or none", 2 * READING_KEY_BYTES);
        return Err(args.bad(1, "KEY", shown(key), &wanted));
    }
    content_keys::may_read(ctx, decider, &caller, &target)?;
    if before.is_none() {
        make_room(ctx, &target)?;
    }
    let entered = Entered { principal: caller, key: key.to_owned() };
    store::json(&reader::enter(ctx, &target.id, &entered)?)
}

/// Refuses what has no messages to read.
fn of_messages(target: Target) -> Result<Target, Rejection> {
    if !target.is_for_readers() {
        return Ok(target);
    }
    let service = target.service_id();
    Err(Rejection::new(
        Code::UnknownService,
        format!(
            "{} has no messages: it stands for the subscriber slots of a \
                                                      service",
            target.id
        ),
    )
    .found("subscriber slots")
    .wanted(service)
    .next(format!("register as a reader of {service}")))
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
        return Err(Rejection::new(Code::LimitExceeded, format!("{} has reached its limit of readers", target.id))
            .found(format!("{} readers", readers.len()))
            .wanted(format!("at most {READERS_MAX}"))
            .next(format!("an admin of the owner can remove one: ledgerctl readers {} --remove READER", target.id)));
    }
    for entered in expired {
        reader::leave(ctx, &target.id, entered)?;
    }
    Ok(())
}
