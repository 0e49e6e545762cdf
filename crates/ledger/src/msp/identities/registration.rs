//! Names are registered and cancelled by the admins of their organisation.

use super::super::caller::object;
use super::super::quotas;
use super::super::store::{self, identity_key, issued_key, json, look_keys};
use super::registrar::{self, Registering};
use super::{IdentityRecord, IssuedCertificate, REGISTRATION_LIFE_MAX, Secret, count, find, is_revoked, shown, write};
use crate::chaincode::Context;
use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_base::moment::rfc3339;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::certificate::encode_attributes;
use ledger_identity::{ATTRIBUTE_FORM, Role, check_new_name, check_readable, read_attribute, shown_attribute};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Most characters of a text that a rejection repeats.
const FOUND_CHARS_MAX: usize = 128;

/// Argument of `register`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Register {
    /// The name, as it will stand in the certificate.
    pub name: String,
    /// Its role; left out with `again`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub role: Option<Role>,
    /// The attributes of its certificates; none with `again` keeps what is registered.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub attributes: BTreeMap<String, String>,
    /// SHA-256 of the one-time secret's text. The secret itself never comes here.
    pub secret: Hash,
    /// Last block time at which the secret can be used, microseconds.
    pub expires: u64,
    /// A new secret for a name that is registered already, whose role stays.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub again: bool,
}

/// Argument of `cancel_registration`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CancelRegistration {
    /// The name.
    pub name: String,
}

/// `register {name, role, attributes?, secret, expires, again?}`
pub(in super::super) fn register(ctx: &mut Context<'_>, argument: &Bytes) -> Result<Bytes, Rejection> {
    let wanted = "{\"name\", \"role\", \"attributes\", \"secret\": SHA-256 of the secret, \"expires\": microseconds}";
    let Register { name, role, attributes, secret, expires, again } = object("register", argument, wanted)?;
    let registering = Registering::of(ctx, "register identities")?;
    let caller = registering.caller;
    check(&attributes)?;
    check_form(&attributes)?;
    let now = ctx.block_time();
    if expires <= now || expires > now.saturating_add(REGISTRATION_LIFE_MAX) {
        return Err(Rejection::new(Code::BadArgument, "the expiry of the secret is out of range")
            .found(format!("{}, block time {}", rfc3339(expires), rfc3339(now)))
            .wanted("a time in the next 365 days"));
    }
    let organisation = &caller.organisation;
    let known = find(ctx, organisation, &name)?;
    let secret = Some(Secret { sha256: secret, expires, used: None, maker: Some(registering.maker()) });
    let record = match (known, again) {
        (Some(known), true) => {
            if role.is_some_and(|role| role != known.role) {
                return Err(registered_for(&known, "the role of a registered name cannot change"));
            }
            registering.check_again(ctx, &known)?;
            let attributes = if attributes.is_empty() { known.attributes.clone() } else { attributes };
            registering.check(None, &attributes)?;
            let changed = if attributes == known.attributes { known.changed } else { now };
            IdentityRecord { attributes, secret, local: None, changed, by: caller.id(), ..known }
        }
        (Some(known), false) => {
            return Err(registered_for(&known, "an unused name").next(format!(
                "choose another name, or create a new secret for this one: ledgerctl identity register {name} --reissue"
            )));
        }
        (None, true) => {
            return Err(Rejection::new(Code::NotFound, format!("{name:?} is not registered at {organisation}"))
                .wanted("a registered name")
                .next("omit --reissue to register it"));
        }
        (None, false) => {
            registering.check(role, &attributes)?;
            check_new_name(&name)?;
            registering.check_no_right(ctx, &name)?;
            take_look(ctx, organisation, &name)?;
            make_room(ctx, organisation)?;
            IdentityRecord {
                organisation: organisation.clone(),
                name,
                role: role.unwrap_or(Role::Member),
                attributes,
                registered: now,
                by: caller.id(),
                secret,
                local: None,
                voided: 0,
                stays: false,
                changed: 0,
                certificates: Vec::new(),
            }
        }
    };
    write(ctx, &record)?;
    ctx.emit("registered", &record.id(), json(&told(&record))?);
    json(&shown(ctx, record))
}

/// `cancel_registration {name}`: the secret of a name that has not enrolled with it is void. A name is forgotten if it never had a
/// certificate, or if all of its certificates are revoked and none has ever signed a transaction.
pub(in super::super) fn cancel(ctx: &mut Context<'_>, argument: &Bytes) -> Result<Bytes, Rejection> {
    let CancelRegistration { name } = object("cancel_registration", argument, "{\"name\": NAME}")?;
    let registering = Registering::of(ctx, "cancel registrations")?;
    let (caller, now) = (registering.caller, ctx.block_time());
    let Some(record) = find(ctx, &caller.organisation, &name)? else {
        return Err(unknown(&caller.organisation, &name));
    };
    registering.check_cancel(&record)?;
    if record.pending(now).is_none() {
        if let Some(found) = kept_because(ctx, &record) {
            let next = match record.certificates.iter().all(|issued| is_revoked(ctx, issued)) {
                true => "register another name".to_owned(),
                false => format!("to end its rights: ledgerctl identity revoke {name}"),
            };
            return Err(Rejection::new(Code::NotFound, format!("no registration of {} can be cancelled", record.id()))
                .found(found)
                .wanted("a registration whose secret was not used yet, or a revoked name that never signed anything")
                .next(next));
        }
        forget(ctx, &record)?;
        ctx.emit("registration_cancelled", &record.id(), json(&told(&record))?);
        return Ok(Bytes::new());
    }
    void(ctx, record, false)?;
    Ok(Bytes::new())
}

/// The reason why a name without an open secret is kept; none if it can be free again, because nothing on the ledger was signed
/// under it.
fn kept_because(ctx: &Context<'_>, record: &IdentityRecord) -> Option<&'static str> {
    let has_signed = |issued: &IssuedCertificate| ctx.get(&store::known_certificate_key(&issued.fingerprint)).is_some();
    if record.role == Role::Node {
        Some("a node, whose name the network has recorded")
    } else if !record.certificates.iter().all(|issued| is_revoked(ctx, issued)) {
        Some("an enrolled name with a valid certificate")
    } else if record.stays
        || record.local.is_some()
        || record.registered == 0
        || record.certificates.iter().any(has_signed)
    {
        Some("a name that has signed something, or may have")
    } else {
        None
    }
}

/// Forgets a name, so that it can be registered again.
fn forget(ctx: &mut Context<'_>, record: &IdentityRecord) -> Result<(), Rejection> {
    for issued in &record.certificates {
        ctx.delete(&issued_key(&issued.fingerprint));
    }
    ctx.delete(identity_key(&record.organisation, &record.name).as_bytes());
    for look in look_keys(&record.organisation, &record.name) {
        if store::read::<String>(ctx, &look)?.as_ref() == Some(&record.name) {
            ctx.delete(look.as_bytes());
        }
    }
    count(ctx, &record.organisation, |number| number.saturating_sub(1))?;
    Ok(())
}

/// A new name looks like no other one of its organisation.
fn take_look(ctx: &mut Context<'_>, organisation: &str, name: &str) -> Result<(), Rejection> {
    check_readable(name)?;
    let keys = look_keys(organisation, name);
    for key in &keys {
        if let Some(known) = store::read::<String>(ctx, key)? {
            return Err(Rejection::new(
                Code::AlreadyRegistered,
                format!("{name:?} looks like a registered name"),
            )
            .found(format!("{known:?} of {organisation}"))
            .wanted("a name that is visibly different from the others, not only in case (UTS 39)")
            .next(format!(
                "choose another name; a revoked one that never signed anything can be freed with ledgerctl identity \
                 cancel {known}"
            )));
        }
    }
    keys.iter().try_for_each(|key| store::write(ctx, key, &name))
}

/// A name that is known already, by a certificate of its own, keeps others from looking like it. Two that look alike stay.
pub(super) fn keep_look(ctx: &mut Context<'_>, organisation: &str, name: &str) -> Result<(), Rejection> {
    for key in look_keys(organisation, name) {
        if ctx.get(key.as_bytes()).is_none() {
            store::write(ctx, &key, &name)?;
        }
    }
    Ok(())
}

/// Voids the secrets of a name; forgets it if it never had a certificate. Its right as a registrar ends with the name, and where
/// its certificates are `revoked`.
pub(super) fn void(ctx: &mut Context<'_>, record: IdentityRecord, revoked: bool) -> Result<(), Rejection> {
    let (never, now) = (record.certificates.is_empty() && record.local.is_none(), ctx.block_time());
    let pending = record.pending(now).is_some();
    // A node at which a secret lies has to learn that it is void: then the name stays.
    let marked = revoked || record.local.is_some();
    let voided = if marked { now } else { record.voided };
    let stays = record.stays || record.local.is_some();
    let record = IdentityRecord { secret: None, local: None, voided, stays, ..record };
    if never || revoked {
        registrar::forget(ctx, &record.organisation, &record.name);
    }
    if never {
        forget(ctx, &record)?;
    } else {
        write(ctx, &record)?;
    }
    if pending {
        ctx.emit("registration_cancelled", &record.id(), json(&told(&record))?);
    }
    Ok(())
}

/// Room for one more name.
pub(super) fn make_room(ctx: &mut Context<'_>, organisation: &str) -> Result<(), Rejection> {
    let most = quotas::of(ctx, organisation)?.identities;
    if count(ctx, organisation, |number| number.saturating_add(1))? <= most {
        return Ok(());
    }
    let free = "cancel unused registrations: ledgerctl identity list";
    Err(quotas::quota_reached(organisation, "identities", most, free))
}

/// Attributes that a certificate can hold.
pub(super) fn check(attributes: &BTreeMap<String, String>) -> Result<(), Rejection> {
    encode_attributes(attributes).map(|_| ()).map_err(|error| Rejection::from(error).code(Code::BadArgument))
}

/// Attributes that an admin means: no two in one, no value in the name.
fn check_form(attributes: &BTreeMap<String, String>) -> Result<(), Rejection> {
    for (key, value) in attributes {
        let text = shown_attribute(key, value);
        read_attribute(&text).map_err(|fault| {
            let found: String = text.chars().take(FOUND_CHARS_MAX).collect();
            Rejection::new(Code::BadArgument, "this is not an attribute")
                .found(format!("{found:?}"))
                .wanted(ATTRIBUTE_FORM)
                .next(fault.question("--attr "))
        })?;
    }
    Ok(())
}

pub(super) fn unknown(organisation: &str, name: &str) -> Rejection {
    let name: String = name.chars().take(128).collect();
    Rejection::new(Code::NotFound, format!("{name:?} is not registered at {organisation}"))
        .wanted("a registered name")
        .next("ledgerctl identity list shows the registered names")
}

fn registered_for(known: &IdentityRecord, wanted: &str) -> Rejection {
    Rejection::new(Code::AlreadyRegistered, format!("{} is already registered at {}", known.name, known.organisation))
        .found(format!("role {}, certificates: {}", known.role, known.certificates.len()))
        .wanted(wanted)
}

fn told(record: &IdentityRecord) -> serde_json::Value {
    serde_json::json!({
        "organisation": record.organisation, "name": record.name, "role": record.role, "by": record.by,
    })
}
