//! The other nodes: connections, synchronisation, and the checks that all have the same chain.
//!
//! | module | content |
//! |---|---|
//! | `connections`, `service` | one outgoing connection to each node; the service that other nodes call |
//! | `reachability` | whether this node reaches a leader |
//! | `question`, `receipt` | asking other nodes what they have; receipts between nodes |
//! | `sync` | block and snapshot sync: fetching, peer trust, serving |
//! | `conductor` | starts and ends the orderer, and synchronises when the node is too far behind |
//! | `chain_monitor` | compares the chain with the voters' and stops a node that differs |
//! | `attestation` | signs what this node computed into the ledger, and compares what others signed |
//! | `quorum_certificates` | signatures of voters over blocks, and proofs of misbehaviour |
//! | `early_stop` | emergency stops, broadcast ahead of ordering |

pub(crate) mod attestation;
pub(crate) mod chain_monitor;
pub(crate) mod conductor;
pub(crate) mod connections;
pub(crate) mod early_stop;
pub(crate) mod question;
pub(crate) mod quorum_certificates;
pub(crate) mod reachability;
mod receipt;
pub(crate) mod service;
pub(crate) mod sync;

use crate::ordering::Ordering;
use crate::ordering::node_transactions::Author;
use crate::process::config::Config;
use crate::trust::Trust;
use attestation::{Attesting, Witness};
use chain_monitor::{Asking, ChainMonitor};
use connections::{Connections, Dialer};
use early_stop::EarlyStops;
use ledger::network::Genesis;
use ledger_base::invariant::vital_task;
use ledger_base::rejection::{Code, Rejection};
use ledger_raft::{Input, PeerMessage, ReceiptKey};
use ledger_replica::Executor;
use ledger_replica::catch_up::Ballot;
use ledger_replica::certifier::{Certifier, Earlier};
use ledger_replica::disputes::Disputes;
use question::Bootstrap;
use quorum_certificates::{Certificates, Certifying, Keys, era};
use reachability::Reachability;
use service::PeerService;
use std::sync::Arc;
use std::time::Duration;
use sync::{BlockSync, Source};
use tokio::sync::watch;
use tokio::task::JoinHandle;

/// The other nodes, and what they say about the chain.
pub(crate) struct Peers {
    /// How to call the others.
    pub dialer: Dialer,
    /// One outgoing connection to each of them.
    pub connections: Arc<Connections>,
    /// Whether this node reaches the leader.
    pub reachability: Arc<Reachability>,
    /// Compares the chain with theirs.
    pub monitor: Arc<ChainMonitor>,
    /// Signatures of voters over blocks.
    pub certificates: Arc<Certificates>,
    /// Compares what nodes attest on the ledger.
    pub witness: Arc<Witness>,
    /// Emergency stops, broadcast ahead of ordering.
    pub early_stops: Arc<EarlyStops>,
    /// Makes this node's receipts, and recognises them.
    receipts: ReceiptKey,
    /// Whether this node may vote.
    ballot: Ballot,
}

/// The tasks of a node about its peers, which do not run yet.
pub(crate) struct Tasks {
    attesting: Attesting,
    asking: Asking,
    certifying: Certifying,
    early_stops: Arc<EarlyStops>,
}

impl Peers {
    /// Connects to the members of the network as they change. Must be called inside a tokio runtime.
    ///
    /// # Errors
    /// A fault of the disk.
    pub(crate) fn new(
        config: &Config,
        ordering: &Arc<Ordering>,
        trust: &Trust,
        author: &Arc<Author>,
    ) -> Result<(Arc<Self>, Tasks), Rejection> {
        let (ledger, me) = (&ordering.storage.ledger, &trust.me);
        let dialer = Dialer {
            me: me.id,
            network: ledger.network(),
            organisation: me.organisation.clone(),
            identity: trust.identity.clone(),
            trust: Arc::clone(&trust.organisations),
            rules: Arc::new(config.dial_rules()),
            paces: Arc::default(),
        };
        let monitor = Arc::new(ChainMonitor::new(ledger, me, config.data.clone()));
        let (certificates, told) = Certificates::open(&config.data)?;
        let (witness, seen) = Witness::new();
        let connections = Connections::new(dialer.clone());
        connections.follow(&ordering.directory);
        let reachability = Reachability::new(me.id, ordering, &connections);
        let peers = Arc::new(Self {
            early_stops: Arc::new(EarlyStops::open(me.id, &config.data, ordering, &connections)),
            receipts: ReceiptKey::new(me.id, &trust.receipt_secret(ledger.network())),
            ballot: Ballot::default(),
            dialer,
            connections,
            reachability,
            monitor,
            certificates,
            witness,
        });
        let founded = Genesis::governance(&ordering.storage.document)?;
        let keys = || Keys::new(me.id, trust.identity.clone(), Arc::clone(ledger));
        let end = ordering.storage.log.store.last_index();
        let earlier = Earlier { end, signed: peers.certificates.recorded()? };
        let tasks = Tasks {
            attesting: Attesting {
                author: Arc::clone(author),
                ordering: Arc::clone(ordering),
                witness: Arc::clone(&peers.witness),
                monitor: Arc::clone(&peers.monitor),
                me: me.full_name(),
                every: Duration::from_millis(config.order.attest_ms),
                seen,
            },
            asking: Asking {
                monitor: Arc::clone(&peers.monitor),
                certificates: Arc::clone(&peers.certificates),
                ordering: Arc::clone(ordering),
                reachability: Arc::clone(&peers.reachability),
                dialer: peers.dialer.clone(),
            },
            certifying: Certifying {
                certificates: Arc::clone(&peers.certificates),
                certifier: Certifier::new(me.id, ledger.network(), keys(), era(ledger)?, earlier),
                disputes: Disputes::new(me.id, Arc::clone(ledger), founded, keys(), peers.certificates.evidence()),
                ordering: Arc::clone(ordering),
                connections: Arc::clone(&peers.connections),
                me: me.id,
                told,
            },
            early_stops: Arc::clone(&peers.early_stops),
        };
        Ok((peers, tasks))
    }

    /// The service that other nodes call.
    pub(crate) fn service(self: &Arc<Self>, ordering: &Arc<Ordering>) -> PeerService {
        let source = Source::new(ordering, (&self.monitor, &self.certificates), self.receipts.clone());
        let (peers, slot) = (Arc::clone(self), Arc::clone(&ordering.slot));
        let deliver = Box::new(move |from, message| {
            let message = match message {
                PeerMessage::Statement(statement) => {
                    peers.certificates.hear(from, statement);
                    return true;
                }
                PeerMessage::Evidence(evidence) => {
                    peers.certificates.show(from, evidence);
                    return true;
                }
                PeerMessage::Early(call) => {
                    peers.early_stops.passed_on(from, call.transaction);
                    return true;
                }
                message => message,
            };
            if peers.ballot.withholds(&message) || peers.monitor.withholds(from, &message) {
                return true;
            }
            // Without an orderer, or with a full inbox, the message is lost, as a network might lose it: ordering
            // repeats what matters.
            !matches!(slot.input(Input::Message { from, message }), Err(reason) if reason.code == Code::ShuttingDown)
        });
        PeerService::new(Arc::clone(&self.connections), source, ordering.directory.subscribe(), deliver)
    }

    /// Fetches what this node lacks, until the node stops.
    pub(crate) fn sync(
        &self,
        ordering: &Arc<Ordering>,
        executor: &Arc<Executor>,
        trust: &Trust,
        stopping: watch::Receiver<bool>,
    ) -> BlockSync {
        let bootstrap = trust.joined.as_ref();
        BlockSync {
            bootstrap: bootstrap.map(|joined| Bootstrap { addresses: joined.bootstrap.clone(), ca: joined.ca }),
            ordering: Arc::clone(ordering),
            executor: Arc::clone(executor),
            dialer: self.dialer.clone(),
            ballot: self.ballot.clone(),
            receipts: self.receipts.clone(),
            stopping,
        }
    }
}

impl Tasks {
    /// Starts them.
    pub(crate) fn start(self) -> [JoinHandle<()>; 4] {
        [
            tokio::spawn(vital_task(self.attesting.run())),
            tokio::spawn(vital_task(self.asking.run())),
            tokio::spawn(vital_task(self.certifying.run())),
            tokio::spawn(vital_task(self.early_stops.run())),
        ]
    }
}

#[cfg(test)]
pub(crate) mod tests;
