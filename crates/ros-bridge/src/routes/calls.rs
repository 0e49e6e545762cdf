//! Routes of calls: services of ROS 2 through the ledger. A request is one transaction, its reply another one.
//!
//! On a user's side the bridge is the server of the local graph, on the robot's side a client. Each side has two halves, one to
//! the ledger and one from it: they are those of routes of messages, with the same rights, limits and checks. So the gate of the
//! robot checks requests like commands, and that of the user checks replies like a feed.
//!
//! A request travels as the CDR of its type. The middleware's words about the caller stay with the user's bridge. A reply names its
//! request, see [`super::ends`].

mod account;
mod halves;
mod patience;
mod pending;
mod submitter;
mod waiting;

pub(super) use self::{
    account::Account,
    halves::{ClientHalves, ServerHalves, answers_of},
    patience::{PATIENCE, WAIT_MS_MIN, patience},
    pending::PendingRequests,
    submitter::Submitter,
    waiting::Waiting,
};
