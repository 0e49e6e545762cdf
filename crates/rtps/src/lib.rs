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
//! # Memory
//!
//! Datagrams of others make this crate keep at most:
//!
//! | for | bytes | held by |
//! |---|---|---|
//! | each other participant, at most 512, with its builtin endpoints | 48 KiB | `discovery` |
//! | each endpoint of others, at most 16 384 | 8 KiB | `discovery` |
//! | each pair of an own reader and a writer that matches it | 12 KiB | `reader` |
//! | each pair of an own writer and a reader that matches it | 2 KiB | `writer` |
//! | samples that wait for others or for fragments, of one writer | 32 MiB | [`limits::ASSEMBLY_BYTES_MAX`] |
//! | the same, of all writers of an own reader | 64 MiB | [`limits::READER_BYTES_MAX`] |
//! | the same, of all readers of a participant | 128 MiB | [`limits::PARTICIPANT_BYTES_MAX`] |
//! | announcements that wait, for each of three kinds | 16 MiB | [`limits::ANNOUNCEMENTS_BYTES_MAX`] |
//! | datagrams that wait for room in sockets | 17 MiB | `io` |
//!
//! Samples that are written take 32 MiB of each own writer ([`limits::HISTORY_BYTES_MAX`]). Samples that wait for the user of a reader
//! take what [`io::QueueLimits`] says. Putting a fragmented sample together takes its bytes once more for a moment. A test floods a
//! participant and compares the memory of its process with this table.
//!
//! Source: OMG DDSI-RTPS 2.5 (formal/2022-04-01); section numbers in comments are of that document.

pub mod announcement;
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
