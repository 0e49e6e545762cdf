//! The content keys of confidential services: who may have one, and which one is good.

use crate::lifecycle::subscribing;
use crate::policy::decider::Decider;
use crate::policy::texts;
use crate::records::principal::Principal;
use crate::records::reader;
use crate::records::reader::{GRACE_US, MadeFor};
use crate::records::robot::Robot;
use crate::records::target::Target;
use ledger::Context;
use ledger_base::moment::rfc3339;
use ledger_base::mutation::{Mutation, active};
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::Role;

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
            .found("a message in clear text")
            .wanted("an envelope of format.md, under a content key that was shared")
            .next("publish with a client that encrypts: ledgerctl publish, or a bridge of this version")
    })?;
    let stale = |found: String| {
        Rejection::new(Code::ReadersChanged, format!("the readers of {id} have changed since the content key was made"))
            .found(found)
            .wanted("the newest content key of this publisher, shared with the current readers")
    };
    let Some(shared) = reader::shared(ctx, id, publisher)?.filter(|shared| shared.key == key) else {
        return Err(stale(format!("key {key}, which is not the newest one of {publisher}")));
    };
    if shared.until <= ctx.block_time() {
        return Err(stale(format!("key {key}, which expired at {}", rfc3339(shared.until))));
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
            "key {key}, from before a change of readers {} s ago or more",
            GRACE_US / 1_000_000
        )));
    }
    if reader::revoked_since(ctx, shared.key)? {
        return Err(stale(format!("key {key}, from before a change of readers and a revocation")));
    }
    Ok(())
}

/// The state of all that takes the right to read away, as it is now.
pub(crate) fn made_for(ctx: &Context<'_>, target: &Target) -> Result<MadeFor, Rejection> {
    let robot = &target.robot;
    let policies = texts::version(ctx, &robot.organisation)?.hash;
    Ok(MadeFor { losses: reader::changes(ctx, &target.id)?.losses, policies, robot: robot.version })
}

fn not_confidential(id: &str) -> Rejection {
    Rejection::new(Code::BadArgument, format!("{id} is not confidential, and this message is encrypted"))
        .found("an envelope")
        .wanted("CDR with its encapsulation header")
        .next("publish it unencrypted")
}

/// Until when this reader may read (block time, microseconds), as far as that is known; none if it may not now.
pub(crate) fn until(
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
pub(crate) fn may_read(
    ctx: &Context<'_>,
    decider: &Decider,
    principal: &Principal,
    target: &Target,
) -> Result<Option<u64>, Rejection> {
    if governs(principal, &target.robot) {
        return Ok(None);
    }
    subscribing::may_be_sent(ctx, decider, principal, target)
}

/// Does the reader stand for the owner: an admin, a node, or a robot of its organisation?
pub(crate) fn governs(principal: &Principal, robot: &Robot) -> bool {
    principal.organisation == robot.organisation && principal.role != Role::Member
}

pub(crate) fn is_hex(text: &str, bytes: usize) -> bool {
    text.len() == 2 * bytes && text.bytes().all(|b| b.is_ascii_digit() || (b'a'..=b'f').contains(&b))
}
