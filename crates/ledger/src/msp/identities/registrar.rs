//! Registrars: people whom an admin lets register members of one department, with some attributes only.
//!
//! The department (affiliation) is the attribute `hf.Affiliation`, as Fabric's CA has it: `sales`, or `sales.north` below it. So
//! it stands in the certificate, and policies can name it. A registrar gives nobody more than it was let: role member, its
//! own department, and the attributes that the admin has named. A name that was revoked, or that has more, is for admins.

use super::super::caller::{admin, bad, object, submitter};
use super::super::store::{self, json, registrar_key};
use super::{IdentityRecord, is_revoked};
use crate::chaincode::Context;
use bytes::Bytes;
use ledger_identity::{Identity, Role};
use ledger_rejection::{Code, Rejection};
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

/// `set_registrar {name, affiliation?, attributes?}`
pub(in super::super) fn set(ctx: &mut Context<'_>, argument: &Bytes) -> Result<Bytes, Rejection> {
    let set: SetRegistrar = object("set_registrar", argument, "{\"name\", \"affiliation\", \"attributes\": [NAME]}")?;
    let caller = admin(ctx, "name registrars")?;
    let organisation = caller.organisation.clone();
    let fits = |word: &String| !word.is_empty() && word.len() <= WORD_BYTES_MAX && !word.chars().any(char::is_control);
    let words = set.affiliation.iter().chain(&set.attributes).chain([&set.name]);
    if !words.clone().all(fits) || set.name.contains('/') || set.attributes.len() > ATTRIBUTES_MAX {
        return Err(bad("set_registrar", "REGISTRAR_JSON", "names of 1 to 128 bytes, at most 32 attributes"));
    }
    if set.attributes.contains(AFFILIATION) {
        return Err(bad(
            "set_registrar",
            "REGISTRAR_JSON",
            "other attributes than hf.Affiliation, which the department is",
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
                .next("ledgerctl identity registrar shows them; --remove takes the right away"));
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
    if ctx.rules().has_registrars() && ctx.get(key.as_bytes()).is_some() {
        ctx.delete(key.as_bytes());
    }
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
        if caller.role == Role::Member && ctx.rules().has_registrars() {
            let bounds: Option<SetRegistrar> = store::read(ctx, &registrar_key(&caller.organisation, &caller.name))?;
            if bounds.is_some() {
                return Ok(Self { caller, bounds });
            }
        }
        admin(ctx, what).map(|caller| Self { caller, bounds: None })
    }

    /// May it give this role and these attributes?
    pub(super) fn check(&self, role: Option<Role>, attributes: &BTreeMap<String, String>) -> Result<(), Rejection> {
        let Some(bounds) = &self.bounds else { return Ok(()) };
        let own = bounds.affiliation.as_deref().unwrap_or_default();
        if let Some(role) = role.filter(|role| *role != Role::Member) {
            return Err(self.beyond(format!("role {role}"), "role member"));
        }
        let within = |department: &str| {
            department.strip_prefix(own).is_some_and(|below| below.is_empty() || below.starts_with('.'))
        };
        match attributes.get(AFFILIATION) {
            Some(department) if within(department) => {}
            Some(department) => return Err(self.beyond(format!("the department {department:?}"), own)),
            None => return Err(self.beyond("no department".to_owned(), own)),
        }
        let mut names = attributes.keys().filter(|name| *name != AFFILIATION);
        match names.find(|name| !bounds.attributes.contains(*name)) {
            None => Ok(()),
            Some(more) => {
                let may: Vec<_> = bounds.attributes.iter().map(String::as_str).collect();
                Err(self.beyond(format!("the attribute {more:?}"), &format!("attributes among: {}", may.join(", "))))
            }
        }
    }

    /// May it give a new secret to this registered name? The secret makes its bearer that person: so a registrar gives it to those
    /// whom it has registered itself, and to no registrar. A name that was revoked comes back by an admin's word alone.
    pub(super) fn check_again(&self, ctx: &Context<'_>, known: &IdentityRecord) -> Result<(), Rejection> {
        if self.bounds.is_none() {
            return Ok(());
        }
        if known.by != self.caller.id() {
            return Err(
                self.beyond(format!("{}, whom {} registered", known.id(), known.by), "a name that it registered")
            );
        }
        if ctx.get(registrar_key(&known.organisation, &known.name).as_bytes()).is_some() {
            return Err(self.beyond(format!("{}, who is a registrar", known.id()), "a name without that right"));
        }
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

    fn beyond(&self, found: String, wanted: &str) -> Rejection {
        let Identity { organisation, .. } = self.caller;
        Rejection::new(Code::NotAdmin, format!("{} may register members of its department only", self.caller.id()))
            .found(found)
            .wanted(wanted.to_owned())
            .next(format!("ask an admin of {organisation}"))
    }
}
