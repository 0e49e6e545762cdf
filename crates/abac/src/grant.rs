//! Grants: leases with an epoch that fences off every earlier holder.
//!
//! A grant is *live* while its expiry lies after block time and nothing has ended it. A grant that is no longer live
//! counts nowhere, even while it still lies in the state waiting to be swept (see `revoke`).

use crate::arguments::{Arguments, shown};
use crate::authorize::{self, Decider};
use crate::conflict::{self, Outcome};
use crate::publish;
use crate::revoke;
use crate::robot;
use crate::service::{self, LEASE_MS_MIN, Target};
use crate::store;
use crate::timestamp::rfc3339;
use bytes::Bytes;
use ledger::Context;
use ledger_contract::{Grant, Mode, Reason, Released};
use ledger_hash::Hash;
use ledger_identity::{Identity, Role};
use ledger_mutation::{Mutation, active, lease_clock};
use ledger_rejection::{Code, Rejection};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Most holders of one open service.
pub(crate) const HOLDERS_MAX: usize = 256;

/// What decides about an identity. Kept with a grant, so that the grant can be judged again when policies change.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Principal {
    pub(crate) organisation: String,
    pub(crate) name: String,
    pub(crate) role: Role,
    pub(crate) attributes: BTreeMap<String, String>,
    /// SHA-256 of the issuer's name: with `serial` it names the certificate for revocation.
    pub(crate) issuer: Hash,
    /// Hexadecimal.
    pub(crate) serial: String,
    /// SHA-256 of the certificate: names the identity in caches.
    pub(crate) fingerprint: Hash,
    /// End of the certificate's validity (microseconds).
    pub(crate) not_after: u64,
}

/// A grant as the state holds it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Holding {
    pub(crate) grant: Grant,
    pub(crate) principal: Principal,
    /// Set when the grant has ended and its event is still to come (see `revoke::end_all`).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) ending: Option<Reason>,
}

impl Principal {
    /// What decides about that identity.
    pub(crate) fn of(identity: &Identity) -> Self {
        Self {
            organisation: identity.organisation.clone(),
            name: identity.name.clone(),
            role: identity.role,
            attributes: identity.attributes.clone(),
            issuer: Hash(identity.issuer),
            serial: hex::encode(&identity.serial),
            fingerprint: Hash(identity.fingerprint),
            not_after: identity.not_after,
        }
    }

    /// `Org1/Salma`.
    pub(crate) fn id(&self) -> String {
        format!("{}/{}", self.organisation, self.name)
    }

    /// The same certificate, as revocation would name it?
    pub(crate) fn same_certificate(&self, other: &Self) -> bool {
        self.issuer == other.issuer && self.serial == other.serial
    }
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
    fn extended(&self, now: u64) -> u64 {
        now.saturating_add(self.grant.lease_ms.saturating_mul(1000)).min(self.principal.not_after)
    }

    /// Extends the lease from `now`.
    fn extend(&mut self, now: u64) {
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

/// Writes a grant and its index keys.
fn put(ctx: &mut Context<'_>, holding: &Holding) -> Result<(), Rejection> {
    let (service, holder) = (&holding.grant.service, &holding.grant.holder);
    store::write(ctx, &store::grant_key(service, holder), holding)?;
    ctx.put(&store::due_key(holding.grant.expires, service, holder), Bytes::new());
    ctx.put(&certificate_key(holding), Bytes::new());
    Ok(())
}

/// Replaces a grant by itself with another expiry or state.
pub(crate) fn replace(ctx: &mut Context<'_>, before: &Holding, after: &Holding) -> Result<(), Rejection> {
    ctx.delete(&store::due_key(before.grant.expires, &before.grant.service, &before.grant.holder));
    put(ctx, after)
}

/// Removes a grant and its index keys, and tells the world why.
pub(crate) fn end(ctx: &mut Context<'_>, holding: &Holding, reason: Reason) -> Result<Released, Rejection> {
    let (service, holder) = (&holding.grant.service, &holding.grant.holder);
    ctx.delete(&store::grant_key(service, holder));
    ctx.delete(&store::due_key(holding.grant.expires, service, holder));
    ctx.delete(&certificate_key(holding));
    let released = Released { service: service.clone(), holder: holder.clone(), epoch: holding.grant.epoch, reason };
    ctx.emit("released", service, store::json(&released)?);
    Ok(released)
}

fn certificate_key(holding: &Holding) -> Vec<u8> {
    let serial = hex::decode(&holding.principal.serial).unwrap_or_default();
    let mut key = store::certificate_prefix(&holding.principal.issuer.0, &serial);
    key.extend_from_slice(format!("{}\0{}", holding.grant.service, holding.grant.holder).as_bytes());
    key
}

/// `acquire SERVICE [LEASE_MS]`
pub(crate) fn acquire(ctx: &mut Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("acquire SERVICE [LEASE_MS]", args, 1, 2)?;
    let principal = Principal::of(ctx.submitter()?);
    let target = service::resolve(ctx, args.text(0, "SERVICE")?)?;
    let lease_ms = lease(&target, args)?;
    if let Some(own) = may_acquire(ctx, decider, &principal, &target)? {
        if own.principal.same_certificate(&principal) {
            return renewed(ctx, &target, own, lease_ms);
        }
        // Another certificate of the same person: whoever holds the old one must be fenced off.
        end(ctx, &own, Reason::Released)?;
    }
    let now = ctx.block_time();
    for dead in stored(ctx, &target.id)?.iter().filter(|holding| !holding.is_live(now)) {
        end(ctx, dead, dead.reason())?;
    }
    grant(ctx, &target, principal, lease_ms.unwrap_or(target.service.lease_ms))
}

/// Algorithm 1 of the paper: may this principal have a grant now, by the policies and beside those who hold one?
/// Returns the grant that the principal has already.
///
/// # Errors
/// What the policies say, [`Code::Held`], or [`Code::LimitExceeded`].
pub(crate) fn may_acquire(
    ctx: &Context<'_>,
    decider: &Decider,
    principal: &Principal,
    target: &Target,
) -> Result<Option<Holding>, Rejection> {
    authorize::may_hold(ctx, decider, principal, target)?;
    let (own, others): (Vec<_>, Vec<_>) =
        live(ctx, &target.id)?.into_iter().partition(|holding| holding.grant.holder == principal.id());
    if let Some(own) = own.into_iter().next() {
        return Ok(Some(own));
    }
    let grants: Vec<&Grant> = others.iter().map(|holding| &holding.grant).collect();
    match conflict::rule(target.service.mode).resolve(principal, &grants) {
        Outcome::Held(grant) => Err(held(target, grant)),
        Outcome::Granted if grants.len() >= HOLDERS_MAX => {
            Err(Rejection::new(Code::LimitExceeded, format!("{} has no room for another holder", target.id))
                .found(format!("{} holders", grants.len()))
                .wanted(format!("at most {HOLDERS_MAX}")))
        }
        Outcome::Granted => Ok(None),
    }
}

fn grant(ctx: &mut Context<'_>, target: &Target, principal: Principal, lease_ms: u64) -> Result<Bytes, Rejection> {
    let newest = newest_epoch(ctx, &target.id)?;
    let epoch = newest
        .checked_add(u64::from(newest == 0 || !active(Mutation::ReuseAnEpoch)))
        .ok_or_else(|| Rejection::new(Code::LimitExceeded, format!("{} has used up its epochs", target.id)))?;
    store::write(ctx, &store::epoch_key(&target.id), &epoch)?;
    let mut holding = Holding {
        grant: Grant {
            service: target.id.clone(),
            holder: principal.id(),
            epoch,
            expires: 0,
            mode: target.service.mode,
            acquired_at: ctx.block_time(),
            lease_ms,
            next_seq: publish::next_sequence(ctx, target, epoch, &principal.id())?,
        },
        principal,
        ending: None,
    };
    holding.extend(ctx.block_time());
    put(ctx, &holding)?;
    let granted = store::json(&holding.grant)?;
    ctx.emit("granted", &target.id, granted.clone());
    Ok(granted)
}

/// `renew SERVICE [LEASE_MS]`
pub(crate) fn renew(ctx: &mut Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("renew SERVICE [LEASE_MS]", args, 1, 2)?;
    let principal = Principal::of(ctx.submitter()?);
    let target = service::resolve(ctx, args.text(0, "SERVICE")?)?;
    let own = own(ctx, &principal, &target)?;
    authorize::may_hold(ctx, decider, &principal, &target)?;
    let lease_ms = lease(&target, args)?;
    renewed(ctx, &target, own, lease_ms)
}

fn renewed(ctx: &mut Context<'_>, target: &Target, before: Holding, lease_ms: Option<u64>) -> Result<Bytes, Rejection> {
    let mut after = before.clone();
    after.grant.lease_ms = lease_ms.unwrap_or(before.grant.lease_ms).min(target.service.lease_ms_max);
    after.grant.next_seq = publish::next_sequence(ctx, target, before.grant.epoch, &before.grant.holder)?;
    after.extend(ctx.block_time());
    replace(ctx, &before, &after)?;
    let grant = store::json(&after.grant)?;
    ctx.emit("renewed", &target.id, grant.clone());
    Ok(grant)
}

/// Renews a grant because it is used; writes only when more than a quarter of the lease is used up, and only if
/// policies that look at the time still permit it (all others ended the grant when they changed).
pub(crate) fn used(
    ctx: &mut Context<'_>,
    decider: &Decider,
    target: &Target,
    before: &Holding,
) -> Result<(), Rejection> {
    let now = ctx.block_time();
    let quarter = before.grant.lease_ms.saturating_mul(250);
    if before.extended(now).saturating_sub(before.grant.expires) <= quarter
        || authorize::may_hold(ctx, decider, &before.principal, target).is_err()
    {
        return Ok(());
    }
    let mut after = before.clone();
    after.extend(now);
    replace(ctx, before, &after)
}

/// `release SERVICE [HOLDER]`: the caller's own grant; without one, an admin of the owner takes the service back,
/// from everybody or from one holder.
pub(crate) fn release(ctx: &mut Context<'_>, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("release SERVICE [HOLDER]", args, 1, 2)?;
    let principal = Principal::of(ctx.submitter()?);
    let target = service::resolve(ctx, args.text(0, "SERVICE")?)?;
    let whose = if args.has(1) { Some(args.text(1, "HOLDER")?) } else { None };
    let is_own = whose.is_none_or(|holder| holder == principal.id());
    let takes_back = principal.role == Role::Admin && principal.organisation == target.robot.organisation;
    if is_own && let Ok(own) = own(ctx, &principal, &target) {
        return store::json(&[end(ctx, &own, Reason::Released)?]);
    }
    let holders = live(ctx, &target.id)?;
    if !takes_back {
        return Err(match whose.filter(|_| !is_own) {
            Some(holder) => not_yours_to_take(&principal, &target, holder),
            None => nothing_to_release(&principal.id(), &target, &holders),
        });
    }
    let mut taken = holders.clone();
    taken.retain(|holding| whose.is_none_or(|holder| holder == holding.grant.holder));
    if let (Some(holder), true) = (whose, taken.is_empty()) {
        return Err(nothing_to_release(&shown(holder), &target, &holders).wanted("one who holds it"));
    }
    store::json(&revoke::end_all(ctx, taken.into_iter().map(|holding| (holding, Reason::Taken)).collect())?)
}

/// `grants [SERVICE]`: the live grants of one service or of all.
pub(crate) fn list(ctx: &Context<'_>, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("grants [SERVICE]", args, 0, 1)?;
    let targets = if args.has(0) {
        vec![service::resolve(ctx, args.text(0, "SERVICE")?)?]
    } else {
        robot::all(ctx)?
            .iter()
            .flat_map(|robot| robot.services.iter().map(move |service| Target::of(robot, service)))
            .collect()
    };
    let mut grants = Vec::new();
    for target in &targets {
        for Holding { mut grant, .. } in live(ctx, &target.id)? {
            grant.next_seq = publish::next_sequence(ctx, target, grant.epoch, &grant.holder)?;
            grants.push(grant);
        }
    }
    store::json(&grants)
}

/// The principal's own live grant, acquired with this certificate.
///
/// # Errors
/// [`Code::NotHolder`], saying who holds the service instead.
pub(crate) fn own(ctx: &Context<'_>, principal: &Principal, target: &Target) -> Result<Holding, Rejection> {
    let own = held_by(ctx, &target.id, &principal.id())?;
    if let Some(own) = own.filter(|own| own.principal.same_certificate(principal)) {
        return Ok(own);
    }
    Err(not_holder(target, &principal.id(), &live(ctx, &target.id)?))
}

fn not_holder(target: &Target, who: &str, holders: &[Holding]) -> Rejection {
    let id = &target.id;
    Rejection::new(Code::NotHolder, format!("{who} holds no grant of {id}"))
        .found(holders_of(who, holders))
        .wanted(format!("a grant of {id} to {who}"))
        .next(match holders {
            [holding] if holding.grant.holder != who => format!("once it is free: ledgerctl acquire {id}"),
            _ => format!("ledgerctl acquire {id}"),
        })
}

fn nothing_to_release(who: &str, target: &Target, holders: &[Holding]) -> Rejection {
    let (id, owner) = (&target.id, &target.robot.organisation);
    let next = match holders {
        [] => format!("there is nothing to release; ledgerctl robot show {} tells who holds what", target.robot.name),
        [holding] if holding.grant.holder == who => {
            format!("it ends by itself; to end it now: ledgerctl acquire {id}, then release it")
        }
        _ => format!("only the holder, or an admin of {owner}, can release it"),
    };
    Rejection::new(Code::NotHolder, format!("{who} holds no grant of {id}"))
        .found(holders_of(who, holders))
        .wanted("a grant to release")
        .next(next)
}

fn not_yours_to_take(principal: &Principal, target: &Target, holder: &str) -> Rejection {
    let (id, owner) = (&target.id, &target.robot.organisation);
    let code = if principal.organisation == *owner { Code::NotAdmin } else { Code::NotOwner };
    Rejection::new(code, format!("{} may not take {id} back from {}", principal.id(), shown(holder)))
        .found(format!("role {} of {}", principal.role, principal.organisation))
        .wanted(format!("an admin of {owner}, which owns {}", target.robot.name))
        .next(format!("ask an admin of {owner}, or release your own grant: ledgerctl release {id}"))
}

/// Who holds a service, told to one who does not.
fn holders_of(who: &str, holders: &[Holding]) -> String {
    match holders {
        [] => "held by nobody".to_owned(),
        [holding] if holding.grant.holder == who => {
            format!("acquired with another certificate, until {}", until(&holding.grant))
        }
        [holding] => format!("held by {} until {}", holding.grant.holder, until(&holding.grant)),
        many => format!("{} other holders", many.len()),
    }
}

fn held(target: &Target, grant: &Grant) -> Rejection {
    let (id, holder) = (&target.id, &grant.holder);
    Rejection::new(Code::Held, format!("{id} is held by {holder} until {}", until(grant)))
        .found(format!("{} service, held by {holder} with epoch {}", mode_name(target.service.mode), grant.epoch))
        .wanted("no other holder")
        .next(format!(
            "acquire it after that time, ask {holder} to release it, or ask an admin of {} to take it back",
            target.robot.organisation
        ))
}

fn until(grant: &Grant) -> String {
    format!("{} ({} µs)", rfc3339(grant.expires), grant.expires)
}

/// The name of a mode, as in JSON and policies.
pub(crate) fn mode_name(mode: Mode) -> &'static str {
    match mode {
        Mode::Open => "open",
        Mode::Exclusive => "exclusive",
    }
}

fn lease(target: &Target, args: Arguments<'_>) -> Result<Option<u64>, Rejection> {
    if !args.has(1) {
        return Ok(None);
    }
    let lease_ms = args.number(1, "LEASE_MS")?;
    let max = target.service.lease_ms_max;
    if (LEASE_MS_MIN..=max).contains(&lease_ms) {
        return Ok(Some(lease_ms));
    }
    Err(args.bad(1, "LEASE_MS", format!("{lease_ms} ms"), &format!("{LEASE_MS_MIN} to {max} ms for {}", target.id)))
}
