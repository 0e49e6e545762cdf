//! An organisation of another software comes in: the others approve its authorities as they are, and its people
//! count from the next block on. Nobody of it signs, and it runs no node.

use super::ADD_ORGANISATION;
use super::caller::{admin, check_name, object};
use super::invitations::check_look;
use super::organisations;
use super::own_call::own_call;
use super::proposals::{decide, is_proposed};
use super::revocation_lists::{self, Age};
use super::store::{invitation_key, json};
use crate::chaincode::Context;
use crate::network::FoundingOrganisation;
use bytes::Bytes;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::revocation_list::RevocationList;
use ledger_identity::units::Units;
use serde::{Deserialize, Serialize};

/// Most revocation lists that come along: one for each authority that there may be.
const LISTS_MAX: usize = 16;

/// Argument of `add_organisation`: certificates and lists in DER and hexadecimal.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AddOrganisation {
    /// Its name.
    pub name: String,
    /// Its roots.
    pub roots: Vec<String>,
    /// Its declared intermediates.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub intermediates: Vec<String>,
    /// The units that name roles in its certificates; without any, everybody is a member.
    pub units: Units,
    /// The newest revocation lists of its authorities.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub lists: Vec<String>,
}

/// `add_organisation {name, roots, intermediates?, units, lists?}`
pub(super) fn add(ctx: &mut Context<'_>, argument: &Bytes) -> Result<Bytes, Rejection> {
    let wanted =
        "{\"name\", \"roots\", \"intermediates\", \"units\", \"lists\"}, certificates and lists in hexadecimal";
    let add: AddOrganisation = object(ADD_ORGANISATION, argument, wanted)?;
    if let Some(approved) = ctx.approved_by() {
        return execute(ctx, &add, &approved.proposer);
    }
    let caller = admin(ctx, "add organisations")?;
    let call = own_call(ADD_ORGANISATION, &add)?;
    if !is_proposed(ctx, &call)? {
        check_lists(ctx, &add)?;
    }
    json(&decide(ctx, caller, call)?)
}

/// A proposal comes with lists of today. They may end while it waits: then they count as ended, and void nothing.
fn check_lists(ctx: &Context<'_>, add: &AddOrganisation) -> Result<(), Rejection> {
    ders(&add.lists)?
        .iter()
        .try_for_each(|der| revocation_lists::check_time(&RevocationList::parse(der)?, ctx.block_time()))
}

/// Does what was approved; a proposal is rehearsed with it as well.
fn execute(ctx: &mut Context<'_>, add: &AddOrganisation, by: &str) -> Result<Bytes, Rejection> {
    check_name(&add.name)?;
    if add.lists.len() > LISTS_MAX {
        return Err(Rejection::new(Code::BadArgument, "too many revocation lists")
            .found(add.lists.len().to_string())
            .wanted(format!("at most {LISTS_MAX}: the newest of each CA")));
    }
    if organisations::find(ctx, &add.name)?.is_none() {
        check_look(ctx, &add.name)?;
    }
    let organisation = FoundingOrganisation {
        name: add.name.clone(),
        roots: ders(&add.roots)?,
        intermediates: ders(&add.intermediates)?,
        units: Some(add.units.clone()),
    };
    organisations::add(ctx, &organisation)?;
    ctx.delete(invitation_key(&add.name).as_bytes());
    for list in ders(&add.lists)? {
        revocation_lists::take(ctx, &organisation, &list, by, Age::Any)?;
    }
    let standing = organisations::find(ctx, &add.name)?.unwrap_or(organisation);
    let answer = json(&organisations::describe(&standing)?)?;
    ctx.emit("organisation_joined", &add.name, answer.clone());
    Ok(answer)
}

fn ders(texts: &[String]) -> Result<Vec<Bytes>, Rejection> {
    texts.iter().map(|text| hex::decode(text).map(Bytes::from)).collect::<Result<_, _>>().map_err(|error| {
        Rejection::new(Code::BadArgument, "a certificate or a list is not usable")
            .found(error.to_string())
            .wanted("DER in hexadecimal")
    })
}
