//! Catching up: what a node fetches from others, from whom, and whom it believes.
//!
//! ```text
//! catch_up     the machine: one thing to do after the other
//!   batch      blocks that are confirmed, stored and executed together
//!   jury       the nodes that must agree with what another one gives
//!   look       the question with which a node starts, and what must wait for the answers
//!   offer      what the others have
//! ```
//!
//! **Which answers to believe.** A follower believes its leader, as Raft does. A node that asks around would believe
//! any answer, so it asks for more. It takes blocks from a node of the own organisation, or from the leader that the
//! engine named. It takes blocks of any other node if a node of a third organisation, or of the own, has the same block
//! hash at the end of each batch. The hash covers everything before it. Where only one other organisation has the blocks,
//! the giver and those who have that hash must be a majority of the voters that this node knows. Where nobody confirms,
//! nothing is pulled: the leader's replication brings the blocks, slower. Snapshots: see [`crate::trust`].
//!
//! **A full disk** ends nothing: the machine waits, and stores again what it was about to store.

mod batch;
mod jury;
mod look;
mod offer;

pub use batch::Batch;
pub use look::{ASK_TIME_MAX, Ballot, Heard, Look, Own, Stage};
pub use offer::{Holding, Offer, RECEIPTS_MAX, Who, is_far_behind, is_known, store_holds};

use crate::replica::FULL_DISK_PAUSE;
use crate::trust::{Attested, Trial};
use batch::End;
use jury::{Jury, Verdict};
use ledger::Ledger;
use ledger_base::hash::Hash;
use ledger_base::invariant;
use ledger_base::mutation::Mutation;
use ledger_base::rejection::{Code, Rejection};
use ledger_storage::block_store::{Base, BlockStore};
use ledger_storage::entry::Entry;
use ledger_storage::snapshot::{Manifest, Snapshot};
use std::collections::VecDeque;
use std::sync::Arc;

/// Time in which the next message, or a confirmation, must come, microseconds.
pub const SILENCE_MAX: u64 = 5_000_000;

/// The engine's report when it could not go on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Behind {
    /// The leader that said so.
    pub from: u64,
    /// The first block that replication still brings.
    pub first_index: u64,
}

/// The outcome of catching up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Caught {
    /// The node has what it could get; replication brings the rest.
    Up,
    /// A snapshot is there, and the log begins after it: the node has to start again on it.
    Snapshot,
    /// Nobody had what is needed, or nobody confirmed it. To be tried again.
    Nothing,
}

/// The next thing to do; [`CatchUp::step`] is told what came of it.
pub enum Todo<P> {
    /// Ask all others what they have.
    Ask,
    /// Open a stream of blocks, and take its first message.
    Open {
        /// Of this node.
        peer: P,
        /// From this height on.
        from: u64,
    },
    /// Take the next message of the stream.
    More,
    /// Ask for a block hash.
    Confirm {
        /// This node.
        peer: P,
        /// At this height.
        height: u64,
    },
    /// Store these blocks, and execute them.
    TakeIn(Arc<Batch>),
    /// Ask for the manifest of the newest snapshot, and its attestations.
    Manifest {
        /// This node.
        peer: P,
    },
    /// Fetch the chunks that are missing, then let the trial conclude.
    Fetch {
        /// From this node.
        peer: P,
        /// The manifest of the snapshot.
        manifest: Manifest,
        /// Decides about it.
        trial: Trial,
    },
    /// Let the log begin after a snapshot that is believed: [`install`].
    Install(Arc<Snapshot>),
    /// Wait, microseconds: the disk is full.
    Pause(u64),
    /// It is done.
    Done(Caught),
    /// The node cannot go on: its disk, or a chain that contradicts itself.
    Failed(Rejection),
}

/// The outcome of the last thing.
pub enum Got<P> {
    /// The blocks of the others.
    Offers(Vec<Offer<P>>),
    /// A message of the stream; none at its end. A fault is the peer's.
    Blocks(Result<Option<Vec<Entry>>, Rejection>),
    /// The block hash, if the node has it.
    Hash(Result<Option<Hash>, Rejection>),
    /// The blocks are stored and executed.
    TakenIn(Result<(), Rejection>),
    /// A manifest, and who attests it. A fault is the peer's.
    Manifest(Result<(Manifest, Vec<Attested>), Rejection>),
    /// The peer does not give the snapshot.
    Unfetched(Rejection),
    /// A snapshot that is believed. A fault is this node's, or the snapshot is not as it should be.
    Snapshot(Result<Arc<Snapshot>, Rejection>),
    /// The log begins after the snapshot.
    Installed(Result<(), Rejection>),
    /// The pause is over.
    Waited,
}

/// Fetches what a node lacks. No engine may run meanwhile.
pub struct CatchUp<P> {
    ledger: Arc<Ledger>,
    /// Of this node.
    organisation: String,
    behind: Option<Behind>,
    /// The CA that the join token names.
    token: Option<Hash>,
    /// Where the node stood.
    begun: u64,
    /// The longest chain first.
    offers: Vec<Offer<P>>,
    /// Those that were not asked yet in this part.
    left: VecDeque<Offer<P>>,
    part: Part<P>,
    /// The height that is aimed at.
    aim: u64,
}

enum Part<P> {
    Blocks(Option<Pull<P>>),
    Snapshots(Option<Offer<P>>),
}

/// Blocks from one node.
struct Pull<P> {
    from: Offer<P>,
    /// The nodes that must agree.
    jury: Jury<P>,
    /// Beyond what they have, nobody confirms.
    limit: u64,
    batch: Batch,
    /// The batch that is being stored.
    taken: Option<Arc<Batch>>,
    /// The stream has ended.
    ended: bool,
}

impl<P: Clone> CatchUp<P> {
    /// For a node of an organisation; `token`: see [`Trial::begin`]. The first thing to do is to ask.
    pub fn new(ledger: Arc<Ledger>, organisation: String, behind: Option<Behind>, token: Option<Hash>) -> Self {
        let begun = ledger.tip().height;
        let (offers, left, part, aim) = (Vec::new(), VecDeque::new(), Part::Blocks(None), 0);
        Self { ledger, organisation, behind, token, begun, offers, left, part, aim }
    }

    /// The height up to which is fetched; 0 while that is not known.
    pub fn aim(&self) -> u64 {
        self.aim
    }

    /// Takes what came of the last thing, and says the next one.
    pub fn step(&mut self, got: Got<P>) -> Todo<P> {
        match got {
            Got::Offers(offers) => self.offered(offers),
            Got::Blocks(Ok(blocks)) => self.gather(blocks),
            Got::Hash(answer) => self.confirmed(answer),
            Got::TakenIn(Ok(())) => self.taken_in(),
            Got::TakenIn(Err(fault)) if fault.code == Code::DiskFull => Todo::Pause(FULL_DISK_PAUSE),
            Got::Waited => self.take_in(),
            Got::Manifest(Ok((manifest, attested))) => self.tried(manifest, attested),
            Got::Snapshot(Ok(snapshot)) => Todo::Install(snapshot),
            Got::Installed(Ok(())) => Todo::Done(Caught::Snapshot),
            // Whatever code a peer gives it, that is its own affair: its disk may be damaged, or it lies.
            Got::Blocks(Err(fault)) | Got::Manifest(Err(fault)) | Got::Unfetched(fault) => self.pass_over(&fault),
            Got::TakenIn(Err(fault)) | Got::Snapshot(Err(fault)) | Got::Installed(Err(fault)) => self.fault(&fault),
        }
    }

    fn offered(&mut self, mut offers: Vec<Offer<P>>) -> Todo<P> {
        offers.sort_by_key(|offer| std::cmp::Reverse(offer.has.height));
        self.offers = offers;
        let next = self.next();
        match self.offers.iter().any(|offer| offer.has.holds(next)) {
            true => {
                self.left = self.offers.iter().cloned().collect();
                self.next_offer()
            }
            false => self.snapshots(),
        }
    }

    fn next(&self) -> u64 {
        self.ledger.tip().height + 1
    }

    /// Pulls from the next node that has more, and is believed or confirmed.
    fn next_offer(&mut self) -> Todo<P> {
        self.part = Part::Blocks(None);
        while let Some(from) = self.left.pop_front() {
            let next = self.next();
            let enough = self.behind.is_none_or(|behind| next >= behind.first_index) && next > from.has.height;
            if enough {
                break;
            }
            if !from.has.holds(next) {
                continue;
            }
            let Some(jury) = self.jury(&from, next) else {
                tracing::info!(node = from.who.name, "no other nodes confirm the blocks of this peer");
                continue;
            };
            self.aim = self.offers.iter().map(|offer| offer.has.height).max().unwrap_or_default();
            tracing::info!(node = from.who.name, from = next, to = self.aim, "fetching blocks");
            let limit = jury.limit();
            let (peer, batch) = (from.peer.clone(), Batch::after(End::of(&self.ledger.tip())));
            self.part = Part::Blocks(Some(Pull { from, jury, limit, batch, taken: None, ended: false }));
            return Todo::Open { peer, from: next };
        }
        self.pulled()
    }

    /// The nodes that must agree with what this one gives, from this block on; none if nobody can.
    fn jury(&self, offer: &Offer<P>, next: u64) -> Option<Jury<P>> {
        let believed = offer.who.vouched
            || offer.who.organisation == self.organisation
            || self.behind.is_some_and(|behind| behind.from == offer.who.id);
        if believed || ledger_base::mutation::active(Mutation::TakeUnconfirmedBlocks) {
            return Some(Jury::none());
        }
        // A fault of the store is found again by whatever is stored next.
        Jury::of(offer, &self.offers, &self.ledger.members().unwrap_or_default(), next)
    }

    /// Nobody has more.
    fn pulled(&mut self) -> Todo<P> {
        let (reached, begun) = (self.ledger.tip().height, self.begun);
        invariant!(reached >= begun, "a ledger never goes back", "block {reached} after {begun}");
        if reached > begun {
            tracing::info!(blocks = reached - begun, height = reached, "up to date");
        }
        match reached >= self.behind.map_or(0, |behind| behind.first_index.saturating_sub(1)) {
            true => Todo::Done(Caught::Up),
            false => self.snapshots(),
        }
    }

    fn pull(&mut self) -> Option<&mut Pull<P>> {
        match &mut self.part {
            Part::Blocks(pull) => pull.as_mut(),
            Part::Snapshots(_) => None,
        }
    }

    fn gather(&mut self, blocks: Option<Vec<Entry>>) -> Todo<P> {
        let Some(pull) = self.pull() else { return self.astray() };
        match blocks {
            None => pull.ended = true,
            Some(blocks) => {
                let before = pull.batch.end().height;
                for block in blocks.into_iter().take_while(|block| block.index <= pull.limit) {
                    if let Err(fault) = pull.batch.push(block) {
                        return self.fault(&fault);
                    }
                }
                // A message that brings nothing is the end: a peer could hold this node up for ever with such ones.
                pull.ended |= pull.batch.end().height == before;
                if !pull.ended && !pull.batch.is_full() && pull.batch.end().height < pull.limit {
                    return Todo::More;
                }
            }
        }
        if pull.batch.entries().is_empty() {
            return self.next_offer();
        }
        pull.jury.begin();
        match pull.jury.is_none() {
            true => self.take_in(),
            false => self.confirm(),
        }
    }

    /// Asks the next node that may confirm the batch.
    fn confirm(&mut self) -> Todo<P> {
        let Some(pull) = self.pull() else { return self.astray() };
        let height = pull.batch.end().height;
        match pull.jury.next() {
            Some(peer) => Todo::Confirm { peer, height },
            None => {
                let fault = Rejection::new(Code::Behind, format!("too few other nodes have block {height}"))
                    .next("the rest is replicated by the leader");
                self.fault(&fault)
            }
        }
    }

    /// Those that have the block must agree.
    fn confirmed(&mut self, answer: Result<Option<Hash>, Rejection>) -> Todo<P> {
        let Some(pull) = self.pull() else { return self.astray() };
        let end = pull.batch.end();
        let hash = answer.unwrap_or_else(|reason| {
            tracing::debug!(node = pull.jury.name(), code = reason.code.name(), %reason, "peer does not confirm the \
                                                                                          blocks");
            None
        });
        match pull.jury.hear(end.hash, hash) {
            Verdict::Confirmed => self.take_in(),
            Verdict::Open => self.confirm(),
            Verdict::Refused { by } => {
                let fault =
                    Rejection::new(Code::ChainInvalid, format!("{by} has another block at height {}", end.height))
                        .found(format!("block hash {}", hash.unwrap_or(Hash::ZERO)))
                        .wanted(format!("block hash {}, as the fetched blocks require", end.hash));
                self.fault(&fault)
            }
        }
    }

    fn take_in(&mut self) -> Todo<P> {
        let Some(pull) = self.pull() else { return self.astray() };
        let batch = match pull.taken.take() {
            Some(batch) => batch,
            None => {
                let next = Batch::after(pull.batch.end());
                Arc::new(std::mem::replace(&mut pull.batch, next))
            }
        };
        let (blocks, end, limit) = (batch.entries().len(), batch.end().height, pull.limit);
        invariant!(
            blocks > 0 && end <= limit,
            "blocks are stored that can be confirmed",
            "{blocks} blocks up to {end}, confirmed up to {limit} at most"
        );
        pull.taken = Some(Arc::clone(&batch));
        Todo::TakeIn(batch)
    }

    fn taken_in(&mut self) -> Todo<P> {
        let reached = self.ledger.tip().height;
        let Some(pull) = self.pull() else { return self.astray() };
        pull.taken = None;
        let end = pull.batch.end().height;
        invariant!(reached == end, "fetched blocks are executed up to their end", "block {reached} of {end}");
        match pull.ended || end >= pull.limit {
            true => self.next_offer(),
            false => Todo::More,
        }
    }

    /// The newest snapshot that is believed, of the nodes that have one.
    fn snapshots(&mut self) -> Todo<P> {
        let height = self.ledger.tip().height;
        let mut offers: Vec<_> =
            self.offers.iter().filter(|offer| offer.has.snapshot_height > height).cloned().collect();
        offers.sort_by_key(|offer| std::cmp::Reverse(offer.has.snapshot_height));
        self.left = offers.into();
        self.next_snapshot()
    }

    fn next_snapshot(&mut self) -> Todo<P> {
        let offer = self.left.pop_front();
        let todo = match &offer {
            Some(offer) => Todo::Manifest { peer: offer.peer.clone() },
            None => Todo::Done(Caught::Nothing),
        };
        self.part = Part::Snapshots(offer);
        todo
    }

    fn tried(&mut self, manifest: Manifest, attested: Vec<Attested>) -> Todo<P> {
        let Part::Snapshots(Some(offer)) = &self.part else { return self.astray() };
        let (peer, token) = (offer.peer.clone(), self.token.filter(|_| offer.who.vouched));
        match Trial::begin(&self.ledger, &manifest, attested, token) {
            Ok(trial) => {
                tracing::info!(
                    node = offer.who.name, height = manifest.height, content = %manifest.content(),
                    bytes = manifest.bytes(), "fetching a snapshot"
                );
                self.aim = manifest.height;
                Todo::Fetch { peer, manifest, trial }
            }
            Err(fault) => self.fault(&fault),
        }
    }

    /// A fault that was found here. One of this node ends it; for one of the other node, the next is asked.
    fn fault(&mut self, fault: &Rejection) -> Todo<P> {
        match fault.code {
            Code::Corrupt | Code::DiskFailed | Code::Internal | Code::Diverged => Todo::Failed(fault.clone()),
            _ => self.pass_over(fault),
        }
    }

    /// The peer does not help: the next one is asked.
    fn pass_over(&mut self, fault: &Rejection) -> Todo<P> {
        match &self.part {
            Part::Blocks(pull) => {
                let peer = pull.as_ref().map(|pull| pull.from.who.name.clone()).unwrap_or_default();
                tracing::warn!(node = peer, code = fault.code.name(), reason = %fault, "cannot fetch more blocks from this peer");
                self.next_offer()
            }
            Part::Snapshots(offer) => {
                let peer = offer.as_ref().map(|offer| offer.who.name.clone()).unwrap_or_default();
                tracing::warn!(node = peer, code = fault.code.name(), reason = %fault, "cannot use the snapshot of this peer");
                self.next_snapshot()
            }
        }
    }

    fn astray(&self) -> Todo<P> {
        Todo::Failed(Rejection::new(Code::Internal, "unexpected answer during block sync"))
    }
}

/// Lets an empty log begin where another log of the same chain begins.
///
/// # Errors
/// As [`BlockStore::begin_after`].
pub fn begin_as(store: &BlockStore, other: &BlockStore) -> Result<(), Rejection> {
    let index = other.first_index().saturating_sub(1);
    if index > 0 {
        store.begin_after(Base { index, term: other.term(index).unwrap_or_default() })?;
    }
    Ok(())
}

/// Lets the log begin after a snapshot that is believed. The world state follows when the node starts again: what is in
/// memory and in use cannot be exchanged.
///
/// # Errors
/// As [`BlockStore::begin_after`].
pub fn install(store: &BlockStore, snapshot: &Snapshot) -> Result<(), Rejection> {
    let tip = &snapshot.manifest().tip;
    store.begin_after(Base { index: tip.height, term: tip.term })?;
    tracing::info!(height = tip.height, digest = %tip.digest, "snapshot replaces the dropped blocks");
    Ok(())
}
