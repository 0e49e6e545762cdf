//! The simulation under test: it finds nothing in the product, and every deliberate bug.

mod invariants;
mod mutations;
mod seeds;
