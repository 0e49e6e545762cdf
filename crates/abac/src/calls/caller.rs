//! `GetSubmittingClientIdentity`: the caller.

use crate::arguments::Arguments;
use crate::records::store;
use bytes::Bytes;
use ledger::Context;
use ledger_base::rejection::Rejection;
use ledger_identity::Role;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Answer of `GetSubmittingClientIdentity`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Caller {
    /// `Org1/Salma`.
    pub id: String,
    /// The organisation whose CA vouches for the caller.
    pub organisation: String,
    /// The name in the certificate.
    pub name: String,
    /// The role in the certificate.
    pub role: Role,
    /// The attributes in the certificate.
    pub attributes: BTreeMap<String, String>,
    /// The certificate's serial number, hexadecimal.
    pub serial: String,
    /// When the certificate expires (microseconds since the UNIX epoch).
    pub not_after: u64,
}

/// `GetSubmittingClientIdentity`
pub(crate) fn caller(ctx: &Context<'_>, args: &[Bytes]) -> Result<Bytes, Rejection> {
    Arguments::new("GetSubmittingClientIdentity", args, 0, 0)?;
    let submitter = ctx.submitter()?;
    store::json(&Caller {
        id: submitter.id(),
        organisation: submitter.organisation.clone(),
        name: submitter.name.clone(),
        role: submitter.role,
        attributes: submitter.attributes.clone(),
        serial: hex::encode(&submitter.serial),
        not_after: submitter.not_after,
    })
}
