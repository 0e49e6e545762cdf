//! RTPS 2.5 as far as ROS 2 uses it: discovery, reliable and best-effort topics, raw serialized samples.
//!
//! [`Participant`] is a state machine without sockets, threads, clocks and randomness: time, datagrams and commands go in, datagrams,
//! samples and matches come out. `io` connects it to sockets. Every limit is a constant in [`limits`].
//!
//! ```text
//! participant   step(now, input, outputs): routes datagrams and commands
//! discovery     finds participants and endpoints (SPDP, SEDP), matches them by QoS
//! reader        orders, repairs and reassembles what matched writers send
//! writer        keeps the newest samples, sends and repairs them for each matched reader
//! announcement  data of participants and endpoints as parameter lists
//! wire          datagrams and submessages as bytes
//! qos           policies that ROS 2 uses, and when they fit
//! guid, time, limits
//! io            sockets, clocks and tasks around a participant; the handles of applications
//! ```
//!
//! Source: OMG DDSI-RTPS 2.5 (formal/2022-04-01); section numbers in comments are of that document.

mod announcement;
mod discovery;
mod endpoint;
pub mod guid;
pub mod interface;
pub mod io;
pub mod limits;
mod participant;
pub mod qos;
mod reader;
pub mod time;
mod timers;
pub mod wire;
mod writer;

pub use participant::Participant;
