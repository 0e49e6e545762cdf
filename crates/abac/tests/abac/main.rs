//! The access-control chaincode, called as a node calls it: through the registry, block by block.
#![expect(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::indexing_slicing,
    reason = "tests stop at the first surprise"
)]

mod agreements;
mod approvals;
mod arguments;
mod attributes;
mod bad_input;
mod budgets;
mod bytes;
mod can;
mod confidential;
mod confirmation;
mod crowds;
mod delegation;
mod emergency;
mod examples;
mod fleet;
mod following;
mod grants;
mod impossible;
mod interleavings;
mod limits;
mod model;
mod open;
mod paper;
mod policies;
mod properties;
mod publishing;
mod readers;
mod reads;
mod reconciling;
mod rights;
mod robots;
mod settings;
mod shares;
mod sharing;
mod side_door;
mod starving;
mod task_ends;
mod tasks;
mod together;
mod versions;
