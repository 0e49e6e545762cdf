//! Why a route is silent, in words for who looks at it.

use ledger_base::rejection::Code;

use super::counters::Live;
use crate::graph::{dds::Neighbour, names::quoted};

/// The known state of a route.
pub(crate) struct Facts<'a> {
    pub(crate) service: &'a str,
    /// The local topic, `/cmd_vel`.
    pub(crate) topic: &'a str,
    pub(crate) other_end: OtherEnd,
    pub(crate) live: &'a Live,
}

/// The other end of a route, in the local graph.
#[derive(Debug, Default, Clone, PartialEq, Eq)]
pub(crate) struct OtherEnd {
    /// Publishers or subscribers that this route is, or will be, connected with. Not counting bridges of this network.
    pub(crate) usable: usize,
    /// Bridges of this network at the other end: they take nothing in.
    pub(crate) bridges: usize,
    /// The type of one that has another.
    pub(crate) other_type: Option<String>,
    /// The policy of one with which ours do not fit together.
    pub(crate) other_qos: Option<String>,
    /// Those that exchange no messages by UDP over IPv4.
    pub(crate) unreachable: usize,
    /// Those in shared memory, without our own.
    pub(crate) in_memory: usize,
}

/// A cause of silence for which each kind of route has its words.
#[derive(Clone, Copy)]
pub(crate) enum Cause<'a> {
    /// Nobody is at the other end in the local graph.
    Alone,
    /// The last message was refused, by this code or rule and in these words.
    Refused {
        name: &'a str,
        line: &'a str,
        /// Is there a grant, or is none needed?
        is_held: bool,
    },
    /// The grant is missing.
    NotHeld,
    /// No message has come yet.
    NothingCame,
}

/// A reason for silence.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Silence {
    /// For programs; the same reason has the same name.
    pub(crate) name: &'static str,
    /// For people.
    pub(crate) reason: String,
    /// Must somebody repair something?
    pub(crate) is_fault: bool,
}

impl OtherEnd {
    /// Counts an endpoint on the topic of a route.
    pub(crate) fn add(&mut self, neighbour: &Neighbour, wanted_type: &str, misfit: Option<String>, is_bridge: bool) {
        if neighbour.type_name != wanted_type {
            self.other_type = Some(quoted(&neighbour.type_name));
        } else if is_bridge {
            self.bridges += 1;
        } else if !neighbour.is_reachable {
            self.unreachable += 1;
        } else if let Some(policy) = misfit {
            self.other_qos = Some(policy);
        } else {
            self.usable += 1;
        }
    }
}

/// Somebody must repair something.
pub(crate) fn fault(name: &'static str, reason: String) -> Silence {
    Silence { name, reason, is_fault: true }
}

/// All is in order.
pub(super) fn pause(name: &'static str, reason: String) -> Silence {
    Silence { name, reason, is_fault: false }
}

/// The words of a route to the ledger: where nobody is there, the beginning of the line of a refusal, and where nothing came.
pub(super) fn of_sending(
    facts: &Facts<'_>,
    cause: Cause<'_>,
    (alone, refused, nothing): (Silence, &str, String),
) -> Silence {
    let acquire = format!("ledgerctl acquire {}", facts.service);
    match cause {
        Cause::Alone => alone,
        Cause::Refused { name, is_held: false, .. } if name == Code::NotHolder.name() => {
            fault("no_grant", format!("refused, because you do not hold it: {acquire}"))
        }
        Cause::Refused { line, .. } => fault("refused", format!("{refused}: {line}")),
        Cause::NotHeld => pause("no_grant", format!("you do not hold it: {acquire}")),
        Cause::NothingCame => pause("no_message", nothing),
    }
}
