//! The ledgers behind one listener: each has its own certificate, its own callers and its own server.

use super::connection::Connection;
use crate::process::caller::Members;
use ledger_api::tls::{TrustSource, named_network};
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use std::collections::BTreeMap;
use std::io;
use std::sync::Arc;
use tokio::sync::{mpsc, watch};
use tokio_rustls::rustls::ServerConfig;
use tokio_stream::wrappers::ReceiverStream;

/// Most connections that are established and not yet taken over by the server of their ledger.
const ESTABLISHED_MAX: usize = 64;

/// Established connections, for a server of one ledger.
pub(super) type Incoming = ReceiverStream<io::Result<Connection>>;

/// A ledger as the listener sees it.
#[derive(Clone)]
pub(super) struct Served {
    /// Its certificate, and the clients that it accepts.
    pub(super) tls: Arc<ServerConfig>,
    /// Says who a client is.
    pub(super) trust: Arc<dyn TrustSource>,
    /// The members that are connected.
    pub(super) members: Arc<Members>,
    /// Takes the connections of members.
    pub(super) members_established: mpsc::Sender<io::Result<Connection>>,
    /// Takes those without a certificate.
    pub(super) strangers_established: mpsc::Sender<io::Result<Connection>>,
}

/// The ledgers that are served, by the name of their network.
#[derive(Clone, Default)]
pub(super) struct Ledgers {
    served: watch::Sender<BTreeMap<Hash, Served>>,
}

/// A ledger that the listener serves; its network is free again once this is dropped.
pub(super) struct Listed {
    network: Hash,
    ledgers: Ledgers,
}

impl Ledgers {
    /// Serves this network from now on. Answers with the connections of members, and with those without a certificate.
    ///
    /// # Errors
    /// [`Code::BadConfiguration`] if another node of the same network is served here.
    pub(super) fn enter(
        &self,
        network: Hash,
        tls: Arc<ServerConfig>,
        (trust, members): (Arc<dyn TrustSource>, Arc<Members>),
    ) -> Result<(Listed, Incoming, Incoming), Rejection> {
        let (members_established, of_members) = mpsc::channel(ESTABLISHED_MAX);
        let (strangers_established, of_strangers) = mpsc::channel(ESTABLISHED_MAX);
        let served = Served { tls, trust, members, members_established, strangers_established };
        let entered = self.served.send_if_modified(|all| {
            let free = !all.contains_key(&network);
            if free {
                all.insert(network, served);
            }
            free
        });
        if !entered {
            return Err(Rejection::new(Code::BadConfiguration, "one address cannot serve two nodes of a network")
                .found(format!("another node of network {network} behind this listener"))
                .wanted("one node of each network")
                .next("use a separate listener for this node"));
        }
        let listed = Listed { network, ledgers: self.clone() };
        Ok((listed, ReceiverStream::new(of_members), ReceiverStream::new(of_strangers)))
    }

    /// The ledger that a client means: the only one, or the one whose network it names.
    pub(super) fn find(&self, name: Option<&str>) -> Option<Served> {
        let served = self.served.borrow();
        if served.len() == 1 {
            return served.values().next().cloned();
        }
        served.get(&name.and_then(named_network)?).cloned()
    }

    /// Waits until there is a ledger to serve.
    pub(super) async fn any(&self) {
        let mut served = self.served.subscribe();
        let _any = served.wait_for(|served| !served.is_empty()).await;
    }
}

impl Drop for Listed {
    fn drop(&mut self) {
        self.ledgers.served.send_modify(|served| drop(served.remove(&self.network)));
    }
}
