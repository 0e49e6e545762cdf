//! The shared memory side: raw samples between processes of one machine, over iceoryx2.
//!
//! # Contract with local processes
//! - **Service**: publish-subscribe of `[u8]`, named like the DDS topic: `rt/cmd_vel` in domain 0 and `domainN/rt/…` in
//!   domain N. Shared memory has no domains, and two graphs on one machine must not meet behind the ledger's back. The
//!   payload is the sample with its encapsulation header, byte for byte what DDS carries ([`Sample::wire`]).
//! - **User header**: 32 bytes, `[u8; 32]`, so that no padding and no byte order is left to the compiler. They are
//!   `origin` (16, the publisher), `sequence` (8, little endian, counts from 1) and `mark` (8, little endian). A
//!   process that publishes by itself takes any origin that is unique, best random; zero is allowed and stands for
//!   "unknown". Its mark is zero: others are set by bridges on what came from the ledger ([`Mark::nanos`]).
//! - **Name of the node**: any; that of a bridge ends with `@` and its origin, so that bridges of one service know each
//!   other. Everybody else who publishes where a bridge delivers commands is reported as a side filter.
//! - **Event service** of the same name: notify it after each publication, wait on it for news.
//! - A bridge drops what carries its own origin, or the mark of its network, so nothing goes in circles.
//! - All processes run as the same user, and use the same directory ([`config`]): iceoryx2's own is open to all users. The first one to open a service sets its limits; ours are [`PUBLISHERS_MAX`],
//!   [`SUBSCRIBERS_MAX`], [`BUFFER_SAMPLES`]. A bridge takes a service as others have opened it, with any limits. It
//!   needs room for one publisher, subscriber, notifier or listener of its own.
//!
//! The remains of a killed process are removed when the next node starts or opens a service. Two processes that do so
//! at the same time can disturb each other, so opening is tried several times.
//!
//! iceoryx2 would take over SIGINT and SIGTERM; that is switched off. Arrays of bytes are sendable without any
//! `unsafe`, which is the other reason for the plain header.

mod attempt;
mod directory;
mod header;
mod node;
mod peers;
mod publisher;
mod service;
mod subscriber;

pub(crate) use self::peers::{Peers, Publisher as OtherPublisher, bridge_name};
pub use self::{
    directory::config,
    node::Node,
    publisher::Publisher,
    service::{BUFFER_SAMPLES, PUBLISHERS_MAX, SUBSCRIBERS_MAX},
    subscriber::Subscriber,
};
