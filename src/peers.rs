//! The other nodes: who they are, one outgoing connection to each, and the service that takes what they send.
//!
//! ```text
//! peers          the connections, which follow the members
//!   directory    who belongs to the network, from the ledger
//!   link         one connection, made again when it breaks
//!   service      what other nodes call
//! ```

mod directory;
mod link;
mod service;

pub(crate) use directory::{Directory, Member, Part};
pub(crate) use service::PeerService;

use bytes::Bytes;
use ledger_api::tls::{TlsIdentity, TrustSource};
use ledger_hash::Hash;
use ledger_raft::PeerMessage;
use link::Way;
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, PoisonError, RwLock};
use tokio::sync::{Notify, mpsc};

/// Messages that wait for a peer; beyond it they are dropped, and ordering repeats what matters.
const WAITING_MAX: usize = 1024;

/// How this node calls others.
#[derive(Clone)]
pub(crate) struct Dialer {
    /// This node's id.
    pub me: u64,
    /// The network of the nodes that it calls.
    pub network: Hash,
    /// Its organisation.
    pub organisation: String,
    /// Its certificate and key.
    pub identity: TlsIdentity,
    /// The certificates that it accepts.
    pub trust: Arc<dyn TrustSource>,
}

/// The ways to the other nodes.
pub(crate) struct Peers {
    dialer: Dialer,
    links: RwLock<BTreeMap<u64, Link>>,
}

/// One way. Dropping it ends the connection.
struct Link {
    address: String,
    waiting: mpsc::Sender<Bytes>,
    connected: Arc<AtomicBool>,
    /// Ends the pause before the next attempt to connect.
    wake: Arc<Notify>,
}

impl Peers {
    /// No connections yet.
    pub(crate) fn new(dialer: Dialer) -> Arc<Self> {
        Arc::new(Self { dialer, links: RwLock::default() })
    }

    /// Keeps connections to the members of the directory, as they change, until the directory or the peers are gone.
    /// Must be called inside a tokio runtime.
    pub(crate) fn follow(self: &Arc<Self>, directory: &Directory) {
        let mut members = directory.subscribe();
        self.update(&members.borrow_and_update());
        let peers = Arc::downgrade(self);
        tokio::spawn(async move {
            while members.changed().await.is_ok() {
                let Some(peers) = peers.upgrade() else { return };
                peers.update(&members.borrow_and_update());
            }
        });
    }

    fn update(&self, members: &[Member]) {
        let mut links = self.links.write().unwrap_or_else(PoisonError::into_inner);
        links.retain(|id, link| members.iter().any(|member| member.id == *id && member.address == link.address));
        for member in members.iter().filter(|member| member.id != self.dialer.me) {
            links.entry(member.id).or_insert_with(|| {
                let (waiting, messages) = mpsc::channel(WAITING_MAX);
                let (connected, wake) = (Arc::new(AtomicBool::new(false)), Arc::new(Notify::new()));
                let way = Way {
                    member: member.clone(),
                    dialer: self.dialer.clone(),
                    connected: Arc::clone(&connected),
                    wake: Arc::clone(&wake),
                };
                tokio::spawn(way.keep_connected(messages));
                Link { address: member.address.clone(), waiting, connected, wake }
            });
        }
    }

    /// Sends a message if the peer keeps up; otherwise the message is dropped and the answer is false.
    pub(crate) fn send(&self, to: u64, message: &PeerMessage) -> bool {
        let links = self.links.read().unwrap_or_else(PoisonError::into_inner);
        links.get(&to).is_some_and(|link| {
            link.connected.load(Ordering::Relaxed) && link.waiting.try_send(message.to_bytes()).is_ok()
        })
    }

    /// Is there a connection to this node?
    pub(crate) fn connected(&self, id: u64) -> bool {
        let links = self.links.read().unwrap_or_else(PoisonError::into_inner);
        links.get(&id).is_some_and(|link| link.connected.load(Ordering::Relaxed))
    }

    /// This node has just called: it is worth trying to reach it now.
    pub(crate) fn heard_of(&self, id: u64) {
        let links = self.links.read().unwrap_or_else(PoisonError::into_inner);
        if let Some(link) = links.get(&id) {
            link.wake.notify_one();
        }
    }
}
