//! `check`: the faults of a policy, or its meaning.

use crate::arguments::Arguments;
use crate::calls::question::ASK_BYTES_MAX;
use crate::policy::decider::Decider;
use crate::records::store;
use bytes::Bytes;
use ledger_base::rejection::Rejection;

/// `check TEXT`: the faults of a policy with their places; if it is acceptable, the meaning of each policy in words.
pub(crate) fn check(decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("check TEXT", args, 1, 1)?;
    store::json(&decider.diagnose(args.document(0, "TEXT", ASK_BYTES_MAX)?))
}
