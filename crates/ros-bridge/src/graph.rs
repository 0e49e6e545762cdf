//! The local graph: topics, services and actions of ROS 2 over DDS, and beside it over shared memory.
//!
//! [`dds`] and [`shm`] are the transports, [`local`] is the bridge's presence on both of them. The rest is what they share.

pub(crate) mod addresses;
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
