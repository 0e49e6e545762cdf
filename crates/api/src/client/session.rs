//! The one connection of a client, and its replacement when it breaks.
//!
//! One task owns the connection: it takes the answers to transactions, and when the connection breaks, or is found
//! wanting, opens another one to the next node. A second task wakes ten times a second for deadlines and retries.

use super::Options;
use super::clock::{Clock, middle};
use super::in_flight::{Effect, InFlight, Patience, Pending, Sent};
use crate::connect::{Connection, Credentials};
use crate::tls::TlsIdentity;
use crate::v1::enrolment_client::EnrolmentClient;
use crate::v1::gateway_client::GatewayClient;
use crate::v1::{NetworkRequest, SubmitRequest, SubmitResponse};
use ledger::transaction::Transaction;
use ledger::{Bytes, Class, Code, Hash, Rejection};
use rustls::ClientConfig;
use std::pin::pin;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Weak};
use std::time::{Duration, Instant};
use tokio::sync::{OwnedSemaphorePermit, mpsc, watch};
use tokio::time::{MissedTickBehavior, interval, sleep, timeout};
use tokio_stream::StreamExt;
use tokio_stream::wrappers::UnboundedReceiverStream;
use tonic::Streaming;
use tonic::transport::Channel;

/// Largest message that a node may send, in bytes: a full block with its events.
const MESSAGE_BYTES_MAX: usize = 32 * 1024 * 1024;
/// How often deadlines and retries are looked at.
const SWEEP_EVERY: Duration = Duration::from_millis(100);
/// Pause between rounds over all nodes: doubles from the first to the second.
const PAUSE_MIN: Duration = Duration::from_millis(50);
const PAUSE_MAX: Duration = Duration::from_secs(1);
/// A connection that lived shorter is not replaced without a pause.
const SHORT_LIFE: Duration = Duration::from_secs(1);

/// The state of a client that its clones share.
pub(super) struct Session {
    pub(super) in_flight: InFlight,
    pub(super) clock: Clock,
    pub(super) options: Options,
    link: watch::Sender<Link>,
    /// Number of the newest connection that somebody found wanting.
    unwanted: watch::Sender<u64>,
    /// Is there another node to go to?
    pub(super) several: bool,
    /// Largest height seen in an answer or delivery.
    seen: Arc<AtomicU64>,
}

/// The connection as it is now.
struct Link {
    /// Counts connections, so that nobody complains about a new one for the faults of the old one.
    number: u64,
    connection: Connection,
    /// Why it is not usable, if it is not.
    broken: Option<Rejection>,
}

/// A connection in use, and which one it is.
pub(super) struct Up {
    pub(super) number: u64,
    pub(super) connection: Connection,
}

impl Up {
    pub(super) fn gateway(&self) -> GatewayClient<Channel> {
        GatewayClient::new(self.connection.channel.clone()).max_decoding_message_size(MESSAGE_BYTES_MAX)
    }

    pub(super) fn enrolment(&self) -> EnrolmentClient<Channel> {
        EnrolmentClient::new(self.connection.channel.clone()).max_decoding_message_size(MESSAGE_BYTES_MAX)
    }
}

impl Session {
    /// Connects to the first node that answers and starts the tasks.
    pub(super) async fn start(
        nodes: Vec<String>,
        credentials: &Credentials,
        options: Options,
    ) -> Result<Arc<Self>, Rejection> {
        let mut dialer = Dialer {
            nodes,
            at: 0,
            tls: Arc::clone(&credentials.tls),
            identity: credentials.identity.clone(),
            network: credentials.network,
            patience: options.connect,
            seen: Arc::default(),
        };
        let opened = dialer.round().await?;
        let (link, _) = watch::channel(Link { number: 0, connection: opened.connection.clone(), broken: None });
        let (unwanted, complaints) = watch::channel(0);
        let several = dialer.nodes.len() > 1;
        let session = Arc::new(Self {
            in_flight: InFlight::new(credentials.identity.clone(), options.deadline, several),
            clock: Clock::new(),
            options,
            link,
            unwanted,
            several,
            seen: Arc::clone(&dialer.seen),
        });
        let answers = session.install(1, opened);
        let keeper = Keeper { session: Arc::downgrade(&session), dialer, complaints };
        tokio::spawn(keeper.run(answers));
        tokio::spawn(sweep(Arc::downgrade(&session)));
        Ok(session)
    }

    /// Sends a transaction for which there is room.
    pub(super) fn send(
        self: &Arc<Self>,
        transaction: &Transaction,
        room: OwnedSemaphorePermit,
        patience: Patience,
    ) -> Pending {
        Pending::sent(self.in_flight.add(transaction, room, patience), Arc::clone(self), transaction.id())
    }

    /// The connection, as soon as there is one.
    ///
    /// # Errors
    /// Why there will be none: a reason that waiting does not cure.
    pub(super) async fn up(&self) -> Result<Up, Rejection> {
        let mut link = self.link.subscribe();
        let state = link.wait_for(|link| link.broken.as_ref().is_none_or(is_final)).await;
        let state = state.map_err(|_| Rejection::new(Code::ShuttingDown, "the client is closed"))?;
        match &state.broken {
            Some(reason) => Err(reason.clone()),
            None => Ok(Up { number: state.number, connection: state.connection.clone() }),
        }
    }

    /// Why there is no connection now.
    pub(super) fn broken(&self) -> Option<Rejection> {
        self.link.borrow().broken.clone()
    }

    /// Asks for another connection than this one.
    pub(super) fn leave(&self, number: u64) {
        self.unwanted.send_if_modified(|unwanted| {
            let newer = number > *unwanted;
            *unwanted = number.max(*unwanted);
            newer
        });
    }

    /// Asks for a new connection in place of the one there is.
    pub(super) fn reconnect(&self) {
        let number = self.link.borrow().number;
        self.leave(number);
    }

    pub(super) fn address(&self) -> Arc<str> {
        Arc::clone(&self.link.borrow().connection.address)
    }

    pub(super) fn height_seen(&self) -> u64 {
        self.seen.load(Ordering::Relaxed)
    }

    pub(super) fn see(&self, height: u64) {
        self.seen.fetch_max(height, Ordering::Relaxed);
    }

    /// Asks the node for its clock.
    pub(super) async fn learn_clock(&self) -> Result<(), Rejection> {
        let up = timeout(self.options.deadline, self.up()).await.map_err(|_| self.no_connection())??;
        let asked = Instant::now();
        let answer = timeout(self.options.connect, up.enrolment().network(NetworkRequest {})).await;
        let answer = answer.map_err(|_| self.no_connection())?;
        let clock = answer.map_err(|status| up.connection.refusal(&status))?.into_inner().clock;
        self.clock.learn(clock, middle(asked));
        Ok(())
    }

    /// No node answers in time, and why.
    pub(super) fn no_connection(&self) -> Rejection {
        self.broken().unwrap_or_else(|| {
            let address = self.address();
            crate::connect::unreachable(&address, &format!("no answer within {} s", self.options.deadline.as_secs()))
        })
    }

    /// Puts a new connection into use; what waits goes out over it.
    fn install(&self, number: u64, opened: Opened) -> Streaming<SubmitResponse> {
        let Opened { connection, requests, answers, clock, at } = opened;
        self.clock.learn(clock, at);
        self.in_flight.attach(requests);
        self.link.send_replace(Link { number, connection, broken: None });
        answers
    }

    /// The connection broke.
    fn uninstall(&self, reason: Rejection) {
        tracing::debug!(reason = %reason.message, found = %reason.found, "connection lost");
        self.link.send_modify(|link| link.broken = Some(reason));
        self.in_flight.detach();
    }

    fn answer(&self, answer: SubmitResponse, number: u64) {
        self.see(answer.height);
        match self.in_flight.answer(answer) {
            Effect::Leave if self.several => self.leave(number),
            Effect::Nothing | Effect::Leave => {}
            Effect::DoubtClock => self.clock.doubt(),
        }
    }
}

/// Is it a reason that waiting does not cure?
pub(super) fn is_final(reason: &Rejection) -> bool {
    reason.code.class() != Class::Unreachable
}

/// Opens connections, one node after the other.
struct Dialer {
    nodes: Vec<String>,
    /// Index of the node to try next.
    at: usize,
    tls: Arc<ClientConfig>,
    identity: TlsIdentity,
    network: Hash,
    patience: Duration,
    /// Largest height seen: a node that is behind it waits before it looks at a transaction.
    seen: Arc<AtomicU64>,
}

/// A connection with its stream of transactions.
struct Opened {
    connection: Connection,
    requests: mpsc::UnboundedSender<Sent>,
    answers: Streaming<SubmitResponse>,
    /// What the node's clock showed at a moment.
    clock: u64,
    at: Instant,
}

impl Dialer {
    /// Tries each node once, beginning after the last one that was tried.
    async fn round(&mut self) -> Result<Opened, Rejection> {
        let mut refusals = Vec::new();
        for _ in 0..self.nodes.len() {
            let at = self.at % self.nodes.len();
            self.at = at + 1;
            let Some(address) = self.nodes.get(at) else { continue };
            match self.open(address).await {
                Ok(opened) => return Ok(opened),
                Err(refused) => refusals.push(refused),
            }
        }
        Err(summary(refusals))
    }

    async fn open(&self, address: &str) -> Result<Opened, Rejection> {
        let certificate = Bytes::copy_from_slice(self.identity.own().certificate());
        let connection = Connection::open(address, Arc::clone(&self.tls), &certificate, self.patience).await?;
        let late =
            || crate::connect::unreachable(address, &format!("no answer within {} ms", self.patience.as_millis()));
        let up = Up { number: 0, connection };
        let asked = Instant::now();
        let network = timeout(self.patience, up.enrolment().network(NetworkRequest {})).await.map_err(|_| late())?;
        let network = network.map_err(|status| up.connection.refusal(&status))?.into_inner();
        let (clock, at) = (network.clock, middle(asked));
        if network.network != self.network.as_ref() {
            return Err(Rejection::new(Code::WrongNetwork, format!("the node at {address} is of another network"))
                .found(format!("network {} {:?}", hex::encode(&network.network), network.label))
                .wanted(format!("network {}", self.network))
                .next("check the address, or select the context of that network"));
        }
        let (requests, outgoing) = mpsc::unbounded_channel();
        let seen = Arc::clone(&self.seen);
        let outgoing = UnboundedReceiverStream::new(outgoing).map(move |Sent { transaction, first_attempt }| {
            SubmitRequest { transaction, min_height: seen.load(Ordering::Relaxed), first_attempt }
        });
        let mut gateway = up.gateway();
        let answers = timeout(self.patience, gateway.submit_stream(outgoing)).await;
        let answers = answers.map_err(|_| late())?.map_err(|status| up.connection.refusal(&status))?.into_inner();
        Ok(Opened { connection: up.connection, requests, answers, clock, at })
    }
}

/// One refusal for those of all nodes: final only if each of them is.
fn summary(refusals: Vec<Rejection>) -> Rejection {
    let found: Vec<_> = refusals.iter().map(|refused| format!("{} ({})", refused.message, refused.found)).collect();
    let count = refusals.len();
    let hopeless = refusals.iter().all(is_final);
    match refusals.into_iter().next() {
        None => Rejection::new(Code::BadArgument, "there is no node to connect to")
            .wanted("at least one address, HOST:PORT")
            .next("add one to `nodes` in context.toml"),
        Some(first) if count == 1 || hopeless => first,
        Some(first) => Rejection::new(Code::Unreachable, format!("none of {count} nodes can be reached"))
            .found(found.join("; "))
            .wanted(first.wanted)
            .next(first.next),
    }
}

/// Owns the connection as long as anybody has the client.
struct Keeper {
    session: Weak<Session>,
    dialer: Dialer,
    complaints: watch::Receiver<u64>,
}

impl Keeper {
    async fn run(mut self, mut answers: Streaming<SubmitResponse>) {
        for number in 1.. {
            let since = Instant::now();
            let Some(reason) = self.serve(&mut answers, number).await else { return };
            let Some(session) = self.session.upgrade() else { return };
            session.uninstall(reason);
            drop(session);
            if since.elapsed() < SHORT_LIFE {
                sleep(PAUSE_MIN).await;
            }
            let Some(opened) = self.reopen().await else { return };
            let Some(session) = self.session.upgrade() else { return };
            answers = session.install(number + 1, opened);
        }
    }

    /// Takes answers until the connection breaks or is found wanting; says why. `None` if the client is gone.
    async fn serve(&mut self, answers: &mut Streaming<SubmitResponse>, number: u64) -> Option<Rejection> {
        let mut complaint = pin!(self.complaints.wait_for(|unwanted| *unwanted >= number));
        loop {
            let answer = tokio::select! {
                biased;
                answer = answers.message() => answer,
                complaint = &mut complaint => {
                    complaint.ok()?;
                    let address = self.session.upgrade()?.address();
                    return Some(crate::connect::unreachable(&address, "the node could not serve, another one is tried"));
                }
            };
            let session = self.session.upgrade()?;
            match answer {
                Ok(Some(answer)) => session.answer(answer, number),
                Ok(None) => {
                    return Some(crate::connect::unreachable(&session.address(), "the node closed the connection"));
                }
                Err(status) => return Some(session.link.borrow().connection.refusal(&status)),
            }
        }
    }

    /// Opens the next connection, however long it takes. `None` if the client is gone.
    async fn reopen(&mut self) -> Option<Opened> {
        let mut pause = PAUSE_MIN;
        loop {
            match self.dialer.round().await {
                Ok(opened) => return Some(opened),
                Err(reason) => self.session.upgrade()?.link.send_modify(|link| link.broken = Some(reason)),
            }
            sleep(pause).await;
            pause = (pause * 2).min(PAUSE_MAX);
        }
    }
}

/// Looks at deadlines and retries as long as anybody has the client.
async fn sweep(session: Weak<Session>) {
    let mut ticks = interval(SWEEP_EVERY);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        ticks.tick().await;
        let Some(session) = session.upgrade() else { return };
        let (number, broken) = {
            let link = session.link.borrow();
            (link.number, link.broken.clone())
        };
        if session.in_flight.sweep(Instant::now(), broken.as_ref()) {
            session.leave(number);
        }
        if session.clock.take_doubt() {
            // In its own task: deadlines must not wait for a node.
            tokio::spawn(async move { session.learn_clock().await });
        }
    }
}
