//! From the local graph to the ledger: every sample becomes a signed transaction, in the order in which they came.
//!
//! Nothing waits for an earlier verdict, and no batch waits to be filled. When the ledger is slower than the topic,
//! the newest samples replace the oldest that wait, and that is counted. A command that has waited for longer than its service
//! allows is dropped, and counted: with a signature it would be new.

mod half;
mod key_sharing;
mod latch;
mod own_grant;
mod route;
mod settings;

pub(super) use self::{
    half::half,
    latch::KEYS as LATCH_KEYS,
    route::{LEFT_OUT, TOO_OLD, ToLedger},
    settings::{BATCH_KEY, Settings},
};
