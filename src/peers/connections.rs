//! One outgoing connection to each of the other nodes.
//!
//! ```text
//! peers          the connections, which follow the members
//!   link         one connection, made again when it breaks
//!   pace         how often an address is dialled that does not answer
//! ```

mod link;
mod pace;

use crate::ordering::directory::{Directory, Member};
use crate::process::config::DialRules;
use bytes::Bytes;
use ledger_api::tls::{TlsIdentity, TrustSource};
use ledger_base::hash::Hash;
use ledger_base::invariant::vital_task;
use ledger_raft::PeerMessage;
use link::Way;
use pace::Paces;
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
    /// The addresses that it dials for other organisations.
    pub rules: Arc<DialRules>,
    /// How often it dials whom for a lasting connection, and for a question.
    pub paces: Arc<[Paces; 2]>,
}

/// The ways to the other nodes.
pub(crate) struct Connections {
    dialer: Dialer,
    links: RwLock<BTreeMap<u64, Link>>,
}

/// One way. Dropping it ends the connection.
struct Link {
    address: String,
    waiting: mpsc::Sender<Bytes>,
    connected: Arc<AtomicBool>,
    /// It was approved to order.
    votes: Arc<AtomicBool>,
    /// Ends the pause before the next attempt to connect.
    wake: Arc<Notify>,
}

impl Connections {
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
        tokio::spawn(vital_task(async move {
            while members.changed().await.is_ok() {
                let Some(peers) = peers.upgrade() else { return };
                peers.update(&members.borrow_and_update());
            }
        }));
    }

    fn update(&self, members: &[Member]) {
        let mut links = self.links.write().unwrap_or_else(PoisonError::into_inner);
        links.retain(|id, link| members.iter().any(|member| member.id == *id && member.address == link.address));
        self.dialer.paces.iter().for_each(|paces| paces.keep(|id| members.iter().any(|member| member.id == id)));
        for member in members.iter().filter(|member| member.id != self.dialer.me) {
            let link = links.entry(member.id).or_insert_with(|| {
                let (waiting, messages) = mpsc::channel(WAITING_MAX);
                let (connected, votes, wake) = (Arc::default(), Arc::default(), Arc::<Notify>::default());
                let way = Way {
                    member: member.clone(),
                    dialer: self.dialer.clone(),
                    connected: Arc::clone(&connected),
                    votes: Arc::clone(&votes),
                    wake: Arc::clone(&wake),
                };
                tokio::spawn(vital_task(way.keep_connected(messages)));
                Link { address: member.address.clone(), waiting, connected, votes, wake }
            });
            link.votes.store(member.votes(), Ordering::Relaxed);
        }
    }

    /// Sends a message if the peer keeps up; otherwise the message is dropped and the answer is false.
    pub(crate) fn send(&self, to: u64, message: &PeerMessage) -> bool {
        let links = self.links.read().unwrap_or_else(PoisonError::into_inner);
        links.get(&to).is_some_and(|link| {
            link.connected.load(Ordering::Relaxed) && link.waiting.try_send(message.to_bytes()).is_ok()
        })
    }

    /// Sends a message to all peers that keep up.
    pub(crate) fn send_to_all(&self, message: &PeerMessage) {
        let (links, bytes) = (self.links.read().unwrap_or_else(PoisonError::into_inner), message.to_bytes());
        for link in links.values().filter(|link| link.connected.load(Ordering::Relaxed)) {
            // Who does not keep up hears of it in its block.
            let _full = link.waiting.try_send(bytes.clone());
        }
    }

    /// Is there a connection to this node?
    pub(crate) fn connected(&self, id: u64) -> bool {
        let links = self.links.read().unwrap_or_else(PoisonError::into_inner);
        links.get(&id).is_some_and(|link| link.connected.load(Ordering::Relaxed))
    }

    /// That node has just called: it is worth trying to reach it now.
    pub(crate) fn heard_of(&self, id: u64) {
        let links = self.links.read().unwrap_or_else(PoisonError::into_inner);
        if let Some(link) = links.get(&id) {
            link.wake.notify_one();
        }
    }
}

impl Drop for Link {
    fn drop(&mut self) {
        // The task notices that there is no sender any more.
        self.wake.notify_one();
    }
}
