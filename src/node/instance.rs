//! One ledger in this process: its five subsystems, started and stopped in order.
//!
//! ```text
//! storage ── ordering ── trust ── peers ── clients
//!  files      engine     who is    other    the gateway,
//!  and disk   and its    who, and  nodes    for the host
//!             waiters    the CA             to serve
//! ```
//!
//! It takes from its [`Host`] what it shares with the process. So a process may hold several instances.

use super::host::{Host, Services};
use super::outlet::ToSubsystems;
use super::revocations::Revocations;
use crate::clients::Clients;
use crate::ordering::Ordering;
use crate::ordering::orderer::Engines;
use crate::ordering::spoken_rules::Telling;
use crate::peers::conductor::Conductor;
use crate::peers::quorum_certificates::{Certificates, Keys};
use crate::peers::{Peers, Tasks};
use crate::process::config::Config;
use crate::process::meters::{Meters, Traced};
use crate::storage::Storage;
use crate::storage::housekeeping::Housekeeping;
use crate::storage::scrub::Scrub;
use crate::trust::Trust;
use crate::trust::credentials::NodeCredentials;
use crate::trust::enrolment::EnrolmentService;
use crate::trust::membership::removed;
use ledger_base::invariant::vital_task;
use ledger_base::rejection::Rejection;
use ledger_replica::{Executor, Observer, Timing, Voting};
use ledger_traces::Tracer;
use std::sync::Arc;
use std::time::Instant;
use tokio::sync::watch;
use tokio::task::JoinHandle;

/// An instance whose services can be called, and whose engine does not run yet.
pub(crate) struct Instance {
    pub(crate) ordering: Arc<Ordering>,
    pub(crate) trust: Arc<Trust>,
    peers: Arc<Peers>,
    pub(crate) clients: Clients,
    enrolment: EnrolmentService,
    engines: Arc<Engines>,
    checks: Tasks,
    housekeeping: Housekeeping,
}

/// A running instance.
pub(crate) struct Running {
    pub(crate) ordering: Arc<Ordering>,
    certificates: Arc<Certificates>,
    clients: Clients,
    housekeeping: Housekeeping,
    scrub: Scrub,
    conductor: JoinHandle<()>,
    /// The tasks beside the engine, which are aborted when the node stops.
    beside: Vec<JoinHandle<()>>,
}

impl Instance {
    /// Builds the subsystems of a node that started at this moment, and its services for the host to serve.
    ///
    /// # Errors
    /// If this is no node of the network, or its certificate or CA is not usable; a fault of the disk.
    pub(crate) fn build(
        host: &Host,
        config: &Config,
        (storage, meters): (Arc<Storage>, Meters),
        credentials: NodeCredentials,
        started: Instant,
    ) -> Result<(Self, Services), Rejection> {
        let ordering = Ordering::new(config, &storage, host.clocks(), meters)?;
        let trust = Trust::new(config, credentials, &ordering)?;
        let author = ordering.author(&trust.identity);
        let (peers, checks) = Peers::new(config, &ordering, &trust, &author)?;
        let tracer = Tracer::start(&config.traces, "ledgerd", &trust.me.full_name());
        let clients = Clients::new(config, &ordering, &trust, &peers, (tracer.clone(), started))?;

        let (reachability, monitor) = (Arc::clone(&peers.reachability), Arc::clone(&peers.monitor));
        let (cut_off, clock_off) = (move || reachability.is_cut_off(), move || monitor.clock_off());
        let enrolment = trust.enrolment(&ordering, &host.own_gateway(), cut_off, clock_off);
        let members = host.members();
        // In this order: clients that wait for a verdict are told first.
        let observers: Vec<Arc<dyn Observer>> = vec![
            Arc::new(ordering.clock.clone()),
            Arc::clone(&ordering.waiters) as _,
            Arc::clone(&ordering.directory) as _,
            Arc::clone(&peers.witness) as _,
            Arc::clone(&peers.certificates) as _,
            Arc::clone(&storage.blocks) as _,
            Arc::new(ordering.reads.clone()),
            Arc::clone(&ordering.executed) as _,
            Arc::new(Revocations::new(&members, &storage)),
            Arc::new(Traced(tracer)),
        ];
        let executor =
            Arc::new(Executor::new(Arc::clone(&storage.ledger), observers).counting(Arc::clone(&ordering.budgets)));
        let keys = Keys::new(trust.me.id, trust.identity.clone(), Arc::clone(&storage.ledger));
        let ballots = Arc::new(Voting::new(Arc::clone(&storage.ledger), keys));
        let outlet = ToSubsystems {
            reads: ordering.reads.clone(),
            peers: Arc::clone(&peers),
            directory: Arc::clone(&ordering.directory),
            rejections: Arc::clone(&clients.rejections),
        };
        let engines = ordering.engines(&executor, ballots, Arc::new(outlet));
        let (waiters, clock) = (Arc::clone(&ordering.waiters), ordering.clock.clone());
        let housekeeping = storage.housekeeping(move || waiters.sweep(clock.elapsed()))?;
        let services = Services {
            gateway: clients.gateway.clone(),
            enrolment: enrolment.clone(),
            peer: peers.service(&ordering),
            trust: Arc::clone(&trust.organisations),
            members,
        };
        Ok((Self { ordering, trust, peers, clients, enrolment, engines, checks, housekeeping }, services))
    }

    /// Starts the engine, which asks the other nodes first. Its services must be served by now: others that start at the same
    /// time ask this node, too.
    ///
    /// # Errors
    /// A fault that keeps an engine from starting; a voter that has lost its blocks.
    pub(crate) async fn begin(self, timing: Timing, stopping: watch::Receiver<bool>) -> Result<Running, Rejection> {
        let Self { ordering, trust, peers, clients, enrolment, engines, checks, housekeeping } = self;
        let (storage, author) = (Arc::clone(&ordering.storage), ordering.author(&trust.identity));
        let me = trust.me.clone();
        let receipts = trust.receipt_secret(storage.ledger.network());
        let sync = peers.sync(&ordering, &engines.executor, &trust, stopping);
        let conductor = Conductor::new((me.id, receipts), timing, engines, sync).begin().await?;
        let scrub = storage.scrub(ordering.failure.clone())?;
        let telling = Telling { author: Arc::clone(&author), me: me.id };
        let renewer = trust.renewer(&ordering, &enrolment);
        let (failure, members) = (ordering.failure.clone(), ordering.directory.subscribe());
        let mut beside = vec![
            tokio::spawn(vital_task(renewer.keep())),
            tokio::spawn(vital_task(async move { failure.fail(removed(me, members).await) })),
            tokio::spawn(vital_task(telling.run())),
            tokio::spawn(vital_task(async move { enrolment.keep_registered().await })),
        ];
        beside.extend(checks.start());
        beside.extend(clients.start(&author));
        let certificates = Arc::clone(&peers.certificates);
        Ok(Running { ordering, certificates, clients, housekeeping, scrub, conductor, beside })
    }
}

impl Running {
    /// No new calls: the leadership goes to another voter, what goes on beside ends.
    pub(crate) async fn leave(&self) {
        self.ordering.hand_over().await;
        self.beside.iter().for_each(JoinHandle::abort);
        self.clients.close();
    }

    /// Ends the engine, then the stores. The host has been told to stop.
    pub(crate) async fn stop(self) {
        // A panic of it would have ended the process.
        let _ended = self.conductor.await;
        let (ordering, certificates) = (Arc::clone(&self.ordering), self.certificates);
        let (housekeeping, scrub) = (self.housekeeping, self.scrub);
        let ended = tokio::task::spawn_blocking(move || {
            scrub.stop();
            ordering.slot.stop();
            if let Err(fault) = certificates.keep_newest(&ordering.storage.ledger) {
                tracing::warn!(code = fault.code.name(), reason = %fault, "cannot store the newest proof");
            }
            housekeeping.stop();
        });
        if ended.await.is_err() {
            tracing::error!("a thread panicked during shutdown");
        }
        tracing::info!(height = self.ordering.storage.ledger.tip().height, "stopped");
    }
}
