//! Routes of topics: samples go to the ledger, or messages come from there.

pub(super) mod from_ledger;
pub(super) mod to_ledger;
