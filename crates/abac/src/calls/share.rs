//! `share`: a new content key, wrapped for those who may read.

use crate::arguments::{Arguments, shown};
use crate::lifecycle::{content_keys, publishing};
use crate::policy::decider::Decider;
use crate::records::reader::{Entered, SharedKey};
use crate::records::target::Target;
use crate::records::{reader, store, target};
use bytes::Bytes;
use ledger::Context;
use ledger_base::mutation::{Mutation, active};
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{Keyed, READERS_MAX, Share, WRAPPED_BYTES, Wrapped};

/// A content key is replaced after this long at the latest (microseconds): policies may speak of the time.
const KEY_LIFE_US: u64 = 3_600_000_000;

/// Longest JSON of a share, in bytes.
const SHARE_BYTES_MAX: usize = 64 * 1024;

/// `share SERVICE EPOCH SHARE_JSON`: the publisher's new content key, wrapped for everybody who may read now.
pub(crate) fn share(ctx: &mut Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("share SERVICE EPOCH SHARE_JSON", args, 3, 3)?;
    let target = target::resolve(ctx, args.text(0, "SERVICE")?)?;
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
    publishing::may_publish(ctx, decider, submitter, &target, Some(epoch))?;
    let publisher = submitter.id();
    if reader::shared(ctx, &target.id, &publisher)?.is_some_and(|shared| shared.key >= ctx.height()) {
        return Err(Rejection::new(Code::LimitExceeded, format!("{publisher} has already shared a key in this block"))
            .found("a second content key of one publisher in one block")
            .wanted("one per block: the height identifies the key")
            .next("use the first one, or share again"));
    }
    let until = check_share(ctx, decider, &target, &share)?;
    let (key, made_for) = (ctx.height(), content_keys::made_for(ctx, &target)?);
    let moves = reader::changes(ctx, &target.id)?.moves;
    reader::share(ctx, &target.id, &publisher, &SharedKey { key, made_for, moves, until })?;
    let keyed = store::json(&Keyed { key, until, readers: share.readers.len() as u64 })?;
    ctx.emit("keyed", &target.id, keyed.clone());
    Ok(keyed)
}

/// A share is for exactly those who may read now, with the keys that they have now. Answers until when it is good.
fn check_share(ctx: &Context<'_>, decider: &Decider, target: &Target, share: &Share) -> Result<u64, Rejection> {
    let (mut wanted, mut good) = (Vec::new(), ctx.block_time().saturating_add(KEY_LIFE_US));
    let mut is_owners = false;
    for Entered { principal, key } in reader::all(ctx, &target.id)? {
        if let Some(until) = content_keys::until(ctx, decider, &principal, target)? {
            is_owners |= content_keys::governs(&principal, &target.robot);
            good = good.min(until);
            wanted.push((principal.id(), key));
        }
    }
    let (id, owner) = (&target.id, &target.robot.organisation);
    if !is_owners {
        return Err(Rejection::new(
            Code::ReadersChanged,
            format!("no reader of {owner}, the owner of {id}, has a key"),
        )
        .found("no reader that is an admin, a node or the robot of the owner")
        .wanted(format!("at least one of {owner}: the owner can always read"))
        .next(format!("as an admin of {owner}: ledgerctl readers {id} --enter")));
    }
    let given = share.readers.iter().map(|Wrapped { reader, key, .. }| (reader.as_str(), key.as_str()));
    let is_exact = given.eq(wanted.iter().map(|(reader, key)| (reader.as_str(), key.as_str())));
    if !is_exact && !active(Mutation::ShareWithAnybody) {
        let names = |names: Vec<&str>| if names.is_empty() { "none".to_owned() } else { names.join(", ") };
        let given: Vec<&str> = share.readers.iter().take(READERS_MAX).map(|one| one.reader.as_str()).collect();
        return Err(Rejection::new(
            Code::ReadersChanged,
            format!("the content key is not for the current readers of {id}"),
        )
        .found(shown(&names(given)))
        .wanted(names(wanted.iter().map(|(reader, _)| reader.as_str()).collect()))
        .next("wrap it for each of them with their current key, in this order"));
    }
    if let Some(bad) = share.readers.iter().find(|one| !content_keys::is_hex(&one.wrapped, WRAPPED_BYTES)) {
        return Err(Rejection::new(
            Code::BadArgument,
            format!("the content key for {} is not wrapped correctly", bad.reader),
        )
        .found(format!("{} bytes of text", bad.wrapped.len()))
        .wanted(format!("{} lower-case hexadecimal digits", 2 * WRAPPED_BYTES)));
    }
    Ok(good)
}
