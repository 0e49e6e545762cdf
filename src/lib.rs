//! ledgerd.
