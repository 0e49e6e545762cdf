//! The organisations of the network and their authorities.

use super::caller::text;
use super::store::{self, ORGANISATIONS, former_key, json, organisation_key};
use crate::chaincode::Context;
use crate::network::FoundingOrganisation;
use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::NAME_BYTES_MAX;
use ledger_identity::certificate::Certificate;
use ledger_identity::msp::Msps;
use ledger_identity::units::Units;
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
    Err(Rejection::new(Code::LimitExceeded, "the network has reached its limit of organisations")
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
            format!("the network already has another organisation {name}"),
        )
        .next("join under another name"));
    }
    check_room(ctx)?;
    let former: Option<FoundingOrganisation> = store::read(ctx, &former_key(name))?;
    if let Some(former) = &former
        && !organisation.roots.iter().any(|root| former.roots.contains(root))
    {
        return Err(Rejection::new(Code::AlreadyExists, format!("{name} was the name of a former organisation"))
            .found("none of its root certificates")
            .wanted("one of its root certificates: robots and policies on the ledger still name it")
            .next("join under another name"));
    }
    trusted_with(ctx, organisation)?;
    organisation.msp()?.check_entry(None, ctx.block_time())?;
    if let Some(former) = &former {
        organisation.msp()?.check_spelling(&former.msp()?)?;
    }
    ctx.delete(former_key(name).as_bytes());
    store::write(ctx, &organisation_key(name), organisation)
}

/// All organisations.
pub(super) fn trusted(ctx: &Context<'_>) -> Result<Msps, Rejection> {
    msps(all(ctx)?)
}

/// All organisations with this one as it shall be: the same checks as when the ledger reads them.
pub(super) fn trusted_with(ctx: &Context<'_>, organisation: &FoundingOrganisation) -> Result<Msps, Rejection> {
    let others = all(ctx)?.into_iter().filter(|other| other.name != organisation.name);
    msps(others.chain([organisation.clone()]))
}

fn msps(organisations: impl IntoIterator<Item = FoundingOrganisation>) -> Result<Msps, Rejection> {
    let mut msps = Msps::new();
    for organisation in organisations {
        msps.insert(organisation.msp()?)?;
    }
    Ok(msps)
}

/// The rejection of a name that no organisation has.
pub(super) fn unknown(ctx: &Context<'_>, name: &str) -> Rejection {
    Rejection::new(Code::NotFound, "the network has no such organisation")
        .found(format!("{:?}", name.chars().take(80).collect::<String>()))
        .wanted(format!("one of {}", names(ctx).unwrap_or_default().join(", ")))
}
