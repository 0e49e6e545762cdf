//! Members of the network, and the decisions about them: each test fails if its rule is taken away.
#![expect(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing, reason = "tests")]

mod approvals;
mod attestations;
mod certificates;
mod identities;
mod imported;
mod lists;
mod model;
mod nodes;
mod organisations;
mod proposals;
mod quotas;
mod refusals;
mod registrars;
mod rules;
mod world;
