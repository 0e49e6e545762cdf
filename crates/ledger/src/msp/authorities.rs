//! Changes of an organisation's authorities.

mod lost;

use super::caller::{admin, object};
use super::organisations::{describe, find, trusted_with};
use super::proposals;
use super::store::{self, json, organisation_key};
use crate::chaincode::Context;
use crate::network::FoundingOrganisation;
use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::Identity;
use ledger_identity::msp::Msps;
use lost::lost;
use serde::{Deserialize, Serialize};

/// Writes an organisation with other authorities. The rights end of those for whom no authority vouches any more.
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
    let caller = admin(ctx, "change the CAs of its organisation")?;
    let ders = |list: &[String]| {
        list.iter().map(|text| hex::decode(text).map(Bytes::from)).collect::<Result<Vec<_>, _>>().map_err(|error| {
            Rejection::new(Code::BadArgument, "a certificate is not usable").found(error.to_string()).wanted(wanted)
        })
    };
    let before = find(ctx, &caller.organisation)?;
    let organisation = FoundingOrganisation {
        name: caller.organisation.clone(),
        roots: ders(&update.roots)?,
        intermediates: ders(&update.intermediates)?,
        // The words of the organisation stay.
        units: before.as_ref().and_then(|known| known.units.clone()),
    };
    if organisation.roots.is_empty() {
        return Err(Rejection::new(Code::LastOne, format!("{} would have no root certificate", organisation.name))
            .wanted("at least one root certificate; add the new one before removing the old one"));
    }
    let msps = trusted_with(ctx, &organisation)?;
    let before = before.map(|before| before.msp()).transpose()?;
    organisation.msp()?.check_entry(before.as_ref(), ctx.block_time())?;
    check_not_locked_out(ctx, caller, &msps)?;
    replace(ctx, &organisation)
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
            .wanted("CAs that still cover the certificate in use")
            .next("enrol at the new CA first, then remove the old one with the new certificate")),
    }
}
