//! ledger-abac.
