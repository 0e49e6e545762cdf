//! Routes of calls: services of ROS 2 through the ledger. A request is one transaction, its reply another one.
//!
//! On a user's side the bridge is the server of the local graph, on the robot's side a client. Each side has two halves, one to
//! the ledger and one from it: they are those of routes of messages, with the same rights, limits and checks. So the gate of the
//! robot checks requests like commands, and that of the user checks replies like a feed.
//!
//! A request travels as the CDR of its type. The middleware's words about the caller stay with the user's bridge. A reply names its
//! request, see [`frame`].

mod account;
mod frame;
mod hand;
mod waiting;
mod ways;

use std::time::Duration;

use ledger_base::hash::Hash;
use ledger_base::settings::Section;

pub(super) use self::{
    account::Account,
    frame::{REPLY_BYTES, message_of, reply_to, split},
    hand::{Hand, Handed},
    waiting::Waiting,
    ways::{Ways, answers_of},
};

/// Most calls of a route without a reply, and most that wait to be handed over.
pub(super) const CALLS_MAX: usize = 64;
/// Shortest and longest time that a reply is waited for.
pub(super) const WAIT_MS_MIN: u64 = 100;
const WAIT_MS_MAX: u64 = 3_600_000;
const WAIT_MS_DEFAULT: u64 = 10_000;
/// How long a reply is waited for by default.
pub(super) const PATIENCE: Duration = Duration::from_millis(WAIT_MS_DEFAULT);
/// The name of the reason for what is dropped because too many calls wait.
pub(super) const TOO_MANY: &str = "too_many_calls";

/// News about a message that goes to the ledger, by its number.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Told {
    /// It goes in this transaction.
    Submitted(u64, Hash),
    /// The ledger has refused it.
    Refused(u64),
}

/// Reads how long a reply is waited for.
pub(super) fn patience(section: &mut Section<'_, '_>, key: &'static str) -> Duration {
    let mut wait_ms = WAIT_MS_DEFAULT;
    section.integer(key, WAIT_MS_MIN..=WAIT_MS_MAX, &mut wait_ms);
    Duration::from_millis(wait_ms)
}
