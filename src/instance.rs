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

mod fate;
mod revocations;
mod trust;

pub use fate::Ended;
pub(crate) use fate::Fate;

use crate::awake::Awake;
use crate::blocks::Blocks;
use crate::catch_up::{Bootstrap, CatchUp, Source};
use crate::clock::{Clock, wall};
use crate::conductor::Conductor;
use crate::config::{Config, Profile};
use crate::denials::Denials;
use crate::enrolment::{EnrolmentService, Surroundings, Voice};
use crate::gateway::{Audience, Current, GatewayService, Looks, NodeView};
use crate::host::{Deliver, Host, Members, Papers, Services};
use crate::housekeeping::{Bells, Housekeeping};
use crate::identity::{Joined, own_membership, removed};
use crate::join::check_member;
use crate::orderer::{Executed, Seat, Shared};
use crate::peers::{Dialer, Directory, Member, PeerService, Peers};
use crate::renewal::{self, Renewer};
use crate::retention::Pruner;
use crate::scrub::Scrub;
use crate::signer::{Author, Signer};
use crate::slice::Turns;
use crate::space::Space;
use crate::speaks::Telling;
use crate::stores::Stores;
use crate::waiters::Waiters;
use crate::witness::{Seen, Testimony, Witness};
use bytes::Bytes;
use ledger::Ledger;
use ledger_api::tls::TrustSource;
use ledger_raft::Input;
use ledger_rejection::{Code, Rejection};
use ledger_replica::catch_up::Ballot;
use ledger_replica::gateway::Shares;
use ledger_replica::{Executor, Observer, Retries, Timing};
use revocations::Revocations;
use std::io;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::sync::{mpsc, watch};
use tokio::task::JoinHandle;
use trust::Trust;

/// Which node of the network this is.
struct Standing {
    me: Member,
    directory: Arc<Directory>,
    /// Set on a node that has joined.
    joined: Option<Joined>,
}

/// The parts that hear of each executed block.
struct Followers {
    clock: Clock,
    waiters: Arc<Waiters>,
    directory: Arc<Directory>,
    witness: Arc<Witness>,
    blocks: Arc<Blocks>,
    current: Current,
    executed: Arc<Executed>,
}

/// The parts that keep the machine awake, and let it sleep.
struct Pace {
    awake: Arc<Awake>,
    turns: Turns,
    bells: Arc<Bells>,
}

/// The parts of an instance that know each other.
struct Wired {
    view: Arc<NodeView>,
    shared: Arc<Shared>,
    dialer: Dialer,
    testimony: Testimony,
    seen: mpsc::UnboundedReceiver<Seen>,
    fate: Fate,
    members: Arc<Members>,
}

/// An instance whose services can be called, and whose engine does not run yet.
pub(crate) struct Prepared {
    wired: Wired,
    joined: Option<Joined>,
    timing: Timing,
    ballot: Ballot,
    renewer: Renewer,
    registrar: EnrolmentService,
    housekeeping: Housekeeping,
}

/// A running instance.
pub(crate) struct Instance {
    /// The gateway's view of it.
    pub(crate) view: Arc<NodeView>,
    /// Why it cannot go on as it is.
    pub(crate) ended: watch::Receiver<Option<Ended>>,
    housekeeping: Housekeeping,
    scrub: Scrub,
    conductor: JoinHandle<()>,
    /// The tasks beside: renewing the certificate, attesting, watching whether the node still belongs here, telling the
    /// ledger the knowledge of its CA, and which rules it speaks.
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

impl Followers {
    /// The followers of this ledger, and the attestations that they will have seen.
    fn new(
        stores: &Stores,
        directory: &Arc<Directory>,
        seat: &Arc<Seat>,
        clock: Clock,
    ) -> (Self, mpsc::UnboundedReceiver<Seen>) {
        let blocks = Arc::new(Blocks::new(Arc::clone(&stores.ledger), Arc::clone(&stores.store)));
        let (witness, seen) = Witness::new();
        let followers = Self {
            waiters: Arc::default(),
            directory: Arc::clone(directory),
            witness,
            current: Current::new(Arc::clone(seat), Arc::clone(&blocks), clock.clone()),
            blocks,
            executed: Arc::default(),
            clock,
        };
        (followers, seen)
    }

    /// Executes blocks, and tells the followers. Clients that wait for a verdict are told first.
    fn executor(&self, ledger: &Arc<Ledger>, members: &Arc<Members>) -> Arc<Executor> {
        let observers: Vec<Arc<dyn Observer>> = vec![
            Arc::new(self.clock.clone()),
            Arc::clone(&self.waiters) as _,
            Arc::clone(&self.directory) as _,
            Arc::clone(&self.witness) as _,
            Arc::clone(&self.blocks) as _,
            Arc::new(self.current.clone()),
            Arc::clone(&self.executed) as _,
            Arc::new(Revocations::new(members, ledger)),
        ];
        Arc::new(Executor::new(Arc::clone(ledger), observers))
    }
}

impl Pace {
    fn of(profile: Profile) -> Result<Self, Rejection> {
        let awake = Arc::new(Awake::start(profile).map_err(|error| no_thread(&error))?);
        Ok(Self { awake, turns: Turns::of(profile), bells: Arc::default() })
    }
}

impl Wired {
    /// Makes the parts and tells them of each other.
    fn new(
        (papers, config): (&Papers, &Config),
        (stores, trust): (&Stores, &Arc<dyn TrustSource>),
        (standing, clock, members): (&Standing, Clock, Arc<Members>),
        started: Instant,
    ) -> Result<Self, Rejection> {
        let Stores { genesis, ledger, store, snapshots } = stores.clone();
        let me = standing.me.clone();
        let (seat, fate, pace) = (Arc::new(Seat::empty()), Fate::new(config), Pace::of(config.profile)?);
        let dialer = Dialer {
            me: me.id,
            network: ledger.network(),
            organisation: me.organisation.clone(),
            identity: papers.identity.clone(),
            trust: Arc::clone(trust),
        };
        let (followers, seen) = Followers::new(stores, &standing.directory, &seat, clock.clone());
        let executor = followers.executor(&ledger, &members);
        let Followers { waiters, directory, witness, blocks, current, executed, .. } = followers;
        let (peers, space, denials) =
            (Peers::new(dialer.clone()), Arc::new(Space::open(&config.data)), Arc::<Denials>::default());
        let testimony = Testimony {
            author: Author {
                signer: Signer::new(papers.identity.clone(), ledger.network(), clock.clone()),
                ledger: Arc::clone(&ledger),
                seat: Arc::clone(&seat),
            },
            snapshots: Arc::clone(&snapshots),
            directory: Arc::clone(&directory),
            witness: Arc::clone(&witness),
            fate: fate.clone(),
            dialer: dialer.clone(),
            me: me.full_name(),
            every: Duration::from_millis(config.order.attest_ms),
            data: config.data.clone(),
        };
        let shared = Arc::new(Shared {
            ledger: Arc::clone(&ledger),
            store,
            snapshots,
            blocks: Arc::clone(&blocks),
            waiters: Arc::clone(&waiters),
            current: current.clone(),
            executor,
            directory: Arc::clone(&directory),
            peers: Arc::clone(&peers),
            clock: clock.clone(),
            behind: watch::Sender::new(None),
            fate: fate.clone(),
            space: Arc::clone(&space),
            denials: Arc::clone(&denials),
            awake: Arc::clone(&pace.awake),
            turns: pace.turns,
            bells: pace.bells,
        });
        peers.follow(&directory);
        let workers = tokio::runtime::Handle::current().metrics().num_workers();
        let audience = Audience::new(config.limits.subscribers_max, me.organisation.clone());
        let view = Arc::new(NodeView {
            me,
            label: genesis.label,
            ledger,
            blocks,
            waiters,
            denials,
            seat,
            current,
            executed,
            directory,
            peers,
            limits: config.limits.clone(),
            shares: Shares::new(count(config.limits.in_flight_max)),
            looks: Looks::new(workers),
            retries: Retries::default(),
            wait_max: config.order.timing().data_wait,
            audience,
            space,
            identity: papers.identity.clone(),
            witness,
            awake: pace.awake,
            turns: pace.turns,
            clock,
            started,
        });
        Ok(Self { view, shared, dialer, testimony, seen, fate, members })
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
        let clock = Clock::of(host.clocks(), stores.ledger.tip().time);
        let trust: Arc<dyn TrustSource> = Arc::new(Trust::new(&stores.ledger, clock.clone()));
        let standing = Standing::find(&papers, &stores, config)?;
        let wired = Wired::new((&papers, config), (&stores, &trust), (&standing, clock, host.members()), started)?;
        let housekeeping = wired.housekeeping(pruner(&stores, config)).map_err(|error| no_thread(&error))?;
        let ballot = Ballot::default();
        let enrolment = wired.enrolment((host, &papers), (&stores, document), &trust);
        let renewer = Renewer {
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
            members: Arc::clone(&wired.members),
        };
        let (joined, timing, registrar) = (standing.joined, config.order.timing(), enrolment);
        Ok((Self { wired, joined, timing, ballot, renewer, registrar, housekeeping }, services))
    }

    /// Starts the engine, which asks the other nodes first. Its services must be served by now: others that start at the same
    /// time ask this node, too.
    ///
    /// # Errors
    /// A fault that keeps an engine from starting; a voter that has lost its blocks.
    pub(crate) async fn begin(self, stopping: watch::Receiver<bool>) -> Result<Instance, Rejection> {
        let Self { wired, joined, timing, ballot, renewer, registrar, housekeeping } = self;
        let Wired { view, shared, dialer, testimony, seen, fate, .. } = wired;
        let (id, seat) = (view.me.id, Arc::clone(&view.seat));
        let bootstrap = joined.map(|joined| Bootstrap { addresses: joined.bootstrap, ca: joined.ca });
        let telling = Telling {
            author: Author {
                signer: Signer::new(view.identity.clone(), view.ledger.network(), view.clock.clone()),
                ledger: Arc::clone(&view.ledger),
                seat: Arc::clone(&seat),
            },
            me: id,
        };
        let store = Arc::clone(&shared.store);
        let catch_up = CatchUp { bootstrap, shared, seat, dialer, ballot, stopping };
        let conductor = Conductor::new(id, timing, catch_up).begin().await?;
        let scrub = Scrub::start(store, fate.clone()).map_err(|error| no_thread(&error))?;
        let (me, members) = (view.me.clone(), view.directory.subscribe());
        let ended = fate.subscribe();
        let belonging = async move { fate.fail(removed(me, members).await) };
        let beside = [
            tokio::spawn(renewer.keep()),
            tokio::spawn(testimony.run(seen)),
            tokio::spawn(belonging),
            tokio::spawn(telling.run()),
            tokio::spawn(registrar.keep_registered()),
        ];
        Ok(Instance { view, ended, housekeeping, scrub, conductor, beside })
    }
}

impl Wired {
    fn housekeeping(&self, pruner: Pruner) -> io::Result<Housekeeping> {
        let (waiters, clock) = (Arc::clone(&self.view.waiters), self.view.clock.clone());
        Housekeeping::start(pruner, &self.view.space, (waiters, clock), Arc::clone(&self.shared.bells))
    }

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
