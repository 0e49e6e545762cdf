//! Services of ROS 2, of which DDS knows nothing: requests go over one topic, replies over another one. A [`Server`] answers
//! on such a pair of topics, a [`Client`] calls there. Bytes go in and out as they are.
//!
//! The middlewares of ROS 2 tell in two ways to which request a reply belongs; see [`mapping`]. A server replies to each
//! client in the client's way, and a client calls in the way of the server that it finds.

mod arrival;
mod client;
mod exchange;
mod link;
mod mapping;
mod pump;
mod server;
mod waiting;

pub use self::{
    client::{Client, Number, Reply},
    exchange::Exchange,
    mapping::Caller,
    server::{Request, Server},
};
