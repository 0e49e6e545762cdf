//! The caller, their rights, and their arguments.

use super::store::organisation_key;
use crate::chaincode::Context;
use bytes::Bytes;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::{Identity, Role};
use serde::de::DeserializeOwned;

/// The submitter, if their organisation still belongs to the network. A block that removes an organisation may hold
/// transactions of its members behind that. Every chaincode refuses them.
pub(super) fn submitter<'a>(ctx: &Context<'a>) -> Result<&'a Identity, Rejection> {
    let caller = ctx.submitter()?;
    if ctx.get(organisation_key(&caller.organisation).as_bytes()).is_some() {
        return Ok(caller);
    }
    Err(Rejection::new(Code::Untrusted, format!("{} belongs to no organisation of this network", caller.id()))
        .found(format!("{}, which was removed", caller.organisation)))
}

/// The submitter, if they are an admin.
pub(super) fn admin<'a>(ctx: &Context<'a>, what: &str) -> Result<&'a Identity, Rejection> {
    let caller = submitter(ctx)?;
    if caller.role == Role::Admin {
        return Ok(caller);
    }
    Err(Rejection::new(Code::NotAdmin, format!("{} may not {what}", caller.id()))
        .found(format!("role {}", caller.role))
        .wanted(format!("an admin of {}", caller.organisation)))
}

/// The submitter, if they are a node.
pub(super) fn node<'a>(ctx: &Context<'a>, what: &str) -> Result<&'a Identity, Rejection> {
    let caller = submitter(ctx)?;
    if caller.role == Role::Node {
        return Ok(caller);
    }
    Err(Rejection::new(Code::WrongRole, format!("{} may not {what}", caller.id()))
        .found(format!("role {}", caller.role))
        .wanted("role node: nodes call this automatically"))
}

/// An argument that is a JSON object.
pub(super) fn object<T: DeserializeOwned>(function: &str, argument: &Bytes, wanted: &str) -> Result<T, Rejection> {
    serde_json::from_slice(argument).map_err(|error| {
        Rejection::new(Code::BadArgument, format!("the argument of msp {function} is not usable"))
            .found(error.to_string())
            .wanted(format!("JSON: {wanted}"))
    })
}

/// An argument that is text.
pub(super) fn text<'a>(function: &str, name: &str, argument: &'a Bytes) -> Result<&'a str, Rejection> {
    std::str::from_utf8(argument)
        .ok()
        .filter(|text| !text.is_empty() && text.len() <= 512)
        .ok_or_else(|| bad(function, name, "text of 1 to 512 bytes"))
}

/// The refusal of an argument.
pub(super) fn bad(function: &str, name: &str, wanted: &str) -> Rejection {
    Rejection::new(Code::BadArgument, format!("argument {name} of msp {function} is not usable"))
        .wanted(wanted.to_owned())
}

/// Checks the name of an organisation or a node.
pub(super) fn check_name(name: &str) -> Result<(), Rejection> {
    ledger_identity::check_name(name).map_err(|error| Rejection::from(error).code(Code::BadName))
}
