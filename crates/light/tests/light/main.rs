//! The beliefs of a light client, and its doubts.
#![expect(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing, reason = "tests")]

mod believing;
mod branches;
mod flips;
mod governing;
mod hostile;
mod made;
mod python;
mod scenes;
mod strict;
mod sworn;
mod vectors;
mod ways;
mod world;
