//! An instance: one ledger in this process. From the stores to the services, and back down in order.
//!
//! ```text
//! Stores ─ Standing ─ Wired ─ Prepared ─ Instance
//!   files    which     parts    its services    its engine
//!            node      that     can be called   runs
//!            this is   meet
//! ```
//!
//! What it shares with the process, it takes from its [`Host`]. So a process may hold several instances.

mod trust;

use crate::awake::Awake;
use crate::blocks::Blocks;
use crate::catch_up::{Ballot, Bootstrap, CatchUp, Source};
use crate::clock::{Clock, wall};
use crate::conductor::Conductor;
use crate::config::{Config, Order};
use crate::denials::Denials;
use crate::enrolment::{EnrolmentService, Surroundings, Voice};
use crate::gateway::{Audience, Current, GatewayService, NodeView, Shares};
use crate::host::{Deliver, Host, Papers, Services};
use crate::housekeeping::{Bells, Housekeeping};
use crate::identity::{Joined, own_membership, removed};
use crate::join::{advised, check_member};
use crate::orderer::{Executed, Seat, Shared};
use crate::peers::{Dialer, Directory, Member, PeerService, Peers};
use crate::renewal::{self, Keeper};
use crate::retention::Pruner;
use crate::scrub::Scrub;
use crate::signer::Signer;
use crate::slice::Turns;
use crate::space::Space;
use crate::speaks::Telling;
use crate::stores::Stores;
use crate::waiters::Waiters;
use crate::witness::{Seen, Testimony, Witness};
use bytes::Bytes;
use ledger_api::tls::TrustSource;
use ledger_raft::Input;
use ledger_rejection::{Code, Rejection};
use ledger_replica::{Executor, Observer, Retries};
use std::io;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::sync::{mpsc, watch};
use tokio::task::JoinHandle;
use trust::Trust;

/// Why a node cannot go on as it is.
#[derive(Clone, Debug, PartialEq)]
pub enum Ended {
    /// It failed.
    Failed(Rejection),
    /// It took a snapshot from another node, in place of blocks that nobody has any more. Stopped and started again, it
    /// goes on from there.
    StartAgain,
}

/// Which node of the network this is.
struct Standing {
    me: Member,
    directory: Arc<Directory>,
    /// Set on a node that has joined.
    joined: Option<Joined>,
}

/// The parts of an instance that know each other.
struct Wired {
    view: Arc<NodeView>,
    shared: Arc<Shared>,
    dialer: Dialer,
    testimony: Testimony,
    seen: mpsc::UnboundedReceiver<Seen>,
    ended: watch::Receiver<Option<Ended>>,
}

/// An instance whose services can be called, and whose engine does not run yet.
pub(crate) struct Prepared {
    wired: Wired,
    joined: Option<Joined>,
    order: Order,
    ballot: Ballot,
    keeper: Keeper,
    registrar: EnrolmentService,
    housekeeping: Housekeeping,
}

/// A running instance.
pub(crate) struct Instance {
    /// What the gateway sees of it.
    pub(crate) view: Arc<NodeView>,
    /// Why it cannot go on as it is.
    pub(crate) ended: watch::Receiver<Option<Ended>>,
    housekeeping: Housekeeping,
    scrub: Scrub,
    conductor: JoinHandle<()>,
    /// What goes on beside: renewing the certificate, attesting, watching whether the node still belongs here, telling the
    /// ledger what its CA knows, and which rules it speaks.
    beside: [JoinHandle<()>; 5],
}

impl Standing {
    /// Finds out by the node's certificate and what joining left here.
    fn find(papers: &Papers, stores: &Stores, config: &Config) -> Result<Self, Rejection> {
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

impl Wired {
    /// Makes the parts and tells them of each other.
    fn new(
        (papers, config): (&Papers, &Config),
        (stores, trust): (&Stores, &Arc<dyn TrustSource>),
        standing: &Standing,
        started: Instant,
    ) -> Result<Self, Rejection> {
        let Stores { genesis, ledger, store, snapshots } = stores.clone();
        let (me, directory) = (standing.me.clone(), Arc::clone(&standing.directory));
        let tls = papers.identity.clone();
        let clock = Clock::starting_at(ledger.tip().time);
        let (failed, ended) = watch::channel(None);
        let (again, told) = (failed.clone(), config.clone());
        let blocks = Arc::new(Blocks::new(Arc::clone(&ledger), Arc::clone(&store)));
        let waiters = Arc::new(Waiters::default());
        let space = Arc::new(Space::open(&config.data));
        let dialer = Dialer {
            me: me.id,
            network: ledger.network(),
            organisation: me.organisation.clone(),
            identity: tls.clone(),
            trust: Arc::clone(trust),
        };
        let peers = Peers::new(dialer.clone());
        let (seat, executed) = (Arc::new(Seat::empty()), Arc::new(Executed::default()));
        let current = Current::new(Arc::clone(&seat), Arc::clone(&blocks), clock.clone());
        let denials = Arc::new(Denials::default());
        let workers = tokio::runtime::Handle::current().metrics().num_workers();
        let (witness, seen) = Witness::new();
        let awake = Awake::start(config.profile).map_err(|error| no_thread(&error))?;
        let (awake, turns, bells) = (Arc::new(awake), Turns::of(config.profile), Arc::<Bells>::default());
        // Who waits for a verdict is told first.
        let observers: Vec<Arc<dyn Observer>> = vec![
            Arc::new(clock.clone()),
            Arc::clone(&waiters) as _,
            Arc::clone(&directory) as _,
            Arc::clone(&witness) as _,
            Arc::clone(&blocks) as _,
            Arc::new(current.clone()),
            Arc::clone(&executed) as _,
        ];
        let shared = Arc::new(Shared {
            ledger: Arc::clone(&ledger),
            store: Arc::clone(&store),
            snapshots: Arc::clone(&snapshots),
            blocks: Arc::clone(&blocks),
            waiters: Arc::clone(&waiters),
            current: current.clone(),
            executor: Arc::new(Executor::new(Arc::clone(&ledger), observers)),
            directory: Arc::clone(&directory),
            peers: Arc::clone(&peers),
            clock: clock.clone(),
            behind: watch::Sender::new(None),
            fatal: Box::new(move |reason| {
                let reason = advised(reason, &told);
                tracing::error!(%reason, "the node cannot continue");
                failed.send_replace(Some(Ended::Failed(reason)));
            }),
            start_again: Box::new(move || drop(again.send_replace(Some(Ended::StartAgain)))),
            space: Arc::clone(&space),
            denials: Arc::clone(&denials),
            witness: Arc::clone(&witness),
            awake: Arc::clone(&awake),
            turns,
            bells: Arc::clone(&bells),
        });
        peers.follow(&directory);
        let testimony = Testimony {
            shared: Arc::clone(&shared),
            seat: Arc::clone(&seat),
            dialer: dialer.clone(),
            signer: Signer::new(tls.clone(), ledger.network(), clock.clone()),
            me: me.full_name(),
            every: Duration::from_millis(config.order.attest_ms),
            data: config.data.clone(),
        };

        let audience = Audience::new(config.limits.subscribers_max, me.organisation.clone());
        let view = Arc::new(NodeView {
            me,
            label: genesis.label.clone(),
            ledger: Arc::clone(&ledger),
            blocks,
            waiters,
            denials,
            seat: Arc::clone(&seat),
            current,
            executed,
            directory: Arc::clone(&directory),
            peers: Arc::clone(&peers),
            limits: config.limits.clone(),
            shares: Shares::new(count(config.limits.in_flight_max), workers),
            retries: Retries::default(),
            wait_max: Duration::from_millis(config.order.wait_ms),
            audience,
            space,
            identity: tls.clone(),
            witness,
            awake: Arc::clone(&awake),
            turns,
            clock,
            started,
        });
        Ok(Self { view, shared, dialer, testimony, seen, ended })
    }
}

impl Prepared {
    /// An instance of these stores, whose genesis is `document`, and its services for the host to serve.
    ///
    /// # Errors
    /// If this is no node of the network, or its certificate or CA is not usable.
    pub(crate) fn new(
        (host, papers): (&Host, Papers),
        config: &Config,
        (stores, document): (Stores, Bytes),
        started: Instant,
    ) -> Result<(Self, Services), Rejection> {
        let trust: Arc<dyn TrustSource> = Arc::new(Trust::new(&stores.ledger));
        let standing = Standing::find(&papers, &stores, config)?;
        let wired = Wired::new((&papers, config), (&stores, &trust), &standing, started)?;
        let housekeeping =
            Housekeeping::start(Arc::clone(&wired.view), pruner(&stores, config), Arc::clone(&wired.shared.bells))
                .map_err(|error| no_thread(&error))?;
        let ballot = Ballot::default();
        let enrolment = wired.enrolment((host, &papers), (&stores, document), &trust);
        let keeper = Keeper {
            data: config.data.clone(),
            identity: papers.identity.clone(),
            ledger: Arc::clone(&stores.ledger),
            trust: Arc::clone(&trust),
            enrolment: enrolment.clone(),
            others: others_of_own_organisation(&wired.view),
        };
        let services = Services {
            gateway: GatewayService { node: Arc::clone(&wired.view) },
            enrolment: enrolment.clone(),
            peer: wired.peer_service(ballot.clone()),
            trust,
        };
        let (joined, order, registrar) = (standing.joined, config.order.clone(), enrolment);
        Ok((Self { wired, joined, order, ballot, keeper, registrar, housekeeping }, services))
    }

    /// Starts the engine, which asks the other nodes first. Its services must be served by now: others that start at the same
    /// time ask this node, too.
    ///
    /// # Errors
    /// What keeps an engine from starting; a voter that has lost its blocks.
    pub(crate) async fn begin(self, stopping: watch::Receiver<bool>) -> Result<Instance, Rejection> {
        let Self { wired, joined, order, ballot, keeper, registrar, housekeeping } = self;
        let Wired { view, shared, dialer, testimony, seen, ended } = wired;
        let (id, seat) = (view.me.id, Arc::clone(&view.seat));
        let bootstrap = joined.map(|joined| Bootstrap { addresses: joined.bootstrap, ca: joined.ca });
        let telling = Telling {
            shared: Arc::clone(&shared),
            seat: Arc::clone(&seat),
            signer: Signer::new(view.identity.clone(), view.ledger.network(), view.clock.clone()),
            me: id,
        };
        let catch_up = CatchUp { bootstrap, shared: Arc::clone(&shared), seat, dialer, ballot, stopping };
        let conductor = Conductor::new(id, order, catch_up).begin().await?;
        let scrub = Scrub::start(Arc::clone(&shared)).map_err(|error| no_thread(&error))?;
        let (me, members) = (view.me.clone(), view.directory.subscribe());
        let belonging = async move { (shared.fatal)(removed(me, members).await) };
        let beside = [
            tokio::spawn(keeper.keep()),
            tokio::spawn(testimony.run(seen)),
            tokio::spawn(belonging),
            tokio::spawn(telling.run()),
            tokio::spawn(registrar.keep_registered()),
        ];
        Ok(Instance { view, ended, housekeeping, scrub, conductor, beside })
    }
}

impl Wired {
    fn peer_service(&self, votes: Ballot) -> PeerService<Deliver> {
        let (inbox, source) =
            (Arc::clone(&self.view.seat), Source::new(Arc::clone(&self.shared), Arc::clone(&self.view.seat)));
        let deliver: Deliver = Box::new(move |from, message| {
            if votes.withholds(&message) {
                return true;
            }
            // Without an orderer, or with a full inbox, the message is lost, as a network might lose it: ordering
            // repeats what matters.
            !matches!(inbox.input(Input::Message { from, message }), Err(reason) if reason.code == Code::ShuttingDown)
        });
        PeerService::new(Arc::clone(&self.view.peers), Arc::new(source), self.view.directory.subscribe(), deliver)
    }

    fn enrolment(
        &self,
        (host, papers): (&Host, &Papers),
        (stores, document): (&Stores, Bytes),
        trust: &Arc<dyn TrustSource>,
    ) -> EnrolmentService {
        let voice = Voice::through(&host.own_gateway(), stores.ledger.network(), &papers.identity, trust);
        let standing = Arc::clone(&self.view);
        let surroundings = Surroundings {
            me: self.view.me.clone(),
            identity: papers.identity.clone(),
            directory: Arc::clone(&self.view.directory),
            cut_off: Box::new(move || standing.is_cut_off()),
        };
        let (authorities, ledger) = (Arc::clone(&papers.authorities), Arc::clone(&stores.ledger));
        EnrolmentService::new(authorities, ledger, surroundings, (stores.genesis.clone(), document), voice, wall)
    }
}

impl Instance {
    /// No new calls: the leadership goes to another voter, what goes on beside ends.
    pub(crate) async fn leave(&self) {
        self.view.hand_over().await;
        self.beside.iter().for_each(JoinHandle::abort);
        self.view.shares.close();
    }

    /// Ends the engine, then the stores. The host has been told to stop.
    pub(crate) async fn stop(self) {
        if self.conductor.await.is_err() {
            tracing::error!("the conductor panicked");
        }
        let (seat, housekeeping, scrub) = (Arc::clone(&self.view.seat), self.housekeeping, self.scrub);
        let ended = tokio::task::spawn_blocking(move || {
            scrub.stop();
            seat.stop();
            housekeeping.stop();
        });
        if ended.await.is_err() {
            tracing::error!("a thread panicked while the node stopped");
        }
        tracing::info!(height = self.view.ledger.tip().height, "stopped");
    }
}

fn pruner(stores: &Stores, config: &Config) -> Pruner {
    Pruner {
        ledger: Arc::clone(&stores.ledger),
        store: Arc::clone(&stores.store),
        snapshots: Arc::clone(&stores.snapshots),
        retention: config.storage.retention,
        archive: Some(config.storage.archive.clone()).filter(|path| !path.as_os_str().is_empty()),
        data: config.data.clone(),
    }
}

fn no_thread(error: &io::Error) -> Rejection {
    Rejection::new(Code::Internal, format!("cannot start a thread: {error}"))
}

/// A number of the configuration as a count of things in memory.
pub(crate) fn count(number: u64) -> usize {
    usize::try_from(number).unwrap_or(usize::MAX)
}

/// Where the nodes are that may carry the CA of this node's organisation.
fn others_of_own_organisation(view: &Arc<NodeView>) -> Box<dyn Fn() -> Vec<String> + Send + Sync> {
    let (me, directory) = (view.me.clone(), Arc::clone(&view.directory));
    Box::new(move || {
        let others = |member: &&Member| member.organisation == me.organisation && member.id != me.id;
        directory.members().iter().filter(others).map(|member| member.address.clone()).collect()
    })
}
