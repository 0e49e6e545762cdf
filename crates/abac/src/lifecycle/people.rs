//! People by their certificates on the ledger.

use crate::records::principal::Principal;
use crate::records::store;
use bytes::Bytes;
use ledger::Context;
use ledger::msp::CertifiedHolder;
use ledger_base::rejection::Rejection;

/// The person behind a name, by its certificate on the ledger.
pub(crate) fn certified(ctx: &mut Context<'_>, id: &str) -> Result<Principal, Rejection> {
    let answer = ctx.call("msp", "holder", &[Bytes::copy_from_slice(id.as_bytes())])?;
    let holder: CertifiedHolder = store::parse(b"msp holder", &answer)?;
    let CertifiedHolder { organisation, name, role, attributes, issuer, serial, fingerprint, not_after } = holder;
    Ok(Principal { organisation, name, role, attributes, issuer, serial, fingerprint, not_after })
}
