//! Which nodes a client knows: those it was given, and for a context those that the network has told since.

use super::dialer::{Dialer, Opened};
use super::uplink::Uplink;
use crate::context::Context;
use crate::tls::Trusted;
use crate::v1::{NetworkRequest, NetworkResponse};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::time::timeout;

/// How often a connected client looks around.
pub(super) const LOOK_EVERY: Duration = Duration::from_secs(15);
/// How long a look around may take.
const LOOK_MAX: Duration = Duration::from_secs(5);
/// How long a first connection waits for the disk to keep what was learnt.
const NOTE_MAX: Duration = Duration::from_secs(1);

/// The nodes of a client, in the order to try them.
pub(super) struct Nodes {
    addresses: Mutex<Vec<String>>,
    /// The part that learns; none if the nodes were chosen once and for all.
    learner: Option<Mutex<Learner>>,
}

/// A context that learns, and whose nodes are believed.
pub(super) struct Learner {
    context: Context,
    trusted: Arc<Trusted>,
}

impl Nodes {
    /// These and no others.
    pub(super) fn fixed(addresses: Vec<String>) -> Self {
        Self { addresses: Mutex::new(addresses), learner: None }
    }

    /// Those of a context, as they become known.
    pub(super) fn of(context: &Context, trusted: Arc<Trusted>) -> Self {
        let learner = Learner { context: context.clone(), trusted };
        Self { addresses: Mutex::new(context.addresses()), learner: Some(Mutex::new(learner)) }
    }

    /// All of them.
    pub(super) fn all(&self) -> Vec<String> {
        self.lock().clone()
    }

    /// All but this one.
    fn others(&self, than: &str) -> Vec<String> {
        self.lock().iter().filter(|address| **address != than).cloned().collect()
    }

    /// The nodes of the own organisation, if this is none of them: whoever had to go elsewhere comes back to them.
    fn own(&self, than: &str) -> Vec<String> {
        let Some(learner) = &self.learner else { return Vec::new() };
        let learner = learner.lock().unwrap_or_else(PoisonError::into_inner);
        let context = &learner.context;
        let known = context.known_nodes().iter();
        let own: Vec<_> =
            known.filter(|node| node.organisation == context.organisation).map(|node| &node.address).collect();
        // What was typed at the enrolment is a node of the own organisation, too.
        match own.iter().any(|address| *address == than) || context.nodes.first().is_some_and(|first| first == than) {
            true => Vec::new(),
            false => own.into_iter().cloned().collect(),
        }
    }

    /// The nodes of other organisations than that of the node at this address; all others if that is unknown.
    pub(super) fn elsewhere(&self, than: &str) -> Vec<String> {
        let mut others = self.others(than);
        if let Some(learner) = &self.learner {
            let learner = learner.lock().unwrap_or_else(PoisonError::into_inner);
            let known = learner.context.known_nodes();
            let organisation = |address: &str| {
                known.iter().find(|node| node.address == address).map(|node| node.organisation.as_str())
            };
            if let Some(of) = organisation(than) {
                others.retain(|address| organisation(address) != Some(of));
            }
        }
        others
    }

    /// Is there more than one?
    pub(super) fn are_several(&self) -> bool {
        self.lock().len() > 1
    }

    /// A node failed: the others are tried before it.
    pub(super) fn avoid(&self, address: &str) {
        let mut addresses = self.lock();
        if let Some(at) = addresses.iter().position(|known| known == address) {
            let failed = addresses.remove(at);
            addresses.push(failed);
        }
    }

    /// Takes what the node at `address` has told. Is it news?
    pub(super) fn learn(&self, told: &NetworkResponse, address: &str) -> bool {
        let Some(learner) = &self.learner else { return false };
        let mut learner = learner.lock().unwrap_or_else(PoisonError::into_inner);
        match learner.context.learn(told, address) {
            Ok(false) => false,
            Ok(true) => {
                learner.trusted.learn(learner.context.learnt_organisations().cloned());
                *self.lock() = learner.context.addresses();
                true
            }
            Err(reason) => {
                tracing::debug!(code = reason.code.name(), %reason, address, "cannot use the network description of a \
                                                                              node");
                false
            }
        }
    }

    /// Keeps on the disk what was learnt. A context that cannot be written is no reason to fail.
    pub(super) async fn note(&self) {
        let Some(learner) = &self.learner else { return };
        let context = learner.lock().unwrap_or_else(PoisonError::into_inner).context.clone();
        let noted = timeout(NOTE_MAX, tokio::task::spawn_blocking(move || context.note())).await;
        if let Ok(Ok(Err(reason))) = noted {
            tracing::debug!(code = reason.code.name(), %reason, "cannot store the network description");
        }
    }

    fn lock(&self) -> MutexGuard<'_, Vec<String>> {
        self.addresses.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The result of a look around.
pub(super) struct Look {
    /// The present answer of our node, if it answers.
    pub(super) told: Option<NetworkResponse>,
    /// A connection to a better node, if there is one: if ours can have nothing ordered, any that can; if ours is
    /// another organisation's, one of our own.
    pub(super) better: Option<Opened>,
}

/// Asks the connected node how things stand, and looks for a better one if there may be one.
pub(super) async fn look_around(up: Uplink, dialer: Dialer, nodes: Arc<Nodes>) -> Look {
    let told = timeout(LOOK_MAX, up.enrolment().network(NetworkRequest {})).await;
    let told = told.ok().and_then(Result::ok).map(tonic::Response::into_inner);
    let candidates = match &told {
        Some(told) if told.cut_off => nodes.others(&up.connection.address),
        Some(_) => nodes.own(&up.connection.address),
        // A connection that does not answer is ended by other means.
        None => Vec::new(),
    };
    let search = dialer.race(&candidates, |opened| !opened.told.cut_off, None);
    let better = timeout(LOOK_MAX, search).await.ok().and_then(Result::ok);
    Look { told, better }
}
