//! `readers`: the readers of a confidential service.

use crate::arguments::Arguments;
use crate::lifecycle::content_keys;
use crate::policy::decider::Decider;
use crate::records::reader::Entered;
use crate::records::{reader, store, target};
use bytes::Bytes;
use ledger::Context;
use ledger_base::rejection::Rejection;
use ledger_contract::{Reader, Readers};

/// `readers SERVICE`: who has entered, who of them may read now, and where the newest content keys are.
pub(crate) fn readers(ctx: &Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("readers SERVICE", args, 1, 1)?;
    let target = target::resolve(ctx, args.text(0, "SERVICE")?)?;
    let mut readers = Vec::new();
    for Entered { principal, key } in reader::all(ctx, &target.id)? {
        let may_read = content_keys::until(ctx, decider, &principal, &target)?.is_some();
        let (reader, serial) = (principal.id(), principal.serial.clone());
        readers.push(Reader { reader, key, serial, may_read });
    }
    store::json(&Readers { keys: reader::keys(ctx, &target.id)?, service: target.id, readers })
}
