//! A graph of `rmw_zenoh` without types: keys, liveliness tokens, attachments, and raw samples over a zenoh session.
//!
//! ROS 2 over zenoh is a convention. Topics are keys with the hash of their type, and services are queries. Each node, publisher,
//! subscriber, server and client declares a token that names it. This crate follows the convention of `rmw_zenoh_cpp` for ROS 2 Jazzy
//! and later. It knows nothing of messages, which are bytes here, and nothing of a ledger.
//!
//! The session is that of `ros2-client`, which joins the graph. Its own publishers and subscribers are typed, so they are not used.
//!
//! Peers may be hostile. Lengths are checked before anything is copied, and what is remembered of others is bounded ([`limits`]).
//!
//! | module | what is there |
//! |---|---|
//! | [`limits`] | the most that is accepted from others |
//! | [`qos`], [`token`] | liveliness tokens, and the quality of service in them |
//! | [`key`] | keys of topics and services |
//! | [`attachment`] | sequence number, time and source of a message |
//! | [`settings`] | endpoints, mode and TLS of a session |
//! | `gid`, `graph` | identifiers of endpoints; the endpoints that are there (feature `session`) |
//! | `node` | a session as a ROS 2 node (feature `session`) |
//! | `publisher`, `subscriber`, `client`, `server` | its endpoints (feature `session`) |

pub mod attachment;
#[cfg(feature = "session")]
pub mod client;
#[cfg(feature = "session")]
mod endpoint;
#[cfg(feature = "session")]
pub mod error;
#[cfg(feature = "session")]
pub mod gid;
#[cfg(feature = "session")]
pub mod graph;
pub mod key;
pub mod limits;
#[cfg(feature = "session")]
pub mod node;
#[cfg(feature = "session")]
pub mod publisher;
pub mod qos;
#[cfg(feature = "session")]
pub mod server;
pub mod settings;
#[cfg(feature = "session")]
pub mod subscriber;
pub mod token;
