//! The local graph: topics, services and actions of ROS 2 over DDS or zenoh, and beside it over shared memory.
//!
//! [`dds`], `zenoh` and [`shm`] are the transports, [`local`] is the bridge's presence on them, behind one trait. The rest is what they
//! share.

pub(crate) mod addresses;
pub mod choice;
pub mod dds;
pub mod domain;
pub(crate) mod endpoint;
pub mod environment;
pub(crate) mod local;
pub mod loop_filter;
pub mod mark;
pub(crate) mod messages;
pub mod names;
pub mod qos;
pub mod queue;
pub mod reach;
pub mod shm;
#[cfg(feature = "zenoh")]
pub(crate) mod zenoh;
