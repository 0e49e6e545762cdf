//! Members of the network, and the decisions about them: each test fails if its rule is taken away.
#![expect(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]

#[path = "../authority/mod.rs"]
mod authority;

mod approvals;
mod attestations;
mod identities;
mod nodes;
mod organisations;
mod rules;
mod world;
