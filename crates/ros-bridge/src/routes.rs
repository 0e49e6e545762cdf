//! Routes: one topic of one service. Each is a task of its own; its decisions are in parts without IO.
//!
//! A kind of route says what it is ([`kind`]), is a file of its own below `topics`, `services` or `actions`, and is listed in one
//! table ([`kinds`]). All of them go to the ledger through `submission`, and come from there through `delivery` and its gate.
//! [`table`] holds the routes that a bridge has now, and [`discovery`] adds those that it finds on the ledger.

mod actions;
mod calls;
mod clocks;
pub(crate) mod counters;
mod delivery;
pub(crate) mod discovery;
mod ends;
pub(crate) mod kind;
pub(crate) mod kinds;
mod pace;
mod services;
mod shown;
pub(crate) mod silence;
mod submission;
pub(crate) mod table;
mod terms;
mod topics;

pub(crate) use self::terms::topic_for;
