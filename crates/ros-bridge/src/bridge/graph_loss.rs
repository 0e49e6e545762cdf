//! Notices that the local graph is lost: the middleware has ended, or the host has other addresses.

use ledger_base::rejection::{Code, Rejection};
use tokio::{sync::watch, task::JoinSet};

use crate::graph::addresses::Addresses;

/// The signs that the local graph is lost.
pub(super) struct GraphLoss {
    /// Has a route ended that nobody stopped?
    ended: watch::Receiver<bool>,
    /// Have the addresses of this host changed? Says how.
    outdated: watch::Receiver<Option<String>>,
    /// The task that looks at them.
    _looking: JoinSet<()>,
}

impl GraphLoss {
    /// Looks for it from now on. `ended` reports a route that ended without a stop; `addresses` are looked at if there are some.
    pub(super) fn watch(ended: watch::Receiver<bool>, addresses: Option<Addresses>) -> Self {
        let (tell, outdated) = watch::channel(None);
        let mut looking = JoinSet::new();
        looking.spawn(async move {
            match addresses {
                Some(addresses) => drop(tell.send_replace(Some(addresses.outdated().await))),
                // Addresses do not matter. The sender is kept, so that none is waited for.
                None => drop((std::future::pending::<()>().await, tell)),
            }
        });
        Self { ended, outdated, _looking: looking }
    }

    /// Waits until it is lost, and says why.
    pub(super) async fn reason(&self) -> Rejection {
        let (mut ended, mut outdated) = (self.ended.clone(), self.outdated.clone());
        tokio::select! {
            // An error means that every route has ended.
            _ = ended.wait_for(|ended| *ended) => Rejection::new(Code::MiddlewareFailed, "the local ROS 2 graph is lost")
                .found("the middleware has ended: one of its threads is gone")
                .wanted("a running middleware")
                .next("it is joined again by itself; look at the interfaces of this machine if that does not help"),
            Ok(found) = outdated.wait_for(Option::is_some) => {
                let found = found.clone().unwrap_or_default();
                Rejection::new(Code::MiddlewareFailed, "the addresses of this host have changed")
                    .found(found)
                    .wanted("the addresses with which DDS began")
                    .next("the graph is joined again by itself, with the new ones")
            }
        }
    }
}
