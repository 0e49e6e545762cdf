//! ledger-api.
