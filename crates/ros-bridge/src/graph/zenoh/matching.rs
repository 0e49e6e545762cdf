//! The endpoints of others that exchange messages with an own one, kept up to date by a task.

use std::{collections::BTreeSet, time::Duration};

use ros_zenoh::{key::Subject, node::Node, token::Kind};
use rtps::{guid::Guid, io::Matches};
use tokio::{
    sync::watch,
    task::AbortHandle,
    time::{sleep, timeout},
};

use crate::graph::dds::Matched;

/// Between two looks, however much changes: a look costs as much as there are endpoints in the graph.
const LOOK_PAUSE: Duration = Duration::from_millis(20);
/// At least so often it looks whether the session has ended.
const LOOK_EVERY: Duration = Duration::from_millis(500);

/// The task; it ends when dropped.
pub(super) struct Matching {
    pub(super) matched: Matched,
    task: AbortHandle,
}

impl Drop for Matching {
    fn drop(&mut self) {
        self.task.abort();
    }
}

impl Matching {
    /// Follows those of a kind. `look` gets their number after each look at them, and `ended` when the session has ended.
    pub(super) fn follow(
        node: &Node,
        (subject, kind): (Subject, Kind),
        mut look: impl FnMut(usize) + Send + 'static,
        ended: impl FnOnce() + Send + 'static,
    ) -> Self {
        let sender = watch::Sender::new(found(node, &subject, kind));
        let matched = Matched::of(&sender.subscribe());
        let node = node.clone();
        let task = tokio::spawn(async move {
            let mut changes = node.graph().changes();
            while !node.is_ended() {
                changes.mark_unchanged();
                let now = found(&node, &subject, kind);
                let count = now.endpoints.len();
                sender.send_if_modified(|known| {
                    let is_news = *known != now;
                    *known = now;
                    is_news
                });
                look(count);
                sleep(LOOK_PAUSE).await;
                // A timeout is a look at the session.
                drop(timeout(LOOK_EVERY, changes.changed()).await);
            }
            tracing::error!(%subject, "zenoh has ended: nothing passes any more");
            ended();
        });
        Self { matched, task: task.abort_handle() }
    }
}

fn found(node: &Node, subject: &Subject, kind: Kind) -> Matches {
    let endpoints = node.graph().endpoints();
    let meets = endpoints.iter().filter(|one| one.token.kind == kind && one.token.subject.meets(subject));
    let endpoints: BTreeSet<Guid> = meets.map(|one| Guid::from_bytes(one.gid)).collect();
    Matches { endpoints, ..Matches::default() }
}
