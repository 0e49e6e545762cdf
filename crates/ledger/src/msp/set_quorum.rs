//! Changes of quorums: by a proposal, which needs the quorum that the function has then.

use super::caller::admin;
use super::organisations;
use super::own_call::own_call;
use super::proposals::decide;
use super::quorums::{SetQuorum, argument};
use super::store::{self, json, quorum_key};
use super::{NAME, SET_QUORUM};
use crate::chaincode::{Context, Quorum, quorum_of};
use bytes::Bytes;
use ledger_base::rejection::{Code, Rejection};

/// `set_quorum {chaincode, function, quorum?}`
pub(super) fn set(ctx: &mut Context<'_>, given: &Bytes) -> Result<Bytes, Rejection> {
    let set = argument(given)?;
    if ctx.approved_by().is_some() {
        return change(ctx, &set);
    }
    let caller = admin(ctx, "change a quorum")?;
    check(ctx, &set)?;
    json(&decide(ctx, caller, own_call(SET_QUORUM, &set)?)?)
}

fn change(ctx: &mut Context<'_>, set: &SetQuorum) -> Result<Bytes, Rejection> {
    check(ctx, set)?;
    let key = quorum_key(&set.chaincode, &set.function);
    match &set.quorum {
        Some(quorum) => store::write(ctx, &key, quorum)?,
        None => ctx.delete(key.as_bytes()),
    }
    let event = json(set)?;
    ctx.emit("quorum_changed", &format!("{}/{}", set.chaincode, set.function), event.clone());
    Ok(event)
}

fn check(ctx: &Context<'_>, set: &SetQuorum) -> Result<(), Rejection> {
    quorum_of(ctx.registry().find(&set.chaincode)?, &set.function)?;
    if (set.chaincode.as_str(), set.function.as_str()) == (NAME, SET_QUORUM) {
        return Err(Rejection::new(Code::BadArgument, "set_quorum has no quorum of its own")
            .found("set_quorum for set_quorum")
            .wanted("another function: a change of its quorum needs its current quorum")
            .next("ledgerctl network quorums"));
    }
    let Some(Quorum::Admins { of: Some(organisation), .. }) = &set.quorum else { return Ok(()) };
    if organisations::find(ctx, organisation)?.is_some() {
        return Ok(());
    }
    Err(Rejection::new(Code::NotFound, "the network has no such organisation")
        .found(format!("{organisation:?}"))
        .wanted(format!("one of {}", organisations::names(ctx)?.join(", "))))
}
