//! An instance: one ledger in this process. From the stores to the services, and back down in order.
//!
//! ```text
//! Stores ─ Standing ─ Wired ─ Prepared ─ Instance
//!   files    which     parts    its services    its engine
//!            node      that     can be called   runs
//!            this is   meet
//! ```
//!
//! It takes from its [`Host`] the parts that it shares with the process. So a process may hold several instances.

mod outlet;
mod revocations;
mod wired;

use crate::node::host::{Host, Services};
use crate::ordering::directory::{Directory, Member};
use crate::ordering::spoken_rules::Telling;
use crate::peers::attestation::{Seen, Testimony};
use crate::peers::chain_monitor::Asking;
use crate::peers::conductor::Conductor;
use crate::peers::question::Bootstrap;
use crate::peers::quorum_certificates::{Certifying, Told};
use crate::peers::reachability::Reachability;
use crate::process::clock::Clock;
use crate::process::config::Config;
use crate::process::failure::Ended;
use crate::process::failure::thread_error;
use crate::storage::housekeeping::Housekeeping;
use crate::storage::retention::Pruner;
use crate::storage::scrub::Scrub;
use crate::storage::stores::Stores;
use crate::trust::credentials::NodeCredentials;
use crate::trust::enrolment::EnrolmentService;
use crate::trust::membership::check_member;
use crate::trust::membership::{Joined, own_membership, removed};
use crate::trust::organisations::Trust;
use crate::trust::renewal;
use crate::trust::renewal::Renewer;
use bytes::Bytes;
use ledger::Ledger;
use ledger_api::tls::TrustSource;
use ledger_base::invariant::vital_task;
use ledger_base::rejection::Rejection;
use ledger_replica::Timing;
use ledger_replica::catch_up::Ballot;
use ledger_replica::gateway::Shares;
use std::sync::Arc;
use std::time::Instant;
use tokio::sync::{mpsc, watch};
use tokio::task::JoinHandle;
use wired::Wired;

/// Which node of the network this is.
struct Standing {
    me: Member,
    directory: Arc<Directory>,
    /// Set on a node that has joined.
    joined: Option<Joined>,
}

/// An instance whose services can be called, and whose engine does not run yet.
pub(crate) struct Prepared {
    wired: Wired,
    /// Attests, and hears of the attestations of others.
    testimony: (Testimony, mpsc::UnboundedReceiver<Seen>),
    asking: Asking,
    /// States what was executed, and hears of executed blocks.
    certifying: (Certifying, mpsc::UnboundedReceiver<Told>),
    joined: Option<Joined>,
    timing: Timing,
    ballot: Ballot,
    renewer: Renewer,
    registrar: EnrolmentService,
    housekeeping: Housekeeping,
}

/// A running instance.
pub(crate) struct Instance {
    /// Its ledger.
    pub(crate) ledger: Arc<Ledger>,
    /// Where its orderer is.
    links: Reachability,
    /// The calls that it has in flight.
    shares: Arc<Shares>,
    /// Why it cannot go on as it is.
    pub(crate) ended: watch::Receiver<Option<Ended>>,
    housekeeping: Housekeeping,
    scrub: Scrub,
    conductor: JoinHandle<()>,
    /// The tasks beside: renewing the certificate, attesting, certifying, asking the others, watching whether the node still
    /// belongs here, keeping the index of the audit. Three tell the ledger the knowledge of its CA, which rules it speaks, and what it
    /// refused.
    beside: [JoinHandle<()>; 9],
}

impl Standing {
    /// Finds out by the node's certificate and what joining left here.
    fn find(papers: &NodeCredentials, stores: &Stores, config: &Config) -> Result<Self, Rejection> {
        let ledger = &stores.ledger;
        let directory = Arc::new(Directory::read(ledger));
        renewal::revive(&config.data, &papers.identity, &papers.authorities, &ledger.msps())?;
        let joined = Joined::load(&config.data)?;
        let me = own_membership(&papers.identity, ledger, &stores.genesis, &directory.members(), joined.as_ref())?;
        check_member(config, ledger.network(), &me)?;
        papers.authorities.check_carried(ledger, &me)?;
        Ok(Self { me, directory, joined })
    }
}

impl Prepared {
    /// An instance of these stores, whose genesis is `document`, and its services for the host to serve.
    ///
    /// # Errors
    /// If this is no node of the network, or its certificate or CA is not usable.
    pub(crate) fn new(
        (host, papers): (&Host, NodeCredentials),
        config: &Config,
        (stores, document): (Stores, Bytes),
        started: Instant,
    ) -> Result<(Self, Services), Rejection> {
        let clock = Clock::of(host.clocks(), stores.ledger.tip().time);
        let trust: Arc<dyn TrustSource> = Arc::new(Trust::new(&stores.ledger, clock.clone()));
        let standing = Standing::find(&papers, &stores, config)?;
        let (wired, seen, stated) =
            Wired::new((&papers, config), (&stores, &trust), (&standing, clock, host.members()))?;
        let housekeeping =
            wired.housekeeping(pruner(&stores, &wired.links, config)).map_err(|error| thread_error(&error))?;
        let ballot = Ballot::default();
        let enrolment = wired.enrolment((host, &papers), document.clone(), &trust);
        let renewer = Renewer {
            data: config.data.clone(),
            identity: papers.identity.clone(),
            ledger: Arc::clone(&stores.ledger),
            trust: Arc::clone(&trust),
            enrolment: enrolment.clone(),
            others: others_of_own_organisation(&wired.me, &wired.links.directory),
        };
        let services = Services {
            gateway: wired.gateway(config, document, started),
            enrolment: enrolment.clone(),
            peer: wired.peer_service(ballot.clone()),
            trust,
            members: Arc::clone(&wired.members),
        };
        let (joined, timing, registrar) = (standing.joined, config.order.timing(), enrolment);
        let (testimony, asking) = ((wired.testimony(config), seen), wired.asking(config));
        let certifying = (wired.certifying()?, stated);
        let prepared =
            Self { wired, testimony, asking, certifying, joined, timing, ballot, renewer, registrar, housekeeping };
        Ok((prepared, services))
    }

    /// Starts the engine, which asks the other nodes first. Its services must be served by now: others that start at the same
    /// time ask this node, too.
    ///
    /// # Errors
    /// A fault that keeps an engine from starting; a voter that has lost its blocks.
    pub(crate) async fn begin(self, stopping: watch::Receiver<bool>) -> Result<Instance, Rejection> {
        let Self { wired, testimony, asking, certifying, joined, timing, ballot, renewer, .. } = self;
        let ((testimony, seen), (certifying, stated)) = (testimony, certifying);
        let (registrar, housekeeping) = (self.registrar, self.housekeeping);
        let telling = Telling { author: wired.author(), me: wired.me.id };
        let bootstrap = joined.map(|joined| Bootstrap { addresses: joined.bootstrap, ca: joined.ca });
        let (refusing, audit) = (wired.refusing(), Arc::clone(&wired.audit));
        let catch_up = wired.catch_up(bootstrap, ballot, stopping);
        let conductor =
            Conductor::new((wired.me.id, wired.secret()), timing, wired.engines.clone(), catch_up).begin().await?;
        let Wired { me, stores, links, shares, engines, .. } = wired;
        let (failure, members) = (engines.outside.failure, links.directory.subscribe());
        let scrub = Scrub::start(stores.store, failure.clone()).map_err(|error| thread_error(&error))?;
        let ended = failure.subscribe();
        let belonging = async move { failure.fail(removed(me, members).await) };
        let beside = [
            tokio::spawn(vital_task(renewer.keep())),
            tokio::spawn(vital_task(testimony.run(seen))),
            tokio::spawn(vital_task(asking.run())),
            tokio::spawn(vital_task(certifying.run(stated))),
            tokio::spawn(vital_task(belonging)),
            tokio::spawn(vital_task(telling.run())),
            tokio::spawn(vital_task(refusing.run())),
            tokio::spawn(vital_task(audit.keep())),
            tokio::spawn(vital_task(registrar.keep_registered())),
        ];
        Ok(Instance { ledger: stores.ledger, links, shares, ended, housekeeping, scrub, conductor, beside })
    }
}

impl Instance {
    /// No new calls: the leadership goes to another voter, what goes on beside ends.
    pub(crate) async fn leave(&self) {
        self.links.hand_over().await;
        self.beside.iter().for_each(JoinHandle::abort);
        self.shares.close();
    }

    /// Ends the engine, then the stores. The host has been told to stop.
    pub(crate) async fn stop(self) {
        // A panic of it would have ended the process.
        let _ended = self.conductor.await;
        let (slot, housekeeping, scrub) = (self.links.slot, self.housekeeping, self.scrub);
        let ended = tokio::task::spawn_blocking(move || {
            scrub.stop();
            slot.stop();
            housekeeping.stop();
        });
        if ended.await.is_err() {
            tracing::error!("a thread panicked while the node stopped");
        }
        tracing::info!(height = self.ledger.tip().height, "stopped");
    }
}

fn pruner(stores: &Stores, links: &Reachability, config: &Config) -> Pruner {
    Pruner {
        ledger: Arc::clone(&stores.ledger),
        store: Arc::clone(&stores.store),
        snapshots: Arc::clone(&stores.snapshots),
        space: Arc::clone(&links.space),
        retention: config.storage.retention,
        archive: Some(config.storage.archive.clone()).filter(|path| !path.as_os_str().is_empty()),
        data: config.data.clone(),
    }
}

/// Where the nodes are that may carry the CA of this node's organisation.
fn others_of_own_organisation(me: &Member, directory: &Arc<Directory>) -> Box<dyn Fn() -> Vec<String> + Send + Sync> {
    let (me, directory) = (me.clone(), Arc::clone(directory));
    Box::new(move || {
        let others = |member: &&Member| member.organisation == me.organisation && member.id != me.id;
        directory.members().iter().filter(others).map(|member| member.address.clone()).collect()
    })
}
