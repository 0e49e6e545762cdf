//! Discovered routes: the robots and services on the ledger, offered on the local graph without being named in the
//! configuration.
//!
//! ```toml
//! [discover]
//! namespace = "/fleet"         # before /<robot>/<topic>; by default nothing
//! robot = "Turtlebot4"         # on a robot: only its own services, under their own topics
//! allow = { from_ledger = [".*/odom"], to_ledger = [".*/cmd_vel"] } # whole ids of services; by default all
//! deny = { from_ledger = [".*/image"] } # counts before allow
//! remap = { "Turtlebot4/cmd_vel" = "/cmd_vel" } # other local topics
//! max_rate_hz = [".*/odom=10"] # no commands to a robot; the first expression that matches counts
//! sample_bytes_max = [".*/image=2000000"]
//! ```
//! On a user's side commands are taken from the local graph while the user holds the service, and feeds are delivered
//! there while somebody listens. On a robot's side it is the other way round.
//!
//! `offer` decides, without IO, which routes there are to be. `watch` looks again whenever the ledger reports a change.

mod offer;
mod pattern;
mod settings;
mod watch;

#[cfg(test)]
mod tests;

pub(crate) use self::{offer::offered, settings::Settings, watch::Discovery};
