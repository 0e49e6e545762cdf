//! The organisations of the network and their authorities.

mod lost;

use super::REMOVE_ORGANISATION;
use super::allowance;
use super::caller::{admin, object, text};
use super::nodes;
use super::own_call::own_call;
use super::proposals::{self, decide};
use super::store::{self, ORGANISATIONS, former_key, json, organisation_key};
use super::{invitations, quorums, quotas};
use crate::chaincode::Context;
use crate::network::FoundingOrganisation;
use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::certificate::Certificate;
use ledger_identity::msp::Msps;
use ledger_identity::units::Units;
use ledger_identity::{Identity, NAME_BYTES_MAX};
use lost::lost;
use serde::{Deserialize, Serialize};

/// Most organisations of a network.
pub const ORGANISATIONS_MAX: usize = 64;

/// Answer of `organisation`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Organisation {
    /// Its name.
    pub name: String,
    /// Its roots.
    pub roots: Vec<Authority>,
    /// Its declared intermediates.
    pub intermediates: Vec<Authority>,
    /// The units that name roles in its certificates; none: our own words.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub units: Option<Units>,
}

/// A certificate authority.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Authority {
    /// SHA-256 of the certificate.
    pub fingerprint: Hash,
    /// Its subject, for people.
    pub subject: String,
    /// Start of its validity, microseconds since the UNIX epoch.
    pub not_before: u64,
    /// End of its validity, microseconds since the UNIX epoch.
    pub not_after: u64,
    /// The certificate, DER in hexadecimal.
    pub certificate: String,
}

/// All organisations, in order of names.
pub(super) fn all(ctx: &Context<'_>) -> Result<Vec<FoundingOrganisation>, Rejection> {
    store::list(ctx, ORGANISATIONS.as_bytes(), ORGANISATIONS_MAX)
}

/// Their names.
pub(super) fn names(ctx: &Context<'_>) -> Result<Vec<String>, Rejection> {
    let keys = ctx.range(ORGANISATIONS.as_bytes(), ORGANISATIONS_MAX);
    let names = keys.iter().filter_map(|(key, _)| std::str::from_utf8(key).ok()?.strip_prefix(ORGANISATIONS));
    Ok(names.map(str::to_owned).collect())
}

/// The organisation of that name.
pub(super) fn find(ctx: &Context<'_>, name: &str) -> Result<Option<FoundingOrganisation>, Rejection> {
    if name.len() > NAME_BYTES_MAX { Ok(None) } else { store::read(ctx, &organisation_key(name)) }
}

/// `organisation NAME`
pub(super) fn show(ctx: &Context<'_>, name: &Bytes) -> Result<Bytes, Rejection> {
    let name = text("organisation", "NAME", name)?;
    json(&describe(&find(ctx, name)?.ok_or_else(|| unknown(ctx, name))?)?)
}

/// The description of an organisation for people and clients.
pub(super) fn describe(organisation: &FoundingOrganisation) -> Result<Organisation, Rejection> {
    let authorities = |ders: &[Bytes]| -> Result<Vec<Authority>, Rejection> {
        let describe = |der: &Bytes| -> Result<Authority, Rejection> {
            let parsed = Certificate::parse(der)?;
            Ok(Authority {
                fingerprint: Hash::of(&[der]),
                subject: parsed.subject,
                not_before: parsed.not_before,
                not_after: parsed.not_after,
                certificate: hex::encode(der),
            })
        };
        ders.iter().map(describe).collect()
    };
    Ok(Organisation {
        name: organisation.name.clone(),
        roots: authorities(&organisation.roots)?,
        intermediates: authorities(&organisation.intermediates)?,
        units: organisation.units.clone(),
    })
}

/// Is there room for one more?
pub(super) fn check_room(ctx: &Context<'_>) -> Result<(), Rejection> {
    let found = names(ctx)?.len();
    if found < ORGANISATIONS_MAX {
        return Ok(());
    }
    Err(Rejection::new(Code::LimitExceeded, "the network has no room for another organisation")
        .found(format!("{found} organisations"))
        .wanted(format!("at most {ORGANISATIONS_MAX}")))
}

/// Adds an organisation that was invited. A name that somebody had before comes back only with one of the roots it
/// had: robots and policies on the ledger still name it.
pub(super) fn add(ctx: &mut Context<'_>, organisation: &FoundingOrganisation) -> Result<(), Rejection> {
    let name = &organisation.name;
    if find(ctx, name)?.is_some() {
        return Err(Rejection::new(
            Code::AlreadyExists,
            format!("the network has another organisation {name} already"),
        )
        .next("ask for an invitation under another name"));
    }
    check_room(ctx)?;
    if let Some(former) = store::read::<FoundingOrganisation>(ctx, &former_key(name))?
        && !organisation.roots.iter().any(|root| former.roots.contains(root))
    {
        return Err(Rejection::new(Code::AlreadyExists, format!("{name} is the name of a former organisation"))
            .found("none of the roots that it had")
            .wanted("one of its roots: robots and policies on the ledger still name it")
            .next("ask for an invitation under another name"));
    }
    trusted_with(ctx, organisation)?;
    ctx.delete(former_key(name).as_bytes());
    store::write(ctx, &organisation_key(name), organisation)
}

/// Writes an organisation with other authorities. The rights end of those for whom nobody vouches any more.
pub(super) fn replace(ctx: &mut Context<'_>, organisation: &FoundingOrganisation) -> Result<Bytes, Rejection> {
    let before = find(ctx, &organisation.name)?;
    store::write(ctx, &organisation_key(&organisation.name), organisation)?;
    let described = json(&describe(organisation)?)?;
    ctx.emit("organisation_updated", &organisation.name, described.clone());
    if let Some(before) = before {
        for issuer in lost(&before, organisation)? {
            proposals::forget_approvals(ctx, |approval| approval.issuer.0 == issuer)?;
            ctx.tell_authority_lost(&issuer)?;
        }
    }
    Ok(described)
}

/// Argument of `update_organisation`: the complete new lists.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Update {
    roots: Vec<String>,
    #[serde(default)]
    intermediates: Vec<String>,
}

/// `update_organisation {roots, intermediates}`: an organisation renews its own authorities; certificates in DER and
/// hexadecimal, the lists complete.
pub(super) fn update(ctx: &mut Context<'_>, argument: &Bytes) -> Result<Bytes, Rejection> {
    let wanted = "{\"roots\": [...], \"intermediates\": [...]}, certificates in DER and hexadecimal";
    let update: Update = object("update_organisation", argument, wanted)?;
    let caller = admin(ctx, "change the authorities of its organisation")?;
    let ders = |list: &[String]| {
        list.iter().map(|text| hex::decode(text).map(Bytes::from)).collect::<Result<Vec<_>, _>>().map_err(|error| {
            Rejection::new(Code::BadArgument, "a certificate is not usable").found(error.to_string()).wanted(wanted)
        })
    };
    let organisation = FoundingOrganisation {
        name: caller.organisation.clone(),
        roots: ders(&update.roots)?,
        intermediates: ders(&update.intermediates)?,
        // The words of the organisation stay.
        units: find(ctx, &caller.organisation)?.and_then(|known| known.units),
    };
    if organisation.roots.is_empty() {
        return Err(Rejection::new(Code::LastOne, format!("{} would have no root", organisation.name))
            .wanted("at least one root; add the new one before the old one goes"));
    }
    let msps = trusted_with(ctx, &organisation)?;
    check_not_locked_out(ctx, caller, &msps)?;
    replace(ctx, &organisation)
}

/// Argument of `remove_organisation`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RemoveOrganisation {
    /// Its name.
    pub name: String,
}

/// `remove_organisation {name}`: needs approval. Its nodes become removed, the rights of its members end in this block, and its
/// certificates count no longer behind this transaction.
pub(super) fn remove(ctx: &mut Context<'_>, argument: &Bytes) -> Result<Bytes, Rejection> {
    let remove: RemoveOrganisation = object("remove_organisation", argument, "{\"name\": NAME}")?;
    if ctx.approved_by().is_some() {
        return execute_remove(ctx, &remove.name);
    }
    let caller = admin(ctx, "remove organisations")?;
    check_removable(ctx, &remove.name)?;
    json(&decide(ctx, caller, own_call(REMOVE_ORGANISATION, &remove)?)?)
}

/// Does what was approved.
fn execute_remove(ctx: &mut Context<'_>, name: &str) -> Result<Bytes, Rejection> {
    let organisation = check_removable(ctx, name)?;
    nodes::remove_all_of(ctx, name)?;
    store::write(ctx, &former_key(name), &organisation)?;
    ctx.delete(organisation_key(name).as_bytes());
    proposals::forget_approvals(ctx, |approval| approval.organisation == name)?;
    invitations::forget_organisation(ctx, name)?;
    quorums::forget_organisation(ctx, name)?;
    allowance::forget(ctx, name);
    quotas::forget_organisation(ctx, name);
    let answer = json(&describe(&organisation)?)?;
    ctx.emit("organisation_removed", name, answer.clone());
    ctx.tell_organisation_removed(name)?;
    Ok(answer)
}

fn check_removable(ctx: &Context<'_>, name: &str) -> Result<FoundingOrganisation, Rejection> {
    let organisation = find(ctx, name)?.ok_or_else(|| unknown(ctx, name))?;
    if names(ctx)?.len() == 1 {
        return Err(Rejection::new(Code::LastOne, format!("{name} is the last organisation"))
            .wanted("another organisation, which goes on"));
    }
    Ok(organisation)
}

/// All organisations with this one as it shall be: the same checks as when the ledger reads them.
pub(super) fn trusted_with(ctx: &Context<'_>, organisation: &FoundingOrganisation) -> Result<Msps, Rejection> {
    let mut msps = Msps::new();
    let others = all(ctx)?.into_iter().filter(|other| other.name != organisation.name);
    for other in others.chain([organisation.clone()]) {
        msps.insert(other.msp()?)?;
    }
    Ok(msps)
}

/// An admin who takes away the authority that vouches for themselves could not undo it.
fn check_not_locked_out(ctx: &Context<'_>, caller: &Identity, msps: &Msps) -> Result<(), Rejection> {
    // Before ordering, the ledger may not know the certificate yet; in the block it does.
    let key = store::known_certificate_key(&Hash(caller.fingerprint));
    let Some(certificate) = ctx.get(&key) else { return Ok(()) };
    match msps.verify(&certificate, &[], ctx.block_time()) {
        Ok(_) => Ok(()),
        Err(error) => Err(Rejection::new(Code::LastOne, format!("{} would lock itself out", caller.id()))
            .found(error.to_string())
            .wanted("authorities that still vouch for the certificate in use")
            .next("enrol at the new authority first, then remove the old one with the new certificate")),
    }
}

fn unknown(ctx: &Context<'_>, name: &str) -> Rejection {
    Rejection::new(Code::NotFound, "the network has no such organisation")
        .found(format!("{:?}", name.chars().take(80).collect::<String>()))
        .wanted(format!("one of {}", names(ctx).unwrap_or_default().join(", ")))
}
