//! The DDS side: one participant per ROS domain, readers and writers of raw CDR.
//!
//! `crates/rtps` speaks the protocol. Here are the rules of a bridge: marks, filters, names of ROS 2, and what is logged.
//!
//! - **Interfaces.** A participant uses every interface that has an IPv4 address, `lo` included. IPv6 is not used.
//! - **Without multicast** (a network namespace with only `lo`, many containers) it still announces itself to the first
//!   participants of the domain on `127.0.0.1`. A CycloneDDS peer is found if it listens there: interface `lo`, multicast off, peer
//!   `127.0.0.1`, participant index `auto`. There is nothing to set on our side.
//! - **A DDS writer offers one version of CDR.** [`Writer`] opens a second one when the first sample of XCDR2 comes; samples written
//!   before readers matched that one are lost, as at any start.
//! - **Volatile readers.** Where all processes have one clock, [`Reader`] passes over what was written before it was opened. Elsewhere
//!   `rtps` gives up what a writer has at first.
//! - **A crashed peer** stays matched until its lease ends (CycloneDDS 10 s, a bridge 6 s). Nothing waits for it.
//! - **Other hosts.** Datagrams of other hosts are dropped by their source address ([`crate::graph::reach`]).
//! - **Large messages** go in bursts with pauses. Fast DDS has receive buffers of 200 kB, and needs larger ones for what others than
//!   we send to it.
//!
//! Reading and writing never block. Everything here must be called inside a tokio runtime.

mod calls;
mod encoding;
mod failure;
mod intake;
mod matched;
mod neighbours;
mod participant;
mod reader;
mod remedy;
mod ros_discovery;
mod writer;

pub use self::{
    calls::{Caller, Client, Exchange, Number, Reply, Request, Server},
    matched::{Matched, Matching},
    neighbours::{Change, Neighbour},
    participant::Participant,
    reader::Reader,
    writer::Writer,
};
pub(crate) use self::{encoding::accepting, neighbours::UNREACHABLE, participant::LEASE};
#[cfg(feature = "zenoh")]
pub(crate) use self::{intake::Intake, ros_discovery::node_name};
pub use super::{domain::DOMAIN_MAX, endpoint::Role};
