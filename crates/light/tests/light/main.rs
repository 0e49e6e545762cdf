//! The beliefs of a light client, and its doubts.
#![expect(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing, reason = "tests")]

mod believing;
mod governing;
mod hostile;
mod vectors;
mod world;
