//! The judge: replays the committed chain through a small model of access control, and asks whether everything that
//! clients saw fits it.
//!
//! The model (`model`) was written from the function table of the contract, not from its code. `replay` compares every
//! verdict of the chain, every refusal of a gateway and every read with it; `views` looks at the clients in real time.

mod model;
mod replay;
mod views;

use crate::invariant::Check;
use crate::world::World;

/// Judges a run that has ended.
///
/// # Errors
/// The contradiction.
pub fn judge(world: &mut World) -> Check {
    let (checks, coverage) = replay::replay(world)?;
    world.coverage.checks += checks;
    world.coverage.add(&coverage);
    world.coverage.checks += views::check(world)?;
    Ok(())
}
