//! The commands of `ledgerd` besides `run`.
//!
//! | module | content |
//! |---|---|
//! | `setup`, `join` | founding a network; joining one |
//! | `backup`, `recover` | backup and restore; forced recovery |
//! | `ca_commands` | secrets for admins; copying and restoring a CA |
//! | `verify`, `prove` | verifying a chain offline; proofs about policies |
//! | `dev`, `lab`, `demo` | a network of one node for trying out; one of several nodes; the paper's experiment |
//! | `child` | processes that `lab` and `demo` start |

pub(crate) mod backup;
pub(crate) mod ca_commands;
mod child;
pub mod demo;
pub(crate) mod dev;
pub(crate) mod join;
pub(crate) mod lab;
pub(crate) mod prove;
pub(crate) mod recover;
pub mod setup;
pub(crate) mod verify;
