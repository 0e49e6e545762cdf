//! The one connection of a client, and its replacement when it breaks.
//!
//! One task owns the connection: it takes the answers to transactions, and when the connection breaks, or is found
//! wanting, opens another one to the next node. It looks around now and then: nodes join and go, and the one that we
//! have may be cut off from the others. A second task wakes ten times a second for deadlines and retries.

use super::Options;
use super::clock::{Clock, middle};
use super::dialer::{Dialer, Opened};
use super::in_flight::{Effect, InFlight, Sent};
use super::last_answers::LastAnswers;
use super::learning::{LOOK_EVERY, Look, Nodes, look_around};
use super::retry::{is_final, is_of_node};
use super::uplink::Uplink;
use crate::connect::{Connection, Credentials};
use crate::report::accepted;
use crate::v1::{NetworkRequest, NetworkResponse, SubmitResponse};
use bytes::Bytes;
use ledger::transaction::{KNOWN_HASH_BYTES, KnownBlock};
use ledger_base::rejection::{Code, Rejection};
use std::pin::{Pin, pin};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::time::{Duration, Instant};
use tokio::sync::watch;
use tokio::time::{MissedTickBehavior, interval, interval_at, sleep, timeout};
use tonic::Streaming;

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
    dialer: Dialer,
    nodes: Arc<Nodes>,
    /// Largest height seen in an answer or delivery.
    seen: Arc<AtomicU64>,
    /// The newest block that the connected node has reported, and when.
    known: Mutex<Option<Known>>,
    /// The nodes that could not serve.
    pub(super) last_answers: LastAnswers,
}

/// A block that a node has reported.
#[derive(Clone, Copy)]
struct Known {
    height: u64,
    hash: [u8; KNOWN_HASH_BYTES],
    since: Instant,
}

/// The connection as it is now.
struct Link {
    /// Counts connections, so that nobody complains about a new one for the faults of the old one.
    number: u64,
    connection: Connection,
    /// The organisations whose CA its node carries.
    carries: Vec<String>,
    /// Why it is not usable, if it is not.
    broken: Option<Rejection>,
}

impl Session {
    /// Connects to a node and starts the tasks.
    pub(super) async fn start(
        nodes: Nodes,
        credentials: &Credentials,
        options: Options,
    ) -> Result<Arc<Self>, Rejection> {
        let dialer = Dialer::new(credentials, options.connect);
        let opened = dialer.reach(&nodes.all()).await?;
        if nodes.learn(&opened.told, &opened.connection.address) {
            nodes.note().await;
        }
        let (unwanted, complaints) = watch::channel(0);
        let connection = opened.connection.clone();
        let (link, _) = watch::channel(Link { number: 0, connection, carries: Vec::new(), broken: None });
        let session = Arc::new(Self {
            in_flight: InFlight::new(credentials.identity.clone(), options.deadline, nodes.are_several()),
            clock: Clock::new(),
            options,
            link,
            unwanted,
            seen: Arc::clone(&dialer.seen),
            known: Mutex::default(),
            last_answers: LastAnswers::default(),
            dialer,
            nodes: Arc::new(nodes),
        });
        let answers = session.install(1, opened);
        let keeper = Reconnector { session: Arc::downgrade(&session), complaints };
        tokio::spawn(keeper.run(answers));
        tokio::spawn(sweep(Arc::downgrade(&session)));
        Ok(session)
    }

    /// The connection, as soon as there is one.
    ///
    /// # Errors
    /// Why there will be none: a reason that waiting does not cure.
    pub(super) async fn up(&self) -> Result<Uplink, Rejection> {
        let mut link = self.link.subscribe();
        let state = link.wait_for(|link| link.broken.as_ref().is_none_or(is_final)).await;
        let state = state.map_err(|_| Rejection::new(Code::ShuttingDown, "the client is closed"))?;
        match &state.broken {
            Some(reason) => Err(reason.clone()),
            None => Ok(Uplink { number: state.number, connection: state.connection.clone() }),
        }
    }

    /// A connection to a node that carries the CA of our organisation: ours if it does, another one if one does.
    ///
    /// # Errors
    /// As [`Session::up`].
    pub(super) async fn carrier(&self) -> Result<Uplink, Rejection> {
        let up = self.up().await?;
        let Some(own) = self.dialer.organisation() else { return Ok(up) };
        let carries = |carried: &[String]| carried.iter().any(|organisation| organisation == own);
        if carries(&self.link.borrow().carries) || !self.several() {
            return Ok(up);
        }
        match self.dialer.race(&self.nodes.all(), |opened| carries(&opened.told.carries), None).await {
            Ok(Opened { connection, .. }) => Ok(Uplink { number: 0, connection }),
            // The node that we have knows best why not.
            Err(_) => Ok(up),
        }
    }

    /// Is there another node to go to?
    pub(super) fn several(&self) -> bool {
        self.nodes.are_several()
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

    /// Stores a block that the node reports. The hash may be longer than the part by which it is named, or missing.
    pub(super) fn knows(&self, height: u64, hash: &[u8]) {
        let Some(hash) = KnownBlock::prefix(hash) else { return };
        let mut known = self.known();
        if known.as_ref().is_none_or(|known| height > known.height) {
            *known = Some(Known { height, hash, since: Instant::now() });
        }
    }

    /// The newest block that the node has reported, as a transaction names it now.
    pub(super) fn known_block(&self) -> Option<KnownBlock> {
        let Known { height, hash, since } = (*self.known())?;
        let known_us = u64::try_from(since.elapsed().as_micros()).unwrap_or(u64::MAX);
        Some(KnownBlock { height, hash: Bytes::copy_from_slice(&hash), known_us })
    }

    fn known(&self) -> MutexGuard<'_, Option<Known>> {
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
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
        let broken = self.broken().unwrap_or_else(|| {
            let address = self.address();
            crate::connect::unreachable(&address, &format!("no answer within {} s", self.options.deadline.as_secs()))
        });
        self.last_answers.instead_of(broken, Instant::now())
    }

    /// Puts a new connection into use; calls that wait go out over it.
    fn install(&self, number: u64, opened: Opened) -> Streaming<SubmitResponse> {
        let Opened { connection, requests, answers, told, at } = opened;
        self.clock.learn(told.clock, at);
        // An earlier node may have reported blocks that do not exist.
        *self.known() = None;
        self.knows(told.height, &told.block_hash);
        self.in_flight.several.store(self.several(), Ordering::Relaxed);
        self.in_flight.attach(requests);
        self.link.send_replace(Link { number, connection, carries: told.carries, broken: None });
        answers
    }

    /// Takes note of what the node says while it serves.
    fn take_note(&self, told: Option<NetworkResponse>) {
        let Some(told) = told else { return };
        let news = self.nodes.learn(&told, &self.address());
        self.knows(told.height, &told.block_hash);
        self.in_flight.several.store(self.several(), Ordering::Relaxed);
        self.link.send_if_modified(|link| {
            link.carries = told.carries;
            false
        });
        if news {
            let nodes = Arc::clone(&self.nodes);
            tokio::spawn(async move { nodes.note().await });
        }
    }

    /// The connection broke.
    fn uninstall(&self, reason: Rejection) {
        tracing::debug!(code = reason.code.name(), reason = %reason.message, found = %reason.found, "connection lost");
        self.link.send_modify(|link| link.broken = Some(reason));
        self.in_flight.detach();
    }

    fn answer(&self, answer: SubmitResponse, number: u64) {
        self.see(answer.height);
        if answer.height > 0 {
            self.clock.executed(answer.time);
            self.knows(answer.height, &answer.block_hash);
        }
        match accepted(answer.verdict.as_ref()) {
            Err(refused) if answer.height == 0 && is_of_node(&refused) => {
                self.last_answers.rejected(&self.address(), &refused, Instant::now());
            }
            _ => self.last_answers.served(&self.address()),
        }
        match self.in_flight.answer(answer) {
            Effect::Leave if self.several() => self.leave(number),
            Effect::Nothing | Effect::Leave => {}
            Effect::DoubtClock => self.clock.doubt(),
        }
    }
}

/// Owns the connection as long as anybody has the client.
struct Reconnector {
    session: Weak<Session>,
    complaints: watch::Receiver<u64>,
}

/// Why a connection is replaced, and by which one if that is known.
struct End {
    reason: Rejection,
    better: Option<Opened>,
}

impl From<Rejection> for End {
    fn from(reason: Rejection) -> Self {
        Self { reason, better: None }
    }
}

impl Reconnector {
    async fn run(mut self, mut answers: Streaming<SubmitResponse>) {
        for number in 1.. {
            let since = Instant::now();
            let Some(End { reason, better }) = self.serve(&mut answers, number).await else { return };
            let Some(session) = self.session.upgrade() else { return };
            let (dialer, nodes) = (session.dialer.clone(), Arc::clone(&session.nodes));
            nodes.avoid(&session.address());
            session.uninstall(reason);
            drop(session);
            let opened = match better {
                Some(opened) => opened,
                None => {
                    if since.elapsed() < SHORT_LIFE {
                        sleep(PAUSE_MIN).await;
                    }
                    let Some(opened) = self.reopen(&dialer, &nodes).await else { return };
                    opened
                }
            };
            let news = nodes.learn(&opened.told, &opened.connection.address);
            let Some(session) = self.session.upgrade() else { return };
            answers = session.install(number + 1, opened);
            if news {
                tokio::spawn(async move { nodes.note().await });
            }
        }
    }

    /// Takes answers until the connection breaks or is found wanting; says why. `None` if the client is gone.
    async fn serve(&mut self, answers: &mut Streaming<SubmitResponse>, number: u64) -> Option<End> {
        let mut complaint = pin!(self.complaints.wait_for(|unwanted| *unwanted >= number));
        let mut looks = interval_at(tokio::time::Instant::now() + LOOK_EVERY, LOOK_EVERY);
        looks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let mut look: Option<Pin<Box<dyn Future<Output = Look> + Send>>> = None;
        loop {
            let idle = look.is_none();
            let looking = async {
                match &mut look {
                    Some(look) => look.await,
                    None => std::future::pending().await,
                }
            };
            let answer = tokio::select! {
                biased;
                answer = answers.message() => answer,
                complaint = &mut complaint => {
                    complaint.ok()?;
                    let address = self.session.upgrade()?.address();
                    let reason = crate::connect::unreachable(&address, "the node could not serve; trying another one");
                    return Some(reason.into());
                }
                Look { told, better } = looking => {
                    look = None;
                    self.session.upgrade()?.take_note(told);
                    if better.is_some() {
                        let address = self.session.upgrade()?.address();
                        let reason = crate::connect::unreachable(&address, "another node is more suitable");
                        return Some(End { reason, better });
                    }
                    continue;
                }
                _ = looks.tick(), if idle => {
                    let session = self.session.upgrade()?;
                    let up = Uplink { number, connection: session.link.borrow().connection.clone() };
                    look = Some(Box::pin(look_around(up, session.dialer.clone(), Arc::clone(&session.nodes))));
                    continue;
                }
            };
            let session = self.session.upgrade()?;
            match answer {
                Ok(Some(answer)) => session.answer(answer, number),
                Ok(None) => {
                    return Some(
                        crate::connect::unreachable(&session.address(), "the node closed the connection").into(),
                    );
                }
                Err(status) => return Some(session.link.borrow().connection.refusal(&status).into()),
            }
        }
    }

    /// Opens the next connection, however long it takes. `None` if the client is gone.
    async fn reopen(&mut self, dialer: &Dialer, nodes: &Nodes) -> Option<Opened> {
        let mut pause = PAUSE_MIN;
        loop {
            match dialer.reach(&nodes.all()).await {
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
        if session.in_flight.sweep(Instant::now(), broken.as_ref(), &session.last_answers) {
            session.leave(number);
        }
        let unanswered = session.in_flight.unanswered(Instant::now());
        if !unanswered.is_empty() && session.several() {
            // It takes as long as the other node takes.
            tokio::spawn(elsewhere(Arc::clone(&session), unanswered));
        }
        if session.clock.take_doubt() {
            // In its own task: deadlines must not wait for a node.
            tokio::spawn(async move { session.learn_clock().await });
        }
    }
}

/// Gives calls to a node of another organisation, too, and takes what was executed from it.
async fn elsewhere(session: Arc<Session>, calls: Vec<Bytes>) {
    let nodes = session.nodes.elsewhere(&session.address());
    let Ok(mut opened) = session.dialer.race(&nodes, |opened| !opened.told.cut_off, None).await else { return };
    let mut waiting = calls.len();
    for transaction in calls {
        let _closed = opened.requests.send(Sent { transaction, first_attempt: false });
    }
    let answers = async {
        while waiting > 0
            && let Ok(Some(answer)) = opened.answers.message().await
        {
            waiting -= 1;
            // What this node cannot do, the other one may.
            if answer.height > 0 {
                session.see(answer.height);
                session.in_flight.answer(answer);
            }
        }
    };
    let _late = timeout(session.options.deadline, answers).await;
}
