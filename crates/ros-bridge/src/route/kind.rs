//! The kinds of routes: a file for each, and its line in [`KINDS`].
//!
//! The rest of the bridge reads what a kind says of itself, never its name. A new kind is a new file and a new line.

use std::{fmt, sync::Arc};

use futures::future::BoxFuture;
use ledger_api::Context;
use ledger_base::rejection::Rejection;
use ledger_base::settings::Section;
use ledger_gate::service::Service;
use tokio::sync::watch;

use super::{
    Stop, action_client, action_server, from_ledger,
    local::Local,
    service_client, service_server,
    silence::{Cause, Facts, Silence},
    to_ledger,
};
use crate::{
    config::RouteConfig,
    count::Counters,
    dds::Role,
    gateway::Gateway,
    mark::Mark,
    names::{Interface, TopicName, TypeName},
    qos::Qos,
    shm::Peers,
    standing::Asker,
};

/// Every kind.
pub(crate) static KINDS: [&Kind; 6] = [
    &to_ledger::KIND,
    &from_ledger::KIND,
    &service_server::KIND,
    &service_client::KIND,
    &action_server::KIND,
    &action_client::KIND,
];

// The halves of a route of calls: one submits, and what passes the gate goes to the other.
pub(super) use super::{
    from_ledger::{STALE_AFTER, STALE_KEY, half as gated, stale_after},
    to_ledger::half as submitted,
};

/// Makes the settings of a route that was discovered.
pub(crate) type Discovered = fn(&Terms) -> Arc<dyn Plan>;

/// A kind of route.
pub(crate) struct Kind {
    /// Its name in the configuration, in the log and in the summary.
    pub(crate) name: &'static str,
    /// The types that it carries.
    pub(crate) carries: Interface,
    /// The right on the service that the bridge's identity needs.
    pub(crate) right: &'static str,
    /// The endpoints of the local graph with which the route is connected.
    pub(crate) other_end: Role,
    /// The keys that only this kind has.
    pub(crate) keys: &'static [&'static str],
    /// Reads the settings under these keys.
    pub(crate) read: fn(&mut Section<'_, '_>, &Given<'_>) -> Arc<dyn Plan>,
    /// The settings of a route that was discovered; none if this kind cannot be.
    pub(crate) discovered: Option<Discovered>,
    /// The words for a cause of silence.
    pub(crate) silence: fn(&Facts<'_>, Cause<'_>) -> Silence,
    /// The warning about an endpoint that does beside this route what the route does.
    pub(crate) beside: fn(&Beside<'_>) -> Option<String>,
}

/// The part of a route that is known when the settings of its kind are read.
pub(crate) struct Given<'a> {
    /// The type of its messages; none if that is a fault.
    pub(crate) message: Option<&'a TypeName>,
    /// Its largest sample, in bytes.
    pub(crate) sample_bytes_max: usize,
}

/// The own settings of a route, read and checked: it can be opened.
pub(crate) trait Plan: fmt::Debug + Send + Sync {
    /// Joins the topic, and learns from the ledger where the route stands.
    fn open<'a>(&'a self, opening: Opening<'a>) -> BoxFuture<'a, Result<Opened, Rejection>>;
}

/// The settings that `[discover]` has for a route.
pub(crate) struct Terms {
    /// Most samples a second; none = any number.
    pub(crate) max_rate_hz: Option<u32>,
    /// Does publishing need a grant?
    pub(crate) needs_grant: bool,
    /// Do users publish and the robot listens?
    pub(crate) is_command: bool,
}

/// The surroundings of a route that is being opened.
pub(crate) struct Opening<'a> {
    pub(crate) route: &'a RouteConfig,
    pub(crate) gateway: Arc<dyn Gateway>,
    pub(crate) context: &'a Context,
    pub(crate) local: &'a Local,
    pub(crate) service: Service,
    /// The local topic.
    pub(crate) topic: &'a TopicName,
    pub(crate) mark: Mark,
    /// Asks how the robot stands.
    pub(crate) asker: Arc<Asker>,
    /// Those of the route, from its first opening on.
    pub(crate) counters: Counters,
    /// The quality of service that meets the others on the topic.
    pub(crate) qos: watch::Receiver<Qos>,
    /// Tells the route to end.
    pub(crate) stop: Stop,
}

/// An open route.
pub(crate) struct Opened {
    /// The other users of the topic in shared memory.
    pub(crate) in_memory: Option<Peers>,
    /// Runs until it is told to end, or the middleware ends.
    pub(crate) running: BoxFuture<'static, ()>,
}

/// An endpoint of another node on the same side of a route's topic.
pub(crate) struct Beside<'a> {
    pub(crate) service: &'a str,
    pub(crate) topic: &'a str,
    /// Is it a bridge of this network, with a route of the same service?
    pub(crate) is_same_service: bool,
    /// Do users publish and the robot listens?
    pub(crate) is_command: bool,
}

impl Kind {
    /// Does a route of this kind take samples in from the local graph, rather than deliver them there?
    pub(crate) fn takes_in(&self) -> bool {
        self.other_end == Role::Publisher
    }

    /// The way of the samples.
    pub(crate) fn arrow(&self, topic: &TopicName, service: &str) -> String {
        if self.takes_in() { format!("{topic} -> {service}") } else { format!("{service} -> {topic}") }
    }

    /// The kind of that name.
    pub(crate) fn named(name: &str) -> Option<&'static Self> {
        KINDS.into_iter().find(|kind| kind.name == name)
    }

    /// The names of all kinds as the configuration wants them.
    pub(crate) fn names() -> String {
        KINDS.map(|kind| format!("\"{}\"", kind.name)).join(" or ")
    }
}

impl fmt::Debug for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn each_kind_has_a_name_of_its_own_and_no_key_twice() {
        let mut names = BTreeSet::new();
        for kind in KINDS {
            assert!(names.insert(kind.name), "{kind:?} twice");
            let keys: BTreeSet<_> = kind.keys.iter().collect();
            assert_eq!(keys.len(), kind.keys.len(), "{kind:?} has a key twice");
        }
        let names = r#""to_ledger" or "from_ledger" or "service_server" or "service_client" or "action_server" or "action_client""#;
        assert_eq!(Kind::names(), names);
    }
}
