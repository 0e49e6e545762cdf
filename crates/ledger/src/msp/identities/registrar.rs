//! Registrars: people whom an admin lets register members of one department, with some attributes only.
//!
//! The department (affiliation) is the attribute `hf.Affiliation`, as Fabric's CA has it: `sales`, or `sales.north` below it. So
//! it stands in the certificate, and policies can name it. A registrar gives nobody more than it was let: role member, its
//! own department, and the attributes that the admin has named. A name that was revoked, or that has more, is for admins. A secret
//! of a registrar ends with its right.

use super::super::caller::{admin, bad, object, submitter};
use super::super::store::{self, json, registrar_key};
use super::{IdentityRecord, Maker, is_revoked, was_revoked};
use crate::chaincode::Context;
use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::{Identity, Role, read_attribute};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// The attribute that names somebody's department.
pub const AFFILIATION: &str = "hf.Affiliation";
/// Most registrars of one organisation.
pub const REGISTRARS_MAX: usize = 64;
/// Most attributes that a registrar may give.
const ATTRIBUTES_MAX: usize = 32;
/// Longest department or name of an attribute, in bytes.
const WORD_BYTES_MAX: usize = 128;

/// Argument of `set_registrar`, and what stands on the ledger.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SetRegistrar {
    /// Name of a member of the admin's organisation.
    pub name: String,
    /// The department whose members it may register; none takes the right away.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub affiliation: Option<String>,
    /// Names of the attributes that it may give besides.
    #[serde(default, skip_serializing_if = "BTreeSet::is_empty")]
    pub attributes: BTreeSet<String>,
}

impl SetRegistrar {
    /// The part of this that is more than it may give, and what it may give instead.
    fn excess(&self, role: Option<Role>, attributes: &BTreeMap<String, String>) -> Option<(String, String)> {
        let own = self.affiliation.as_deref().unwrap_or_default();
        if let Some(role) = role.filter(|role| *role != Role::Member) {
            return Some((format!("role {role}"), "role member".to_owned()));
        }
        let within = |department: &str| {
            department.strip_prefix(own).is_some_and(|below| below.is_empty() || below.starts_with('.'))
        };
        match attributes.get(AFFILIATION) {
            Some(department) if within(department) => {}
            Some(department) => return Some((format!("the department {department:?}"), own.to_owned())),
            None => return Some(("no department".to_owned(), own.to_owned())),
        }
        let mut names = attributes.keys().filter(|name| *name != AFFILIATION);
        let more = names.find(|name| !self.attributes.contains(*name))?;
        let may: Vec<_> = self.attributes.iter().map(String::as_str).collect();
        Some((format!("the attribute {more:?}"), format!("attributes among: {}", may.join(", "))))
    }
}

/// `set_registrar {name, affiliation?, attributes?}`
pub(in super::super) fn set(ctx: &mut Context<'_>, argument: &Bytes) -> Result<Bytes, Rejection> {
    let set: SetRegistrar = object("set_registrar", argument, "{\"name\", \"affiliation\", \"attributes\": [NAME]}")?;
    let caller = admin(ctx, "manage registrars")?;
    let organisation = caller.organisation.clone();
    let fits = |word: &String| !word.is_empty() && word.len() <= WORD_BYTES_MAX && !word.chars().any(char::is_control);
    let words = set.affiliation.iter().chain(&set.attributes).chain([&set.name]);
    if !words.clone().all(fits) || set.name.contains('/') || set.attributes.len() > ATTRIBUTES_MAX {
        return Err(bad("set_registrar", "REGISTRAR_JSON", "names of 1 to 128 bytes, at most 32 attributes"));
    }
    // A value would belong to the registered name.
    for name in &set.attributes {
        if !name.contains('=') && read_attribute(name).is_ok() {
            continue;
        }
        let question = read_attribute(name).err().map(|fault| fault.question("--attr ")).unwrap_or_default();
        return Err(bad("set_registrar", "REGISTRAR_JSON", "names of attributes, without values")
            .found(format!("{name:?}"))
            .next(question));
    }
    if set.attributes.contains(AFFILIATION) {
        return Err(bad(
            "set_registrar",
            "REGISTRAR_JSON",
            "other attributes than hf.Affiliation, which is the department",
        ));
    }
    let key = registrar_key(&organisation, &set.name);
    if set.affiliation.is_none() {
        ctx.delete(key.as_bytes());
    } else {
        let others = ctx.range(registrar_key(&organisation, "").as_bytes(), REGISTRARS_MAX);
        if others.len() >= REGISTRARS_MAX && ctx.get(key.as_bytes()).is_none() {
            return Err(Rejection::new(Code::LimitExceeded, format!("{organisation} has too many registrars"))
                .found(others.len().to_string())
                .wanted(format!("at most {REGISTRARS_MAX}"))
                .next(
                    "remove one: ledgerctl identity registrar NAME --remove; ledgerctl identity registrar lists them",
                ));
        }
        store::write(ctx, &key, &set)?;
    }
    let event = json(&set)?;
    ctx.emit("registrar_set", &format!("{organisation}/{}", set.name), event.clone());
    Ok(event)
}

/// `registrars`: of the caller's organisation.
pub(in super::super) fn registrars(ctx: &Context<'_>) -> Result<Bytes, Rejection> {
    let organisation = &admin(ctx, "read the registrars")?.organisation;
    json(&store::list::<SetRegistrar>(ctx, registrar_key(organisation, "").as_bytes(), REGISTRARS_MAX)?)
}

/// The right is gone with the name.
pub(super) fn forget(ctx: &mut Context<'_>, organisation: &str, name: &str) {
    let key = registrar_key(organisation, name);
    if ctx.get(key.as_bytes()).is_some() {
        ctx.delete(key.as_bytes());
    }
}

/// Why a secret of this registration is worth nothing any more: its maker was revoked, or may not give so much now.
pub(super) fn maker_lost(
    ctx: &Context<'_>,
    record: &IdentityRecord,
    maker: &Maker,
) -> Result<Option<&'static str>, Rejection> {
    if was_revoked(ctx, &maker.issuer, &maker.serial) {
        return Ok(Some("a secret created by an identity whose certificate was revoked"));
    }
    if !maker.registrar {
        return Ok(None);
    }
    let name = record.by.split_once('/').map_or("", |(_, name)| name);
    let bounds: Option<SetRegistrar> = store::read(ctx, &registrar_key(&record.organisation, name))?;
    let may = bounds.is_some_and(|bounds| bounds.excess(Some(record.role), &record.attributes).is_none());
    Ok(if may { None } else { Some("a secret created by an identity that may no longer register this name") })
}

/// Somebody who may register.
pub(super) struct Registering<'a> {
    /// The submitter.
    pub(super) caller: &'a Identity,
    /// Its bounds; none for an admin.
    bounds: Option<SetRegistrar>,
}

impl<'a> Registering<'a> {
    /// The submitter, if it is an admin or a registrar.
    pub(super) fn of(ctx: &Context<'a>, what: &str) -> Result<Self, Rejection> {
        let caller = submitter(ctx)?;
        if caller.role == Role::Member {
            let bounds: Option<SetRegistrar> = store::read(ctx, &registrar_key(&caller.organisation, &caller.name))?;
            if bounds.is_some() {
                return Ok(Self { caller, bounds });
            }
        }
        admin(ctx, what).map(|caller| Self { caller, bounds: None })
    }

    /// May it give this role and these attributes?
    pub(super) fn check(&self, role: Option<Role>, attributes: &BTreeMap<String, String>) -> Result<(), Rejection> {
        match self.bounds.as_ref().and_then(|bounds| bounds.excess(role, attributes)) {
            None => Ok(()),
            Some((found, wanted)) => Err(self.beyond(found, &wanted)),
        }
    }

    /// May it give a secret to this name, as far as the name's own right is concerned? A registrar becomes no other registrar, also
    /// where an admin has named one whose name is not registered yet.
    pub(super) fn check_no_right(&self, ctx: &Context<'_>, name: &str) -> Result<(), Rejection> {
        let organisation = &self.caller.organisation;
        if self.bounds.is_none() || ctx.get(registrar_key(organisation, name).as_bytes()).is_none() {
            return Ok(());
        }
        Err(self.beyond(format!("{organisation}/{name}, who is a registrar"), "a name that is not a registrar"))
    }

    /// May it give a new secret to this registered name? The secret makes its bearer that person: so a registrar gives it to those
    /// whom it has registered itself, and to no registrar. A name that was revoked comes back by an admin's word alone.
    pub(super) fn check_again(&self, ctx: &Context<'_>, known: &IdentityRecord) -> Result<(), Rejection> {
        if self.bounds.is_none() {
            return Ok(());
        }
        if known.by != self.caller.id() {
            return Err(
                self.beyond(format!("{}, registered by {}", known.id(), known.by), "a name that it registered itself")
            );
        }
        self.check_no_right(ctx, &known.name)?;
        if known.voided > 0 || known.certificates.last().is_some_and(|newest| is_revoked(ctx, newest)) {
            return Err(self.beyond(format!("{}, which was revoked", known.id()), "a name that was not revoked"));
        }
        self.check(Some(known.role), &known.attributes)
    }

    /// May it cancel this registration? A registrar takes back what it gave itself.
    pub(super) fn check_cancel(&self, known: &IdentityRecord) -> Result<(), Rejection> {
        if self.bounds.is_none() || known.by == self.caller.id() {
            return Ok(());
        }
        Err(self.beyond(format!("a registration by {}", known.by), "a registration of its own"))
    }

    /// The maker of a secret, to be kept with it.
    pub(super) fn maker(&self) -> Maker {
        let Identity { issuer, serial, .. } = self.caller;
        let (issuer, serial, registrar) = (Hash(*issuer), hex::encode(serial), self.bounds.is_some());
        Maker { issuer, serial, registrar }
    }

    fn beyond(&self, found: String, wanted: &str) -> Rejection {
        let Identity { organisation, .. } = self.caller;
        Rejection::new(Code::NotAdmin, format!("{} may only register members of its department", self.caller.id()))
            .found(found)
            .wanted(wanted.to_owned())
            .next(format!("ask an admin of {organisation}"))
    }
}
