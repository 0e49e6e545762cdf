//! A node: opens its stores, starts its roles, and ends them in order.

use crate::awake::Awake;
use crate::blocks::Blocks;
use crate::bridge::NodeBridge;
use crate::ca::check_secret;
use crate::catch_up::{Ballot, Bootstrap, CatchUp, Source};
use crate::clock::{Clock, wall};
use crate::conductor::Conductor;
use crate::config::Config;
use crate::denials::Denials;
use crate::enrolment::{Authorities, EnrolmentService, Surroundings, Voice};
use crate::gateway::{Audience, Current, GatewayService, NodeView, Shares};
use crate::housekeeping::{Bells, Housekeeping};
use crate::identity::{Joined, own_membership, removed};
use crate::join::{advised, check_member, nothing_here};
use crate::listen::accept;
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
use crate::witness::{Testimony, Witness};
use ledger::block::PAYLOAD_BYTES_MAX;
use ledger::{Chaincode, Ledger, Registry};
use ledger_abac::AccessControl;
use ledger_api::tls::{TlsIdentity, TrustSource, server_config};
use ledger_api::v1::enrolment_server::EnrolmentServer;
use ledger_api::v1::gateway_server::GatewayServer;
use ledger_api::v1::peer_server::PeerServer;
use ledger_identity::Identity;
use ledger_identity::msp::Msps;
use ledger_raft::{Input, PEER_MESSAGE_BYTES_MAX};
use ledger_rejection::{Code, Rejection};
use ledger_replica::{Executor, Observer, Retries};
use ledger_storage::layout::GENESIS_FILE;
use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr};
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::net::TcpListener;
use tokio::sync::watch;
use tokio::task::JoinHandle;
use tokio_rustls::TlsAcceptor;
use tonic::transport::Server;

/// The node's certificate, its CA behind it, in its data directory.
pub(crate) const CERTIFICATE_FILE: &str = "node.pem";
/// The node's key, in its data directory.
pub(crate) const KEY_FILE: &str = "node.key";
/// Bytes of one stream, and of one connection, that may be on their way: enough for a fast link's delay.
const WINDOW_BYTES: (u32, u32) = (1 << 20, 4 << 20);
/// Space around the payload in a message.
const MESSAGE_EXTRA_BYTES: usize = 64 * 1024;
/// Time that open calls have to end when the node stops.
const STOP_TIME_MAX: Duration = Duration::from_millis(500);

/// Collects what a node consists of. The chaincodes `msp` and `abac` are always installed.
#[derive(Clone, Default)]
pub struct NodeBuilder {
    registry: Registry,
    faults: Vec<Rejection>,
}

impl NodeBuilder {
    /// Installs a chaincode. Every node of the network needs the same ones.
    #[must_use]
    pub fn chaincode(mut self, chaincode: impl Chaincode + 'static) -> Self {
        if let Err(fault) = self.registry.install(Arc::new(chaincode)) {
            self.faults.push(fault);
        }
        self
    }

    /// The chaincodes that a node will have besides `msp`.
    ///
    /// # Errors
    /// If one of them cannot be installed.
    pub fn registry(&self) -> Result<Registry, Rejection> {
        if let Some(fault) = self.faults.first() {
            return Err(fault.clone());
        }
        let mut registry = self.registry.clone();
        registry.install(Arc::new(AccessControl::new()?))?;
        Ok(registry)
    }

    /// Starts a node in the directory that the configuration names.
    ///
    /// # Errors
    /// What is missing or wrong, in words for the operator.
    pub async fn start(&self, config: &Config) -> Result<Node, Rejection> {
        Node::start(self.registry()?, config).await.map_err(|reason| advised(reason, config))
    }
}

/// Why a node cannot go on as it is.
#[derive(Clone, Debug, PartialEq)]
pub enum Ended {
    /// It failed.
    Failed(Rejection),
    /// It took a snapshot from another node, in place of blocks that nobody has any more. Stopped and started again, it
    /// goes on from there.
    StartAgain,
}

/// A running node. Dropping it without [`Node::stop`] is like pulling the plug, which it survives.
pub struct Node {
    view: Arc<NodeView>,
    address: SocketAddr,
    ended: watch::Receiver<Option<Ended>>,
    housekeeping: Housekeeping,
    scrub: Scrub,
    bridge: Option<NodeBridge>,
    server: JoinHandle<()>,
    conductor: JoinHandle<()>,
    /// What goes on beside: renewing the certificate, attesting, watching whether the node still belongs here, telling the
    /// ledger what its CA knows, and which rules it speaks.
    beside: [JoinHandle<()>; 5],
    stop: watch::Sender<bool>,
}

impl Node {
    /// Collects what a node consists of.
    pub fn builder() -> NodeBuilder {
        NodeBuilder::default()
    }

    async fn start(registry: Registry, config: &Config) -> Result<Self, Rejection> {
        let started = Instant::now();
        let genesis_bytes =
            std::fs::read(config.data.join(GENESIS_FILE)).map_err(|error| nothing_here(config, &error))?;
        let Stores { genesis, ledger, store, snapshots } = Stores::open(config, &genesis_bytes, registry)?;
        let trust: Arc<dyn TrustSource> = Arc::new(Trust { ledger: Arc::clone(&ledger) });
        check_secret(
            &config.data.join(KEY_FILE),
            "if others may have read it, remove the node and let it join anew with another key",
        )?;
        let tls = TlsIdentity::from_pem_files(&config.data.join(CERTIFICATE_FILE), &config.data.join(KEY_FILE))
            .map_err(|error| Rejection::new(Code::BadFile, error.to_string()).next("restore the file from a copy"))?;
        let directory = Arc::new(Directory::read(&ledger));
        let authorities =
            Arc::new(Authorities::open(&config.data, (config.ca.certificate_days, config.ca.secret_days))?);
        renewal::revive(&config.data, &tls, &authorities, &ledger.msps())?;
        let joined = Joined::load(&config.data)?;
        let me = own_membership(&tls, &ledger, &genesis, &directory.members(), joined.as_ref())?;
        check_member(config, ledger.network(), &me)?;
        authorities.check_carried(&ledger, &me)?;
        let listener = listen(&config.listen).await?;
        let address = listener.local_addr().map_err(|error| Rejection::new(Code::Internal, error.to_string()))?;

        let clock = Clock::starting_at(ledger.tip().time);
        let (failed, ended) = watch::channel(None);
        let (again, told) = (failed.clone(), config.clone());
        let blocks = Arc::new(Blocks::new(Arc::clone(&ledger), Arc::clone(&store)));
        let waiters = Arc::new(Waiters::default());
        let space = Arc::new(Space::open(&config.data));
        let dialer = Dialer {
            me: me.id,
            organisation: me.organisation.clone(),
            identity: tls.clone(),
            trust: Arc::clone(&trust),
        };
        let peers = Peers::new(dialer.clone());
        let (seat, executed) = (Arc::new(Seat::empty()), Arc::new(Executed::default()));
        let current = Current::new(Arc::clone(&seat), Arc::clone(&blocks), clock.clone());
        let denials = Arc::new(Denials::default());
        let workers = tokio::runtime::Handle::current().metrics().num_workers();
        let (witness, seen) = Witness::new();
        let awake = Awake::start(config.profile)
            .map_err(|error| Rejection::new(Code::Internal, format!("cannot start a thread: {error}")))?;
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
        let id = me.id;
        let testimony = Testimony {
            shared: Arc::clone(&shared),
            seat: Arc::clone(&seat),
            dialer: dialer.clone(),
            signer: Signer::new(tls.clone(), ledger.network(), clock.clone()),
            me: me.full_name(),
            every: Duration::from_millis(config.order.attest_ms),
            data: config.data.clone(),
        };

        let telling = Telling {
            shared: Arc::clone(&shared),
            seat: Arc::clone(&seat),
            signer: Signer::new(tls.clone(), ledger.network(), clock.clone()),
            me: id,
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
        let source = Arc::new(Source::new(Arc::clone(&shared), Arc::clone(&seat)));
        let pruner = Pruner {
            ledger: Arc::clone(&ledger),
            store,
            snapshots: Arc::clone(&snapshots),
            retention: config.storage.retention,
            archive: Some(config.storage.archive.clone()).filter(|path| !path.as_os_str().is_empty()),
            data: config.data.clone(),
        };
        let housekeeping = Housekeeping::start(Arc::clone(&view), pruner, bells)
            .map_err(|error| Rejection::new(Code::Internal, format!("cannot start a thread: {error}")))?;
        let (inbox, ballot) = (Arc::clone(&seat), Ballot::default());
        let votes = ballot.clone();
        let peer_service = PeerService::new(peers, source, directory.subscribe(), move |from, message| {
            if votes.withholds(&message) {
                return true;
            }
            // Without an orderer, or with a full inbox, the message is lost, as a network might lose it: ordering
            // repeats what matters.
            !matches!(inbox.input(Input::Message { from, message }), Err(reason) if reason.code == Code::ShuttingDown)
        });
        let own_gateway = reachable(address).to_string();
        let voice = Voice::through(&own_gateway, ledger.network(), &tls, &trust);
        let document = (genesis, genesis_bytes.into());
        let standing = Arc::clone(&view);
        let surroundings = Surroundings {
            me: view.me.clone(),
            identity: tls.clone(),
            directory: Arc::clone(&directory),
            cut_off: Box::new(move || standing.is_cut_off()),
        };
        let enrolment = EnrolmentService::new(authorities, Arc::clone(&ledger), surroundings, document, voice, wall);
        let registrar = enrolment.clone();
        let keeper = Keeper {
            data: config.data.clone(),
            identity: tls.clone(),
            ledger: Arc::clone(&ledger),
            trust: Arc::clone(&trust),
            enrolment: enrolment.clone(),
            others: others_of_own_organisation(&view),
        };
        let server_tls =
            server_config(tls, Arc::clone(&trust)).map_err(|error| Rejection::new(Code::BadFile, error.to_string()))?;
        let connections = accept(listener, TlsAcceptor::from(Arc::new(server_tls)), trust);
        // More than is accepted: what is a little too large gets an answer that says so.
        let message_bytes_max = count(config.limits.payload_bytes_max).max(PAYLOAD_BYTES_MAX) + MESSAGE_EXTRA_BYTES;
        let (stop, mut stopping) = watch::channel(false);
        let server = Server::builder()
            .tcp_nodelay(true)
            .initial_stream_window_size(WINDOW_BYTES.0)
            .initial_connection_window_size(WINDOW_BYTES.1)
            .http2_keepalive_interval(Some(Duration::from_secs(5)))
            .http2_keepalive_timeout(Some(Duration::from_secs(5)))
            .add_service(
                GatewayServer::new(GatewayService { node: Arc::clone(&view) })
                    .max_decoding_message_size(message_bytes_max),
            )
            .add_service(EnrolmentServer::new(enrolment))
            .add_service(
                PeerServer::new(peer_service).max_decoding_message_size(PEER_MESSAGE_BYTES_MAX + MESSAGE_EXTRA_BYTES),
            )
            .serve_with_incoming_shutdown(connections, async move {
                let _stopped = stopping.wait_for(|stop| *stop).await;
            });
        let server = tokio::spawn(async move {
            if let Err(error) = server.await {
                tracing::error!(%error, "the server ended");
            }
        });
        // Only now, as others that start at the same time ask this node what it has, too.
        let bootstrap = joined.map(|joined| Bootstrap { addresses: joined.bootstrap, ca: joined.ca });
        let catch_up = CatchUp { bootstrap, shared, seat, dialer, ballot, stopping: stop.subscribe() };
        let conductor = match Conductor::new(id, config.order.clone(), catch_up).begin().await {
            Ok(conductor) => conductor,
            Err(reason) => {
                server.abort();
                return Err(reason);
            }
        };
        tracing::info!(%address, network = %ledger.network(), height = ledger.tip().height, "ready after {} ms", started.elapsed().as_millis());
        let scrub = Scrub::start(Arc::clone(&testimony.shared))
            .map_err(|error| Rejection::new(Code::Internal, format!("cannot start a thread: {error}")))?;
        let (me, members, fatal) = (view.me.clone(), directory.subscribe(), Arc::clone(&testimony.shared));
        let belonging = async move { (fatal.fatal)(removed(me, members).await) };
        let beside = [
            tokio::spawn(keeper.keep()),
            tokio::spawn(testimony.run(seen)),
            tokio::spawn(belonging),
            tokio::spawn(telling.run()),
            tokio::spawn(registrar.keep_registered()),
        ];
        let bridge = NodeBridge::start(config, own_gateway)?;
        Ok(Self { view, address, ended, housekeeping, scrub, bridge, server, conductor, beside, stop })
    }

    /// Where the node listens; the port is the real one where the configuration said 0.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// The ledger, for looking into it in the same process.
    pub fn ledger(&self) -> &Arc<Ledger> {
        &self.view.ledger
    }

    /// Waits until the node cannot go on as it is, and says why.
    pub async fn ended(&self) -> Ended {
        let mut ended = self.ended.clone();
        match ended.wait_for(Option::is_some).await {
            Ok(reason) => reason.clone(),
            Err(_) => None,
        }
        .unwrap_or_else(|| Ended::Failed(Rejection::new(Code::Internal, "the node ended without a reason")))
    }

    /// Ends the node: the leadership goes to another voter, no new calls, the verdicts that are under way, then the
    /// stores.
    pub async fn stop(self) {
        if let Some(bridge) = self.bridge {
            bridge.stop().await;
        }
        self.view.hand_over().await;
        self.beside.iter().for_each(JoinHandle::abort);
        self.view.shares.close();
        self.stop.send_replace(true);
        let mut server = self.server;
        if tokio::time::timeout(STOP_TIME_MAX, &mut server).await.is_err() {
            server.abort();
            let _aborted = server.await;
        }
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

/// Where this machine reaches a node that may listen on all its addresses.
fn reachable(mut address: SocketAddr) -> SocketAddr {
    if address.ip().is_unspecified() {
        address.set_ip(if address.is_ipv4() { Ipv4Addr::LOCALHOST.into() } else { Ipv6Addr::LOCALHOST.into() });
    }
    address
}

/// A number of the configuration as a count of things in memory.
pub(crate) fn count(number: u64) -> usize {
    usize::try_from(number).unwrap_or(usize::MAX)
}

async fn listen(address: &str) -> Result<TcpListener, Rejection> {
    TcpListener::bind(address).await.map_err(|error| {
        Rejection::new(Code::BadConfiguration, format!("cannot listen on {address}: {error}"))
            .next("choose another address with the setting listen, or end the process that uses this one")
    })
}

/// Where the nodes are that may carry the CA of this node's organisation.
fn others_of_own_organisation(view: &Arc<NodeView>) -> Box<dyn Fn() -> Vec<String> + Send + Sync> {
    let (me, directory) = (view.me.clone(), Arc::clone(&view.directory));
    Box::new(move || {
        let others = |member: &&Member| member.organisation == me.organisation && member.id != me.id;
        directory.members().iter().filter(others).map(|member| member.address.clone()).collect()
    })
}

/// What the node trusts: the organisations on its ledger.
struct Trust {
    ledger: Arc<Ledger>,
}

impl TrustSource for Trust {
    fn msps(&self) -> Arc<Msps> {
        self.ledger.msps()
    }

    fn now(&self) -> u64 {
        wall()
    }

    fn revoked(&self, identity: &Identity) -> bool {
        self.ledger.check_revoked(identity).is_err()
    }
}
