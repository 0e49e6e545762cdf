//! ledger-raft.
