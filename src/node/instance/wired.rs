//! The parts of an instance that know each other. Each of its services takes the few that it needs.

use super::Standing;
use super::outlet::ToSubsystems;
use super::revocations::Revocations;
use crate::clients::audit::Audit;
use crate::clients::gateway::{
    Answers, Audience, Bounds, Chain, Description, GatewayService, Intake, Looks, Nodes, Proofs, Questions, Records,
    Submissions, Subscriptions, Usage,
};
use crate::clients::rejection_reports::Refusing;
use crate::clients::rejections::Rejections;
use crate::node::host::{Deliver, Host};
use crate::ordering::directory::{Directory, Member};
use crate::ordering::node_transactions::{Author, Signer};
use crate::ordering::orderer::{Engines, Executed, Outside, Pace};
use crate::ordering::orderer_slot::OrdererSlot;
use crate::ordering::reads::ReadIndex;
use crate::ordering::waiters::Waiters;
use crate::peers::attestation::{Seen, Testimony, Witness};
use crate::peers::chain_monitor::{Asking, ChainMonitor};
use crate::peers::connections::{Dialer, Peers};
use crate::peers::early_stop::EarlyStops;
use crate::peers::question::Bootstrap;
use crate::peers::quorum_certificates::{Certificates, Certifying, Keys, Told, era};
use crate::peers::reachability::Reachability;
use crate::peers::service::PeerService;
use crate::peers::sync::{BlockSync, Destination, Source};
use crate::process::caller::Members;
use crate::process::clock::{Clock, wall};
use crate::process::config::Config;
use crate::process::config::count;
use crate::process::failure::FailureHandle;
use crate::process::meters::{Meters, Traced};
use crate::storage::blocks::Blocks;
use crate::storage::housekeeping::Housekeeping;
use crate::storage::log::Log;
use crate::storage::retention::Pruner;
use crate::storage::space::Space;
use crate::storage::stores::Stores;
use crate::trust::credentials::NodeCredentials;
use crate::trust::enrolment::{EnrolmentService, LedgerClient, Surroundings};
use bytes::Bytes;
use ledger::Ledger;
use ledger_api::tls::{TlsIdentity, TrustSource};
use ledger_base::rejection::{Code, Rejection};
use ledger_raft::{Input, PeerMessage, ReceiptKey, Secret};
use ledger_replica::catch_up::Ballot;
use ledger_replica::certifier::Certifier;
use ledger_replica::gateway::Shares;
use ledger_replica::{Executor, Observer, Retries, Voting};
use ledger_traces::Tracer;
use std::io;
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};
use tokio::sync::{mpsc, watch};

/// The parts of an instance that know each other.
pub(super) struct Wired {
    /// This node, as it was known when it started.
    pub me: Member,
    /// Its certificate and key.
    pub identity: TlsIdentity,
    /// The ledger and the files below it.
    pub stores: Stores,
    /// The parts that hear of each executed block.
    pub followers: Followers,
    /// Tells robots of stops before they are ordered.
    pub early: Arc<EarlyStops>,
    /// The ways to be ordered through this node.
    pub links: Reachability,
    /// Starts its orderer.
    pub engines: Engines,
    /// How to call the others.
    pub dialer: Dialer,
    /// The calls that each identity has in flight.
    pub shares: Arc<Shares>,
    /// The connections of members.
    pub members: Arc<Members>,
    /// The index of the audit.
    pub audit: Arc<Audit>,
    /// Where the steps of messages are told.
    pub tracer: Tracer,
    /// Rejected calls.
    pub rejections: Arc<Rejections>,
}

/// The parts that hear of each executed block.
pub(super) struct Followers {
    clock: Clock,
    waiters: Arc<Waiters>,
    directory: Arc<Directory>,
    witness: Arc<Witness>,
    company: Arc<ChainMonitor>,
    certificates: Arc<Certificates>,
    blocks: Arc<Blocks>,
    current: ReadIndex,
    executed: Arc<Executed>,
}

impl Followers {
    /// The followers of this ledger, and the attestations that they will have seen.
    fn new(
        stores: &Stores,
        directory: &Arc<Directory>,
        slot: &Arc<OrdererSlot>,
        (clock, company, certificates): (Clock, ChainMonitor, Arc<Certificates>),
    ) -> (Self, mpsc::UnboundedReceiver<Seen>) {
        let blocks = Arc::new(Blocks::new(Arc::clone(&stores.ledger), Arc::clone(&stores.store)));
        let (witness, seen) = Witness::new();
        let followers = Self {
            waiters: Arc::default(),
            directory: Arc::clone(directory),
            witness,
            company: Arc::new(company),
            certificates,
            current: ReadIndex::new(Arc::clone(slot), Arc::clone(&blocks), clock.clone()),
            blocks,
            executed: Arc::default(),
            clock,
        };
        (followers, seen)
    }

    /// Executes blocks, and tells the followers. Clients that wait for a verdict are told first.
    fn executor(&self, ledger: &Arc<Ledger>, members: &Arc<Members>, tracer: &Tracer) -> Arc<Executor> {
        let observers: Vec<Arc<dyn Observer>> = vec![
            Arc::new(self.clock.clone()),
            Arc::clone(&self.waiters) as _,
            Arc::clone(&self.directory) as _,
            Arc::clone(&self.witness) as _,
            Arc::clone(&self.certificates) as _,
            Arc::clone(&self.blocks) as _,
            Arc::new(self.current.clone()),
            Arc::clone(&self.executed) as _,
            Arc::new(Revocations::new(members, ledger)),
            Arc::new(Traced(tracer.clone())),
        ];
        Arc::new(Executor::new(Arc::clone(ledger), observers))
    }
}

impl Wired {
    /// The secret behind this node's receipts, on this network.
    pub(super) fn secret(&self) -> Secret {
        let purpose = [&b"ledgerd receipts v1\0"[..], &self.stores.ledger.network().0].concat();
        Secret(self.identity.own().key.secret_for(&purpose))
    }

    /// Makes this node's receipts, and knows them again.
    fn receipts(&self) -> ReceiptKey {
        ReceiptKey::new(self.me.id, &self.secret())
    }

    /// Makes the parts and tells them of each other. Answers also with the attestations that they will have seen, and with
    /// the blocks that the certifier will hear of.
    pub(super) fn new(
        (papers, config): (&NodeCredentials, &Config),
        (stores, trust): (&Stores, &Arc<dyn TrustSource>),
        (standing, clock, members): (&Standing, Clock, Arc<Members>),
    ) -> Result<(Self, mpsc::UnboundedReceiver<Seen>, mpsc::UnboundedReceiver<Told>), Rejection> {
        let (me, identity, ledger) = (standing.me.clone(), papers.identity.clone(), &stores.ledger);
        let (slot, pace) = (Arc::new(OrdererSlot::empty()), Pace::of(config.profile)?);
        let dialer = Dialer {
            me: me.id,
            network: ledger.network(),
            organisation: me.organisation.clone(),
            identity: identity.clone(),
            trust: Arc::clone(trust),
            paces: Arc::default(),
        };
        let company = ChainMonitor::new(ledger, &me.organisation, config.data.clone());
        let (certificates, stated) = Certificates::open(&config.data)?;
        let (followers, seen) =
            Followers::new(stores, &standing.directory, &slot, (clock.clone(), company, certificates));
        let (peers, space) = (Peers::new(dialer.clone()), Arc::new(Space::open(&config.data)));
        peers.follow(&standing.directory);
        let rejections: Arc<Rejections> = Arc::default();
        let outside = Outside {
            directory: Arc::clone(&standing.directory),
            outlet: Arc::new(ToSubsystems {
                peers: Arc::clone(&peers),
                reads: followers.current.clone(),
                rejections: Arc::clone(&rejections),
                certificates: Arc::clone(&followers.certificates),
            }),
            behind: watch::Sender::new(None),
            failure: FailureHandle::new(config),
        };
        let meters = Meters::default();
        let tracer = Tracer::start(&config.traces, "ledgerd", &me.full_name());
        let keys = Keys::new(me.id, identity.clone(), Arc::clone(ledger));
        let engines = Engines {
            executor: followers.executor(ledger, &members, &tracer),
            ballots: Arc::new(Voting::new(Arc::clone(ledger), keys)),
            waiters: Arc::clone(&followers.waiters),
            clock,
            log: Log { store: Arc::clone(&stores.store), space: Arc::clone(&space), flushed: meters.flush.clone() },
            pace,
            outside,
            meters,
        };
        let early = Arc::new(EarlyStops::new(Arc::clone(ledger), engines.clock.clone(), Arc::clone(&peers)));
        let links = Reachability { me: me.id, slot, directory: Arc::clone(&standing.directory), peers, space };
        let shares = Arc::new(Shares::new(count(config.limits.in_flight_max)));
        let stores = stores.clone();
        let audit = Audit::open(&config.data, ledger, (&followers.blocks, &links.space))?;
        let wired = Self {
            me,
            identity,
            stores,
            followers,
            early,
            links,
            engines,
            dialer,
            shares,
            members,
            audit,
            tracer,
            rejections,
        };
        Ok((wired, seen, stated))
    }

    /// The gateway of a node that started at this moment, in the network of that genesis.
    pub(super) fn gateway(&self, config: &Config, document: Bytes, started: Instant) -> GatewayService {
        let audience = Audience::new(config.limits.subscribers_max, self.me.organisation.clone());
        let (ledger, denials) = (&self.stores.ledger, &self.rejections);
        let Followers { clock, blocks, current, .. } = &self.followers;
        let workers = tokio::runtime::Handle::current().metrics().num_workers();
        let questions = Questions::new(workers, &self.shares);
        let records = Records {
            ledger: Arc::clone(ledger),
            blocks: Arc::clone(blocks),
            current: current.clone(),
            clock: clock.clone(),
            company: Arc::clone(&self.followers.company),
            links: self.links.clone(),
            questions: questions.clone(),
        };
        let subscriptions = Subscriptions {
            ledger: Arc::clone(ledger),
            blocks: Arc::clone(blocks),
            audience: Arc::clone(&audience),
            current: current.clone(),
            clock: clock.clone(),
            denials: Arc::clone(denials),
            early: Arc::clone(&self.early),
            questions: questions.clone(),
            certificates: Arc::clone(&self.followers.certificates),
        };
        let proofs = Proofs {
            ledger: Arc::clone(ledger),
            blocks: Arc::clone(blocks),
            genesis: document,
            certificates: Arc::clone(&self.followers.certificates),
            current: current.clone(),
            questions: questions.clone(),
        };
        let audit =
            Answers { audit: Arc::clone(&self.audit), ledger: Arc::clone(ledger), current: current.clone(), questions };
        let description = Arc::new(self.description(config, started, audience));
        GatewayService {
            nodes: Arc::new(Nodes::new(Arc::clone(&description), self.dialer.clone())),
            proofs: Arc::new(proofs),
            ledger: Arc::clone(ledger),
            clock: clock.clone(),
            submissions: Arc::new(self.submissions(config)),
            records: Arc::new(records),
            subscriptions: Arc::new(subscriptions),
            description,
            denials: Arc::clone(denials),
            audit: Arc::new(audit),
        }
    }

    fn submissions(&self, config: &Config) -> Submissions {
        let Followers { clock, waiters, current, .. } = &self.followers;
        let Pace { awake, turns, .. } = &self.engines.pace;
        let bounds = Bounds {
            payload_bytes_max: config.limits.payload_bytes_max,
            space: Arc::clone(&self.links.space),
            wait_max: config.order.timing().data_wait,
        };
        let intake = Intake {
            ledger: Arc::clone(&self.stores.ledger),
            clock: clock.clone(),
            bounds,
            retries: Retries::default(),
            waiters: Arc::clone(waiters),
            slot: Arc::clone(&self.links.slot),
            awake: Arc::clone(awake),
            denials: Arc::clone(&self.rejections),
            early: Arc::clone(&self.early),
            handed_over: self.engines.meters.gateway.clone(),
            committed: self.engines.meters.commit.clone(),
            tracer: self.tracer.clone(),
        };
        let looks = Looks::new(tokio::runtime::Handle::current().metrics().num_workers());
        Submissions { intake, shares: Arc::clone(&self.shares), looks, current: current.clone(), turns: *turns }
    }

    fn description(&self, config: &Config, started: Instant, audience: Arc<Audience>) -> Description {
        let Followers { clock, blocks, witness, company, certificates, executed, .. } = &self.followers;
        let chain = Chain {
            ledger: Arc::clone(&self.stores.ledger),
            blocks: Arc::clone(blocks),
            witness: Arc::clone(witness),
            company: Arc::clone(company),
            certificates: Arc::clone(certificates),
        };
        let usage = Usage {
            shares: Arc::clone(&self.shares),
            audience,
            denials: Arc::clone(&self.rejections),
            executed: Arc::clone(executed),
            limits: config.limits.clone(),
        };
        Description {
            me: self.me.clone(),
            label: self.stores.genesis.label.clone(),
            started,
            clock: clock.clone(),
            identity: self.identity.clone(),
            chain,
            links: self.links.clone(),
            usage,
            meters: self.engines.meters.clone(),
            awake: Arc::clone(&self.engines.pace.awake),
            tracer: self.tracer.clone(),
            console: OnceLock::new(),
        }
    }

    /// Attests what this node computed, and compares what others attest.
    pub(super) fn testimony(&self, config: &Config) -> Testimony {
        Testimony {
            author: self.author(),
            snapshots: Arc::clone(&self.stores.snapshots),
            store: Arc::clone(&self.stores.store),
            directory: Arc::clone(&self.links.directory),
            witness: Arc::clone(&self.followers.witness),
            company: Arc::clone(&self.followers.company),
            me: self.me.full_name(),
            every: Duration::from_millis(config.order.attest_ms),
        }
    }

    /// Asks the others whether they have the same chain.
    pub(super) fn asking(&self, config: &Config) -> Asking {
        let outside = self.engines.outside.clone();
        Asking {
            company: Arc::clone(&self.followers.company),
            ledger: Arc::clone(&self.stores.ledger),
            links: self.links.clone(),
            dialer: self.dialer.clone(),
            failure: outside.failure,
            behind: outside.behind,
            data: config.data.clone(),
        }
    }

    /// States what this node executed, and makes certificates of what others state.
    ///
    /// # Errors
    /// A fault of the store.
    pub(super) fn certifying(&self) -> Result<Certifying, Rejection> {
        let ledger = &self.stores.ledger;
        let keys = Keys::new(self.me.id, self.identity.clone(), Arc::clone(ledger));
        Ok(Certifying {
            certificates: Arc::clone(&self.followers.certificates),
            certifier: Certifier::new(self.me.id, ledger.network(), keys, era(ledger)?),
            ledger: Arc::clone(ledger),
            store: Arc::clone(&self.stores.store),
            peers: Arc::clone(&self.links.peers),
            directory: Arc::clone(&self.links.directory),
            me: self.me.id,
        })
    }

    /// Submits transactions of the node itself.
    pub(super) fn author(&self) -> Author {
        let ledger = Arc::clone(&self.stores.ledger);
        let signer = Signer::new(self.identity.clone(), ledger.network(), self.followers.clock.clone());
        Author { signer, ledger, slot: Arc::clone(&self.links.slot) }
    }

    /// Tells the ledger what this node refused.
    pub(super) fn refusing(&self) -> Refusing {
        Refusing {
            author: self.author(),
            denials: Arc::clone(&self.rejections),
            clock: self.followers.clock.clone(),
            space: Arc::clone(&self.links.space),
        }
    }

    /// Fetches what this node lacks.
    pub(super) fn catch_up(
        &self,
        bootstrap: Option<Bootstrap>,
        ballot: Ballot,
        stopping: watch::Receiver<bool>,
    ) -> BlockSync {
        let Engines { executor, log, outside, .. } = self.engines.clone();
        let into = Destination { log, executor, snapshots: Arc::clone(&self.stores.snapshots) };
        let (slot, dialer) = (Arc::clone(&self.links.slot), self.dialer.clone());
        let (directory, failure, receipts) = (outside.directory, outside.failure, self.receipts());
        BlockSync { bootstrap, into, directory, failure, slot, dialer, ballot, receipts, stopping }
    }

    pub(super) fn housekeeping(&self, pruner: Pruner) -> io::Result<Housekeeping> {
        let (waiters, clock) = (Arc::clone(&self.followers.waiters), self.followers.clock.clone());
        let sweep = move || waiters.sweep(clock.elapsed());
        Housekeeping::start(pruner, &self.links.space, sweep, Arc::clone(&self.engines.pace.bells))
    }

    pub(super) fn peer_service(&self, votes: Ballot) -> PeerService<Deliver> {
        let Reachability { slot, directory, peers, .. } = self.links.clone();
        let company = Arc::clone(&self.followers.company);
        let (stores, blocks) = ((&self.stores, self.receipts()), Arc::clone(&self.followers.blocks));
        let source = Source::new(stores, blocks, Arc::clone(&slot), Arc::clone(&company));
        let (certificates, early) = (Arc::clone(&self.followers.certificates), Arc::clone(&self.early));
        let deliver: Deliver = Box::new(move |from, message| {
            let message = match message {
                PeerMessage::Statement(statement) => {
                    certificates.hear(from, statement);
                    return true;
                }
                PeerMessage::Early(call) => {
                    early.passed_on(from, call.transaction);
                    return true;
                }
                message => message,
            };
            if votes.withholds(&message) || company.withholds(from, &message) {
                return true;
            }
            // Without an orderer, or with a full inbox, the message is lost, as a network might lose it: ordering
            // repeats what matters.
            !matches!(slot.input(Input::Message { from, message }), Err(reason) if reason.code == Code::ShuttingDown)
        });
        PeerService::new(peers, Arc::new(source), directory.subscribe(), deliver)
    }

    pub(super) fn enrolment(
        &self,
        (host, papers): (&Host, &NodeCredentials),
        document: Bytes,
        trust: &Arc<dyn TrustSource>,
    ) -> EnrolmentService {
        let voice = LedgerClient::through(&host.own_gateway(), self.stores.ledger.network(), &papers.identity, trust);
        let links = self.links.clone();
        let surroundings = Surroundings {
            me: self.me.clone(),
            identity: papers.identity.clone(),
            directory: Arc::clone(&self.links.directory),
            cut_off: Box::new(move || links.is_cut_off()),
        };
        let (authorities, ledger) = (Arc::clone(&papers.authorities), Arc::clone(&self.stores.ledger));
        EnrolmentService::new(authorities, ledger, surroundings, (self.stores.genesis.clone(), document), voice, wall)
    }
}
