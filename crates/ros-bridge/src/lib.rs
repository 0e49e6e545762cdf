//! The bridge joins a ROS 2 graph to the ledger.
//!
//! ROS 2 nodes stay unchanged: the bridge takes the raw CDR bytes of their messages from DDS or
//! from shared memory, and puts such bytes back on the other side. It never decodes a message, so
//! any message type works by its name alone.
//!
//! It is no DDS implementation (that is `rtps`) and no typed ROS 2 client. It decides no rights: the ledger does,
//! and on the robot's side the gate (`ledger_gate`), which the bridge drives.
//!
//! # Map
//! Each names those below it only.
//!
//! | module | what is in it |
//! |---|---|
//! | `bridge` | [`run`], [`Bridge`]: construction, running, the end; its certificate |
//! | `monitor` | log, `/diagnostics`, rogue publishers, [`BridgeMonitor`] for the program that runs it |
//! | [`config`] | `bridge.toml`: who it is, which graph it joins, its routes; [`Guarded`] |
//! | `grants` | a robot's grant from ROS: `/<robot>/acquire`, `release`, `stop` |
//! | `routes` | one topic, service or action each: `kind` says what a kind is, `kinds` is their table, a file or folder for each; `table` and `discovery` say which routes there are; `counters` |
//! | `ledger` | `gateway`, what is asked of the ledger; `robot_state`, the certified state of a robot |
//! | `graph` | ROS 2: [`dds`], `zenoh` and [`shm`], the transports; `local`, the trait that they have for a route; [`choice`]; [`names`], [`qos`], [`domain`], [`reach`], [`queue`]; [`mark`] and [`loop_filter`], which keep messages from going in circles; `messages` |
//! | [`error`], `log`, `shutdown` | what can go wrong, and what to do then; limited log messages; the end of tasks |
//!
//! # Example
//! ```no_run
//! use ros_bridge::{dds::Participant, names::{TopicName, TypeName}, qos::Qos, queue::Limits};
//!
//! # async fn example() -> Result<(), ros_bridge::error::Error> {
//! let topic = TopicName::parse("/cmd_vel")?;
//! let message = TypeName::parse("geometry_msgs/msg/Twist")?;
//! let users = Participant::open(7, "ledgerd_bridge").await?;
//! let robots = Participant::open(8, "ledgerd_bridge").await?;
//! let mut from = users.reader(&topic, &message, &Qos::default(), Limits::default())?;
//! let to = robots.writer(&topic, &message, &Qos::default())?;
//! while let Some(incoming) = from.next().await {
//!     to.write(&incoming.sample)?;
//! }
//! # Ok(()) }
//! ```

mod bridge;
pub mod config;
pub mod error;
mod grants;
mod graph;
mod ledger;
mod log;
mod monitor;
mod routes;
mod shutdown;

pub use bridge::{Bridge, Summary, keep_renewed, run};
pub use config::{Config, Guarded, IdentitySource, context_of};
pub use graph::{choice, dds, domain, environment, loop_filter, mark, messages::stop, names, qos, queue, reach, shm};
pub use monitor::{BridgeMonitor, BridgeStatus, BridgeView, Level, RouteView, Status};
pub use routes::counters::{BOUNDS_US, Latency, RouteSummary, Spread, Tally};
