//! The simulation under test: it finds nothing in the product, and every deliberate bug.

mod invariants;
mod liars;
mod mutations;
mod seeds;
