//! The DDS side: one participant per ROS domain, readers and writers of raw CDR.
//!
//! # What was found out about RustDDS
//! - **Interfaces.** It uses every interface that has an IPv4 address, `lo` included, and joins the
//!   discovery group on those that can do multicast. IPv6 is not used.
//! - **Without multicast** (a network namespace with only `lo`, many containers) it still announces itself to the first
//!   12 participants of the domain. It does so on `127.0.0.1`, UDP port 7410 + 250 · domain + 2 · index. A CycloneDDS
//!   peer is found if it listens there: interface `lo`, multicast off, peer `127.0.0.1`, participant index `auto`.
//!   There is nothing to set on our side.
//! - **Options of the encapsulation header** were dropped on reading and zero on writing. CycloneDDS puts the count of padding
//!   bytes there, which readers of XCDR2 need. The copy hands them over.
//! - **A DDS writer has one encoding.** [`Writer`] opens a second one when the first sample of
//!   another byte order, or of XCDR2, comes; samples written before readers matched that one are lost, as at any
//!   start.
//! - **History is counted in samples**, and kept per topic after reading: `depth` times the largest
//!   message is the memory of a topic. The bytes that wait for us are limited by [`crate::graph::queue`].
//! - **Volatile readers** requested what a latched writer keeps, and got it as new. Where all processes have one clock, [`Reader`]
//!   passes over what was written before it was opened. Elsewhere the copy gives up what a writer has at first.
//! - **A crashed peer** stays matched until its lease ends (CycloneDDS 10 s, a bridge 6 s). For it, as for a slow one, a
//!   writer of the copy keeps the last samples of its depth, and at most 32 MiB: newer ones replace them. The original
//!   keeps what one reader has not acknowledged, and then writes for nobody.
//! - **A process that was stopped and continues** (SIGSTOP and SIGCONT, a debugger) lost its DDS: the threads that wait
//!   for the sockets took the interruption for a failure. The copy of RustDDS in `vendor` goes on. Should such a thread
//!   end all the same, readers and writers notice it within a second: [`Matched::ended`].
//! - **Other hosts.** Interfaces alone close no filter: its unicast sockets are bound to all addresses. The copy drops
//!   datagrams of other hosts by their source address, and keeps multicasts on this host ([`crate::graph::reach`]).
//! - **Large messages** go in bursts with pauses, and lost fragments are sent again at once: the copy does so. Fast DDS has
//!   receive buffers of 200 kB, and needs larger ones for what others than we send to it.
//!
//! Creating a participant takes tens of milliseconds and two threads; reading and writing never
//! block. Everything here must be called inside a tokio runtime.

mod calls;
mod encoding;
mod failure;
mod guid;
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
pub(crate) use self::{encoding::accepted, participant::LEASE};
pub use super::{domain::DOMAIN_MAX, endpoint::Role};
