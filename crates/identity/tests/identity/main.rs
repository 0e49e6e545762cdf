//! Identities: keys, certificates, and whom a network believes.
#![expect(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]

mod authority;
mod certificates;
mod hostile;
mod keys;
mod lists;
mod openssl;
mod units;
mod verification;
