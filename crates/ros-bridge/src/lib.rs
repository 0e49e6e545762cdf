//! The bridge joins a ROS 2 graph to the ledger.
//!
//! ROS 2 nodes stay unchanged: the bridge takes the raw CDR bytes of their messages from DDS or
//! from shared memory, and puts such bytes back on the other side. It never decodes a message, so
//! any message type works by its name alone.
//!
//! It is no DDS implementation (that is `rustdds`) and no typed ROS 2 client. It decides no rights: the ledger does,
//! and on the robot's side the gate (`ledger_gate`), which the bridge drives.
//!
//! # Map
//! | module | what is in it |
//! |---|---|
//! | `bridge` | [`run`], [`Bridge`]: a running bridge and its summary |
//! | [`config`] | what it is told to do |
//! | `table`, `discover` | which routes there are to be: set, read again, or discovered on the ledger |
//! | `keeper`, `roster` | keeps them open; how they stand |
//! | `route` | one topic of one service: `kind`, the table of kinds; a file for each; `local`, their side of the graph |
//! | `grants` | a robot's grant from ROS: `/<robot>/acquire`, `release`, `stop` |
//! | `guarded` | [`Guarded`]: where in the graph of a robot nobody but a bridge should publish |
//! | `gateway`, `service` | what is asked of the ledger, and what it answers |
//! | `standing` | asks how a robot stands |
//! | `count`, `report` | what a route has done; what the bridge says about itself |
//! | [`sight`] | the bridge as whoever watches it sees it |
//! | [`domain`], [`reach`], `addresses` | which ROS domain it joins, with which hosts, and when it must do so anew |
//! | [`mark`], [`door`] | bridges of a network know each other; what came from the ledger does not enter again |
//! | [`names`] | topic and type names: checked, and mapped to what DDS calls them |
//! | [`qos`] | the quality-of-service settings of a route |
//! | [`dds`] | participant, reader and writer of a ROS domain |
//! | [`shm`] | publisher and subscriber over iceoryx2 shared memory |
//! | [`queue`] | the queue between them and whoever takes the samples, limited in bytes |
//! | [`stop`] | the message that makes a robot stand still |
//! | [`error`] | everything that can go wrong, and what to do then |
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

mod addresses;
mod bridge;
pub mod config;
mod count;
pub mod dds;
mod discover;
pub mod domain;
pub mod door;
pub mod error;
#[cfg(test)]
mod fake;
mod fit;
mod gateway;
mod grants;
mod guarded;
mod keeper;
pub mod mark;
pub mod names;
mod place;
pub mod qos;
pub mod queue;
pub mod reach;
mod renewal;
mod report;
mod roster;
mod route;
mod service;
pub mod shm;
pub mod sight;
mod standing;
pub mod stop;
mod table;
mod typed;

pub use bridge::{Bridge, Summary, context_of, run};
pub use config::{Config, IdentitySource};
pub use count::{BOUNDS_US, Latency, RouteSummary, Spread};
pub use gateway::Tally;
pub use guarded::Guarded;
pub use renewal::keep_renewed;
pub use report::{Level, Status};
