//! Organisations that lie: their nodes run twice, with one key, and each copy talks to another part of the network.
//!
//! A copy follows the product's rules, so it does everything that two honest nodes may do: it stands for election,
//! votes, leads, acknowledges, states. Together the copies do what one node must not: they vote twice in a term, lead with
//! two logs, acknowledge two chains, sign two blocks of one height, forget. The parts change in the middle, so that honest
//! nodes meet the other story. Source of the method: S. Bano et al., "Twins: BFT Systems Made Robust", OPODIS 2021. Beside that,
//! a liar sends what no copy would: forged proofs, branches, transfers, complaints, acknowledgements; and it withholds control
//! calls while it leads.
//!
//! Two robots have the real gate ([`bridges`]), at nodes of which some lie: [`control`] knows what may pass.
//!
//! The real parts are the replica, the gate, the certifier, the disputes, the comparison of chains, the block store and the ledger. Nobody
//! lies but those organisations, so honest nodes may part ways, and one chain of truth is not known in advance. So the
//! [`judge`] has its own arithmetic over everything that anybody has signed.
//!
//! | what happens | when |
//! |---|---|
//! | the network begins | the first 3 s |
//! | the liars' nodes are copied, with their disks | then; in calm seeds they are not, and only send what is forged |
//! | parts change, honest nodes crash, links between parts are cut | 10 to 20 s |
//! | the liars are gone, or go on with one story | then everything heals; contradicted nodes rejoin, as they say |
//! | the last word | the voters that are left serve and certify, if enough of them have one history; proved liars lose their votes |

mod bridges;
mod cast;
mod control;
mod copy;
mod judge;
mod mischief;
mod operator;
mod peers;
mod plan;
mod removal;
mod threads;
mod world;

pub use judge::Counts;
pub use plan::Plan;

use crate::clock::{MILLISECOND, SECOND};
use crate::invariant::{Check, Violation};
use crate::seeds::{Report, violation};
use std::sync::Arc;
use world::World;

pub use cast::Cast;

/// After the liars are gone, the rest must serve within this time.
const HEAL_MAX: u64 = 90 * SECOND;

/// Runs one seed.
pub fn run(seed: u64, cast: &Arc<Cast>, keep_trace: bool) -> Report<Counts> {
    let mut world = World::new(seed, cast, keep_trace);
    let violation = violation(seed, || play(&mut world));
    if let Some(violation) = &violation {
        world.note(format_args!("violation: {violation}"));
    }
    let counts = world.counts();
    let trace = world.trace.text().map(str::to_owned);
    Report { seed, violation, counts, trace_hash: world.trace.hash(), trace }
}

fn play(world: &mut World) -> Check {
    world.run_until(world.plan.begins - SECOND)?;
    if !world.plan.calm {
        world.lead()?;
    }
    world.run_until(world.plan.begins)?;
    world.begin_to_lie()?;
    world.run_until(world.plan.ends)?;
    world.end_lies()?;
    let deadline = world.now + HEAL_MAX;
    while !world.is_healed()? {
        if world.now >= deadline {
            return Err(Violation::new("the network serves again", world.describe()));
        }
        world.run_until(world.now + 100 * MILLISECOND)?;
    }
    world.look_back()?;
    world.remove_liars()
}
