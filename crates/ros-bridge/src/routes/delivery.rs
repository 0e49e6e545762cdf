//! From the ledger to the local graph, through the gate.
//!
//! Subscribed from now on: commands of the past are nobody's. A connection that broke is resumed where it was cut
//! off, and what is then too old stays out.
//!
//! How the robot stands is asked when it may have changed, and while somebody moves it. A message of which the gate knows
//! nothing yet waits for the answer.

mod blocks;
mod demand;
mod half;
mod points;
mod reader_keys;
mod rogue_publishers;
mod route;
mod settings;
mod stop_messages;

pub(super) use self::{
    half::half,
    points::KEYS as POINT_KEYS,
    rogue_publishers::NAME as ROGUE_PUBLISHERS_KEY,
    route::{FromLedger, Outputs},
    settings::{STALE_AFTER, STALE_KEY, Settings, stale_after},
    stop_messages::command_timeout,
};
