//! Block and snapshot sync: from other nodes, for a node that lacks more than replication brings.
//!
//! [`ledger_replica::catch_up`] decides which blocks are fetched, and which nodes are believed. Here are the connections
//! and the threads that do it.
//!
//! ```text
//! sync         carries out what the machine says
//!   first_look asks the other nodes what they have, when the node starts
//!   blocks     streams of blocks, and block hashes
//!   snapshot   manifests and chunks
//!   serve      the other side: what this node gives to those that ask
//! ```
//!
//! **Newcomers.** A node that has joined has a ledger that stands at the genesis: it does not know the network as it is,
//! nor perhaps its own organisation. The join token names nodes and their CA, which it asks as well, and believes.

pub(crate) mod blocks;
mod first_look;
mod serve;
mod snapshot;

pub(crate) use serve::{Reader, Source};

use crate::ordering::Ordering;
use crate::ordering::directory::Member;
use crate::peers::connections::Dialer;
use crate::peers::question::{self, Answers, Bootstrap, Contact};
use ledger::Ledger;
use ledger_api::v1::BlockEntries;
use ledger_base::rejection::{Code, Rejection};
use ledger_raft::ReceiptKey;
use ledger_replica::Executor;
use ledger_replica::catch_up::{self, ASK_TIME_MAX, Ballot, Batch, Behind, Caught, Got, Todo};
use ledger_replica::space::Wrote;
use ledger_storage::snapshot::Snapshot;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::sync::watch;
use tonic::Streaming;

/// How often progress is told.
const PROGRESS_PERIOD: Duration = Duration::from_secs(2);

/// Fetches what this node lacks.
pub(crate) struct BlockSync {
    /// Set on a node that has joined.
    pub bootstrap: Option<Bootstrap>,
    /// Where blocks and snapshots go, and where progress is shown.
    pub ordering: Arc<Ordering>,
    /// Executes blocks.
    pub executor: Arc<Executor>,
    /// How to call the others.
    pub dialer: Dialer,
    /// Whether the node may vote.
    pub ballot: Ballot,
    /// Knows this node's own receipts again.
    pub receipts: ReceiptKey,
    /// Set when the node stops.
    pub stopping: watch::Receiver<bool>,
}

/// The open stream while it fetches.
struct Fetching {
    stream: Option<(Streaming<BlockEntries>, String)>,
    told: Instant,
}

impl BlockSync {
    /// Fetches what the others have, as far as it can be believed. No engine may run.
    ///
    /// # Errors
    /// Faults with which the node cannot go on: its disk, or a chain that contradicts itself.
    pub(crate) async fn run(&self, behind: Option<Behind>) -> Result<Caught, Rejection> {
        let token = self.bootstrap.as_ref().map(|known| known.ca);
        let (ledger, organisation) = (Arc::clone(self.ledger()), self.dialer.organisation.clone());
        let mut machine = catch_up::CatchUp::new(ledger, organisation, behind, token);
        let mut fetching = Fetching { stream: None, told: Instant::now() };
        let mut todo = Todo::Ask;
        loop {
            self.ordering.slot.show_progress(machine.aim());
            let got = match todo {
                Todo::Done(caught) => return Ok(caught),
                Todo::Failed(reason) => return Err(reason),
                _ if self.is_stopping() => return Ok(Caught::Nothing),
                todo => self.carry_out(todo, machine.aim(), &mut fetching).await,
            };
            todo = machine.step(got);
        }
    }

    async fn carry_out(&self, todo: Todo<Contact>, aim: u64, fetching: &mut Fetching) -> Got<Contact> {
        match todo {
            Todo::Ask => Got::Offers(self.offers().await),
            Todo::Open { peer, from } => {
                fetching.stream = None;
                match blocks::open(&peer, from).await {
                    Ok(stream) => fetching.stream = Some((stream, peer.address)),
                    Err(fault) => return Got::Blocks(Err(fault)),
                }
                Got::Blocks(blocks::next(&mut fetching.stream).await)
            }
            Todo::More => Got::Blocks(blocks::next(&mut fetching.stream).await),
            Todo::Confirm { peer, height } => Got::Hash(blocks::block_hash(&peer, height).await),
            Todo::TakeIn(batch) => {
                let taken = self.take_in(&batch).await;
                if fetching.told.elapsed() > PROGRESS_PERIOD {
                    fetching.told = Instant::now();
                    tracing::info!(height = self.ledger().tip().height, of = aim, "fetching blocks");
                }
                Got::TakenIn(taken)
            }
            Todo::Manifest { peer } => Got::Manifest(snapshot::manifest(&peer).await),
            Todo::Fetch { peer, manifest, trial } => self.fetch(&peer, manifest, trial).await,
            Todo::Install(snapshot) => Got::Installed(self.install(snapshot).await),
            Todo::Pause(time) => {
                self.pause(time).await;
                Got::Waited
            }
            Todo::Done(_) | Todo::Failed(_) => Got::Waited,
        }
    }

    /// Stores and executes blocks. A full disk gets the reserve before it is tried again.
    async fn take_in(&self, batch: &Arc<Batch>) -> Result<(), Rejection> {
        let (ordering, executor, batch) = (Arc::clone(&self.ordering), Arc::clone(&self.executor), Arc::clone(batch));
        let taken = tokio::task::spawn_blocking(move || {
            let storage = &ordering.storage;
            let taken = batch.take_in(&storage.log.store, &executor, &storage.snapshots);
            // The machine tries again by itself.
            let _again = storage.space.wrote(Wrote::from(&taken));
            taken
        });
        taken.await.map_err(|_| Rejection::new(Code::Internal, "the execution of fetched blocks panicked"))?
    }

    async fn install(&self, snapshot: Arc<Snapshot>) -> Result<(), Rejection> {
        let store = Arc::clone(&self.ordering.storage.log.store);
        let begun = tokio::task::spawn_blocking(move || catch_up::install(&store, &snapshot)).await;
        begun.map_err(|_| Rejection::new(Code::Internal, "a thread panicked with the log"))?
    }

    /// Waits so long, or until the node stops.
    pub(crate) async fn pause(&self, micros: u64) {
        let mut stopping = self.stopping.clone();
        let stopped = stopping.wait_for(|stopping| *stopping);
        let _stopping = tokio::time::timeout(Duration::from_micros(micros), stopped).await;
    }

    async fn offers(&self) -> Vec<question::Offer> {
        question::all(self.question(&self.ordering.directory.members())).await
    }

    fn question(&self, members: &[Member]) -> Answers {
        let stranger = !members.iter().any(|member| member.id == self.dialer.me);
        let bootstrap = self.bootstrap.as_ref().filter(|_| stranger);
        let patience = Duration::from_micros(ASK_TIME_MAX);
        self.dialer.question(members, bootstrap, self.ledger().network(), patience)
    }

    fn ledger(&self) -> &Arc<Ledger> {
        self.executor.ledger()
    }

    /// Does the node stop?
    pub(crate) fn is_stopping(&self) -> bool {
        *self.stopping.borrow()
    }
}
