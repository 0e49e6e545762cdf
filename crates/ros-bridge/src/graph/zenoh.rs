//! The zenoh side: a graph of `rmw_zenoh`.
//!
//! `crates/ros-zenoh` speaks the convention of `rmw_zenoh`. Here are the rules of a bridge: marks, filters, and what is logged.
//!
//! - **Marks** travel as the lifespan in the quality of service of a token, as on DDS. `rmw_zenoh` compares no lifespan.
//! - **Quality of service** keeps nothing apart in zenoh. It decides what a link may lose, and whether late subscribers get old samples.
//! - **Acknowledgements** do not exist: a publisher gets no report that a subscriber has a sample.
//! - **Samples without a token.** Samples go to the ledger only while a publisher of their topic is announced in the graph.
//! - **Identifiers** of messages are hashes of tokens in `rmw_zenoh`, and in a bridge. Elsewhere they may be anything: then it is not
//!   noticed that a publisher or a client has left.
//! - **A router that is gone** takes everything with it until it comes back. The session connects again by itself.

mod client;
mod failure;
mod held;
mod matching;
mod neighbours;
mod reader;
mod server;
mod session;
mod writer;

pub(crate) use self::{client::Client, reader::Reader, server::Server, session::Session, writer::Writer};
