//! Certificates that nodes with a CA have issued: a certificate counts as handed out when it stands here.
//!
//! Two nodes may certify the same name at the same time. The first record that is executed takes the secret; for the
//! same key both hand out its certificate, for another key the second is refused.

use super::super::caller::{node, object};
use super::super::organisations;
use super::super::revocations;
use super::super::store::{self, carrier_key, issued_key, json};
use super::registrar::maker_lost;
use super::registration::{check, keep_look, make_room, unknown};
use super::{
    CERTIFICATES_MAX, ENROLMENT_REPEAT_MAX, IdentityRecord, IssuedCertificate, LocalSecret, RENEWAL_PAUSE, Secret, Use,
    find, is_revoked, write,
};
use crate::chaincode::{Context, Revocation};
use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::certificate::{CERTIFICATE_BYTES_MAX, Certificate};
use ledger_identity::msp::Msps;
use ledger_identity::{Identity, Role, check_name};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Argument of `record_certificate`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RecordCertificate {
    /// The organisation whose CA has issued it.
    pub organisation: String,
    /// DER in hexadecimal.
    pub certificate: String,
    /// Why it was issued.
    pub ground: Ground,
}

/// Why a certificate was issued.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Ground {
    /// Somebody came with the secret that has this hash.
    Secret(Hash),
    /// Its holder has one that is still good.
    Renewal,
    /// Somebody came with a secret that was made at this time at the node's own machine, microseconds.
    Local(u64),
}

/// Answer of `record_certificate`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Recorded {
    /// The certificate that counts, DER in hexadecimal: the one that was given, or an earlier one for the same key.
    pub certificate: String,
}

/// `record_certificate {organisation, certificate, ground}`
pub(in super::super) fn record(ctx: &mut Context<'_>, argument: &Bytes) -> Result<Bytes, Rejection> {
    let wanted = "{\"organisation\", \"certificate\": DER in hexadecimal, \"ground\"}";
    let RecordCertificate { organisation, certificate, ground } = object("record_certificate", argument, wanted)?;
    let caller = node(ctx, "record certificates")?;
    check_may_issue(ctx, caller, &organisation)?;
    let der = hex::decode(&certificate).ok().filter(|der| der.len() <= CERTIFICATE_BYTES_MAX);
    let der = Bytes::from(der.ok_or_else(|| {
        Rejection::new(Code::BadArgument, "the certificate is not usable")
            .wanted(format!("DER in hexadecimal, at most {CERTIFICATE_BYTES_MAX} bytes"))
    })?);
    let holder = verified(ctx, &organisation, &der)?;
    let known = find(ctx, &organisation, &holder.name)?;
    if let Some(recorded) = known.as_ref().and_then(|known| known.certificate(&Hash(holder.fingerprint))) {
        if is_revoked(ctx, recorded) {
            return Err(refused("a certificate that was revoked"));
        }
        return json(&Recorded { certificate });
    }
    let key = Hash::of(&[&holder.public_key.to_spki()]);
    let issued = IssuedCertificate {
        serial: hex::encode(&holder.serial),
        issuer: Hash(holder.issuer),
        fingerprint: Hash(holder.fingerprint),
        not_before: holder.not_before,
        not_after: holder.not_after,
        via: caller.id(),
        recorded: ctx.block_time(),
        revoked: false,
    };
    let mut record = match (known, ground) {
        (Some(known), _) => known,
        (None, Ground::Local(_)) => {
            make_room(ctx, &organisation)?;
            keep_look(ctx, &organisation, &holder.name)?;
            created(&organisation, &holder.name, holder.role, holder.attributes.clone(), caller)
        }
        (None, _) => return Err(unknown(&organisation, &holder.name)),
    };
    check_as_registered(&record, &holder, ground)?;
    match ground {
        Ground::Secret(presented) => {
            if let Some(earlier) = take_secret(ctx, &mut record, presented, key, issued.fingerprint)? {
                return json(&Recorded { certificate: hex::encode(earlier) });
            }
        }
        Ground::Renewal => {
            if let Some(earlier) = check_renewal(ctx, &record, &holder)? {
                return json(&Recorded { certificate: hex::encode(earlier) });
            }
        }
        Ground::Local(made) => {
            if record.voided >= made {
                return Err(refused("a secret that was cancelled"));
            }
            record.local = None;
        }
    }
    if !matches!(ground, Ground::Local(_)) {
        end_others(ctx, &record, &holder, &caller.id())?;
    }
    add(ctx, &mut record, issued)?;
    ctx.put(&issued_key(&Hash(holder.fingerprint)), der);
    write(ctx, &record)?;
    ctx.emit("certified", &record.id(), json(&record.certificates.last())?);
    json(&Recorded { certificate })
}

/// May this node say what the CA of that organisation has issued? Those may that have shown that they carry its key.
fn check_may_issue(ctx: &Context<'_>, caller: &Identity, organisation: &str) -> Result<(), Rejection> {
    if ctx.get(carrier_key(organisation, &caller.organisation, &caller.name).as_bytes()).is_some() {
        return Ok(());
    }
    Err(Rejection::new(Code::NotAdmin, format!("{} may not issue certificates for {organisation}", caller.id()))
        .found("a node that does not hold its CA key, according to the ledger")
        .wanted(format!("a node that holds the CA key of {organisation}"))
        .next("ledgerctl ca status shows the nodes that hold it"))
}

/// Revokes the certificates of a name that say other attributes than this one: nobody goes on with what was taken away. One that
/// was issued beside the ledger, and has never signed, says nothing here: it goes if the attributes have changed since.
fn end_others(ctx: &mut Context<'_>, record: &IdentityRecord, holder: &Identity, by: &str) -> Result<(), Rejection> {
    for issued in &record.certificates {
        let der = ctx.get(&issued_key(&issued.fingerprint));
        let der = der.or_else(|| ctx.get(&store::known_certificate_key(&issued.fingerprint)));
        let stays = match der.and_then(|der| Certificate::parse(&der).ok()?.attributes().ok()) {
            Some(said) => said == holder.attributes,
            None => issued.recorded > record.changed || record.changed == 0,
        };
        if stays {
            continue;
        }
        let serial = hex::decode(&issued.serial).unwrap_or_default();
        let revoked = Revocation { issuer: issued.issuer.0, serial };
        let ground =
            revocations::Ground { organisation: &record.organisation, by, reason: "its attributes have changed" };
        if let Some(told) = revocations::put_revocation(ctx, &revoked, &ground)? {
            ctx.emit("revoked", &issued.serial, told);
            ctx.tell_revoked(&revoked)?;
        }
    }
    Ok(())
}

/// The owner of this certificate, by the authorities of that organisation alone. Whether it is valid at the moment is
/// not asked: clocks differ, and those who see it used look at that.
pub(super) fn verified(ctx: &Context<'_>, organisation: &str, der: &[u8]) -> Result<Identity, Rejection> {
    let authorities = organisations::find(ctx, organisation)?
        .ok_or_else(|| Rejection::new(Code::NotFound, "the network has no such organisation"))?;
    let mut msps = Msps::new();
    msps.insert(authorities.msp()?)?;
    let parsed = Certificate::parse(der)?;
    Ok(msps.verify(der, &[], ctx.block_time().clamp(parsed.not_before, parsed.not_after.max(parsed.not_before)))?)
}

/// The certificate says what is registered: a node that is behind may have issued by an older registration.
fn check_as_registered(record: &IdentityRecord, holder: &Identity, ground: Ground) -> Result<(), Rejection> {
    let local = matches!(ground, Ground::Local(_));
    if record.role == holder.role && (local || record.attributes == holder.attributes) {
        return Ok(());
    }
    let said = |role: Role, attributes: &BTreeMap<String, String>| {
        let attributes: Vec<_> = attributes.iter().map(|(key, value)| format!("{key}={value}")).collect();
        format!("role {role}, attributes {}", attributes.join(", "))
    };
    Err(Rejection::new(Code::WrongRole, format!("the certificate does not match the registration of {}", record.id()))
        .found(said(holder.role, &holder.attributes))
        .wanted(said(record.role, &record.attributes))
        .next("try again in a moment; for another role, register another name"))
}

/// Gives the secret to this key. Answers with the certificate that the same key received before.
fn take_secret(
    ctx: &Context<'_>,
    record: &mut IdentityRecord,
    presented: Hash,
    key: Hash,
    fingerprint: Hash,
) -> Result<Option<Bytes>, Rejection> {
    let now = ctx.block_time();
    let Some(secret) = record.secret.clone().filter(|secret| secret.sha256 == presented) else {
        return Err(refused("another secret than the registered one"));
    };
    let Some(used) = secret.used else {
        if now > secret.expires {
            return Err(refused("a secret that has expired"));
        }
        if let Some(maker) = &secret.maker
            && let Some(lost) = maker_lost(ctx, record, maker)?
        {
            return Err(refused(lost));
        }
        let used = Some(Use { key, fingerprint, time: now });
        record.secret = Some(Secret { used, ..secret });
        return Ok(None);
    };
    let der = ctx.get(&issued_key(&used.fingerprint));
    let revoked = record.certificate(&used.fingerprint).is_none_or(|issued| is_revoked(ctx, issued));
    let spent = ctx.get(&store::known_certificate_key(&used.fingerprint)).is_some();
    if used.key != key || revoked || spent || now.saturating_sub(used.time) > ENROLMENT_REPEAT_MAX {
        return Err(refused("a secret that was used"));
    }
    der.map(Some).ok_or_else(|| refused("a secret that was used"))
}

/// A renewal needs a certificate that is still good, and some time since the last one. Answers with the newest one if
/// it was issued for the same key.
fn check_renewal(ctx: &Context<'_>, record: &IdentityRecord, holder: &Identity) -> Result<Option<Bytes>, Rejection> {
    let now = ctx.block_time();
    let good = |issued: &&IssuedCertificate| issued.not_after >= now && !is_revoked(ctx, issued);
    let Some(newest) = record.certificates.iter().rfind(good) else {
        return Err(Rejection::new(Code::Revoked, format!("{} has no certificate that can be renewed", record.id()))
            .found("only revoked or expired certificates")
            .next("ask an admin of the organisation for a new one-time secret"));
    };
    if now.saturating_sub(newest.recorded) >= RENEWAL_PAUSE || newest.recorded == 0 {
        return Ok(None);
    }
    let der = ctx.get(&issued_key(&newest.fingerprint));
    let same = |der: &Bytes| {
        Certificate::parse(der).is_ok_and(|earlier| earlier.public_key_info == holder.public_key.to_spki())
    };
    der.filter(same).map(Some).ok_or_else(|| too_soon(&record.name))
}

/// The refusal of a renewal that comes too soon after the last one.
fn too_soon(name: &str) -> Rejection {
    Rejection::new(Code::LimitExceeded, format!("{name} received a certificate a moment ago"))
        .wanted(format!("a renewal at most once in {} s", RENEWAL_PAUSE / 1_000_000))
        .next("use that certificate, or try again in a minute")
}

/// Adds a certificate; forgets those that have expired if there are too many.
fn add(ctx: &mut Context<'_>, record: &mut IdentityRecord, issued: IssuedCertificate) -> Result<(), Rejection> {
    if record.certificates.len() >= CERTIFICATES_MAX {
        let now = ctx.block_time();
        let (kept, expired) = std::mem::take(&mut record.certificates).into_iter().partition(|c| c.not_after >= now);
        record.certificates = kept;
        let expired: Vec<IssuedCertificate> = expired;
        record.stays |= !expired.is_empty();
        expired.iter().for_each(|old| ctx.delete(&issued_key(&old.fingerprint)));
    }
    if record.certificates.len() >= CERTIFICATES_MAX {
        return Err(Rejection::new(Code::LimitExceeded, format!("{} has too many valid certificates", record.id()))
            .wanted(format!("at most {CERTIFICATES_MAX}"))
            .next("register another name, or wait until certificates expire"));
    }
    record.certificates.push(issued);
    Ok(())
}

/// A name that became known by its certificate, or at a node's own machine.
fn created(
    organisation: &str,
    name: &str,
    role: Role,
    attributes: BTreeMap<String, String>,
    by: &Identity,
) -> IdentityRecord {
    IdentityRecord {
        organisation: organisation.to_owned(),
        name: name.to_owned(),
        role,
        attributes,
        registered: 0,
        by: by.id(),
        secret: None,
        local: None,
        voided: 0,
        stays: false,
        changed: 0,
        certificates: Vec::new(),
    }
}

/// A name that a node knows from its own disk, with what it has issued: see `carry_ca`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct KnownIdentity {
    /// The name.
    pub name: String,
    /// Its role.
    pub role: Role,
    /// The attributes of its next certificate.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub attributes: BTreeMap<String, String>,
    /// A secret that can still be used there.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub secret: Option<LocalSecret>,
    /// The certificates that it has received there; `via` and `recorded` are set here.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub certificates: Vec<IssuedCertificate>,
}

/// Takes in what a node knows from its own disk: names that were registered and certificates that were issued before
/// there was a ledger, or at its own machine. Records that exist here already stay unchanged.
pub(in super::super) fn adopt(
    ctx: &mut Context<'_>,
    caller: &Identity,
    organisation: &str,
    known: KnownIdentity,
) -> Result<(), Rejection> {
    let KnownIdentity { name, role, attributes, secret, certificates } = known;
    check_name(&name).map_err(|error| Rejection::from(error).code(Code::BadArgument))?;
    check(&attributes)?;
    let before = find(ctx, organisation, &name)?;
    let mut record = match &before {
        Some(record) if record.role != role => return Ok(()),
        Some(record) => record.clone(),
        None => {
            make_room(ctx, organisation)?;
            keep_look(ctx, organisation, &name)?;
            created(organisation, &name, role, attributes, caller)
        }
    };
    for issued in certificates {
        let usable = hex::decode(&issued.serial).is_ok_and(|serial| (1..=64).contains(&serial.len()));
        if usable && record.certificate(&issued.fingerprint).is_none() {
            add(ctx, &mut record, IssuedCertificate { via: caller.id(), recorded: 0, revoked: false, ..issued })?;
        }
    }
    if let Some(secret) = secret.filter(|secret| secret.made > record.voided) {
        record.local = Some(LocalSecret { at: caller.id(), ..secret });
    }
    if before.as_ref() != Some(&record) {
        write(ctx, &record)?;
    }
    Ok(())
}

fn refused(found: &str) -> Rejection {
    Rejection::new(Code::EnrolmentRefused, "enrolment is rejected")
        .found(found)
        .wanted("a registered name and its unused one-time secret")
}
