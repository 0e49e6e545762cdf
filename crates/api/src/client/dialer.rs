//! Finding a node that serves: the best first, the next ones soon after it, never all of their patience in a row.
//!
//! A node that was killed refuses at once; one that was stopped or cut off says nothing. So nobody is waited for longer
//! than [`STAGGER`] before the next one is asked too. A node that answers but cannot have anything ordered is taken
//! only if no other one can.

use super::clock::middle;
use super::in_flight::Sent;
use super::retry::is_final;
use super::uplink::Uplink;
use crate::connect::{Connection, Credentials, Expected, explain, other_network, unreachable};
use crate::tls::TlsIdentity;
use crate::v1::{NetworkRequest, NetworkResponse, SubmitRequest, SubmitResponse};
use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use rustls::ClientConfig;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;
use tokio::sync::mpsc;
use tokio::task::JoinSet;
use tokio::time::{Instant, sleep_until, timeout};
use tokio_stream::StreamExt;
use tokio_stream::wrappers::UnboundedReceiverStream;
use tonic::Streaming;

/// After this long without an answer the next node is asked beside it.
pub(super) const STAGGER: Duration = Duration::from_millis(300);
/// How long better nodes are waited for once one has answered that cannot have anything ordered.
const BETTER_WITHIN: Duration = Duration::from_secs(1);

/// Opens connections as one identity.
#[derive(Clone)]
pub(super) struct Dialer {
    tls: Arc<ClientConfig>,
    identity: TlsIdentity,
    network: Hash,
    organisation: Option<String>,
    patience: Duration,
    /// Largest height seen: a node that is behind it waits before it looks at a transaction.
    pub(super) seen: Arc<AtomicU64>,
}

/// A connection with its stream of transactions.
pub(super) struct Opened {
    pub(super) connection: Connection,
    pub(super) requests: mpsc::UnboundedSender<Sent>,
    pub(super) answers: Streaming<SubmitResponse>,
    /// The node's description of its network and of itself.
    pub(super) told: NetworkResponse,
    /// When its clock showed what it says.
    pub(super) at: std::time::Instant,
}

impl Dialer {
    pub(super) fn new(credentials: &Credentials, patience: Duration) -> Self {
        Self {
            tls: Arc::clone(&credentials.tls),
            identity: credentials.identity.clone(),
            network: credentials.network,
            organisation: credentials.organisation.clone(),
            patience,
            seen: Arc::default(),
        }
    }

    /// The organisation of the identity, if it is known.
    pub(super) fn organisation(&self) -> Option<&str> {
        self.organisation.as_deref()
    }

    /// Connects to the first of these nodes that can have something ordered; if there is none, to one that answers.
    pub(super) async fn reach(&self, nodes: &[String]) -> Result<Opened, Rejection> {
        self.race(nodes, |opened| !opened.told.cut_off, Some(BETTER_WITHIN)).await
    }

    /// Connects to the first of these nodes that is `good`. If one answers that is not, the others have `settle` to be
    /// better; then that one is taken. Without `settle` only a good one is.
    pub(super) async fn race(
        &self,
        nodes: &[String],
        good: impl Fn(&Opened) -> bool,
        settle: Option<Duration>,
    ) -> Result<Opened, Rejection> {
        let mut waiting = nodes.iter().enumerate();
        let mut running = JoinSet::new();
        let mut refusals = BTreeMap::new();
        let (mut next_at, mut second, mut settle_at) = (Instant::now(), None, None);
        loop {
            let now = Instant::now();
            if settle_at.is_some_and(|at| at <= now) {
                break;
            }
            if next_at <= now
                && let Some((number, address)) = waiting.next()
            {
                let (dialer, address) = (self.clone(), address.clone());
                running.spawn(async move { (number, dialer.open(&address).await) });
                next_at = now + STAGGER;
            }
            let next = Some(next_at).filter(|_| waiting.len() > 0);
            let wake = next.into_iter().chain(settle_at).min();
            let done = tokio::select! {
                biased;
                done = running.join_next() => done,
                () = moment(wake) => continue,
            };
            match done {
                None if waiting.len() == 0 => break,
                Some(Ok((_, Ok(opened)))) if good(&opened) => return Ok(opened),
                Some(Ok((_, Ok(opened)))) if settle.is_some() => {
                    settle_at = settle_at.or(settle.map(|settle| Instant::now() + settle));
                    second.get_or_insert(opened);
                }
                Some(Ok((number, Err(refused)))) => drop(refusals.insert(number, refused)),
                // One that is no use, or a panic.
                Some(_) | None => {}
            }
            next_at = Instant::now();
        }
        second.ok_or_else(|| summary(refusals.into_values().collect()))
    }

    async fn open(&self, address: &str) -> Result<Opened, Rejection> {
        let opened = self.try_open(address).await;
        let Err(refused) = opened else { return opened };
        Err(explain(refused, address, &self.expected(), self.patience).await)
    }

    fn expected(&self) -> Expected {
        Expected {
            network: self.network,
            organisation: self.organisation.clone(),
            certificate: Bytes::copy_from_slice(self.identity.own().certificate()),
        }
    }

    async fn try_open(&self, address: &str) -> Result<Opened, Rejection> {
        let certificate = Bytes::copy_from_slice(self.identity.own().certificate());
        let connection =
            Connection::open((address, Some(&self.network)), Arc::clone(&self.tls), &certificate, self.patience)
                .await?;
        let late = || unreachable(address, &format!("no answer within {} ms", self.patience.as_millis()));
        let up = Uplink { number: 0, connection };
        let asked = std::time::Instant::now();
        let told = timeout(self.patience, up.enrolment().network(NetworkRequest {})).await.map_err(|_| late())?;
        let told = told.map_err(|status| up.connection.refusal(&status))?.into_inner();
        let at = middle(asked);
        if let Some(other) = other_network(address, &self.expected(), &told) {
            return Err(other);
        }
        let (requests, outgoing) = mpsc::unbounded_channel();
        let seen = Arc::clone(&self.seen);
        let outgoing = UnboundedReceiverStream::new(outgoing).map(move |Sent { transaction, first_attempt }| {
            SubmitRequest { transaction, min_height: seen.load(Ordering::Relaxed), first_attempt }
        });
        let mut gateway = up.gateway();
        let answers = timeout(self.patience, gateway.submit_stream(outgoing)).await;
        let answers = answers.map_err(|_| late())?.map_err(|status| up.connection.refusal(&status))?.into_inner();
        Ok(Opened { connection: up.connection, requests, answers, told, at })
    }
}

/// Ends at that moment, or never.
async fn moment(at: Option<Instant>) {
    match at {
        Some(at) => sleep_until(at).await,
        None => std::future::pending().await,
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
            .next(first.advice())
            .wanted(first.wanted),
    }
}
