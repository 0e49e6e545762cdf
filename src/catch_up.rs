//! Catching up: blocks and snapshots from other nodes, for a node that lacks more than replication brings.
//!
//! ```text
//! catch_up     what to do, and whom to believe
//!   ask        what the other nodes have
//!   look       the question with which a node starts, and what must wait for the answers
//!   blocks     pulling blocks: verified, stored, executed
//!   snapshot   taking the world state, where the blocks are gone
//!   serve      the other side: what this node gives to those that ask
//! ```
//!
//! **Newcomers.** A node that has joined has a ledger that stands at the genesis: it does not know the network as it is,
//! nor perhaps its own organisation. The join token names nodes and their CA, which it asks as well, and believes.
//!
//! **Which answers to believe.** A follower believes its leader, as Raft does. A node that asks around would believe
//! any answer, so it asks for more. It takes blocks from a node of the own organisation, or from the leader that the
//! engine named. It takes blocks of any other node if a node of a third organisation, or of the own, has the same block
//! hash at the end of each batch. The hash covers everything before it. Where nobody confirms, nothing is pulled: the
//! leader's replication brings the blocks, slower.

mod ask;
mod blocks;
mod look;
mod serve;
mod snapshot;

pub(crate) use look::{Ballot, Look};
pub(crate) use serve::Source;

use crate::orderer::{Seat, Shared};
use crate::peers::{Dialer, Member};
use ask::{Answers, Offer};
use ledger_hash::Hash;
use ledger_rejection::{Code, Rejection};
use ledger_replica::REJOIN;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::watch;

/// A node that lacks no more blocks than this leaves it to replication.
const LAG_MIN: u64 = 1000;
/// Time that the others have to say what they have.
const ASK_TIME_MAX: Duration = Duration::from_secs(1);

/// The engine's report when it could not go on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Behind {
    /// The leader that said so.
    pub from: u64,
    /// The first block that replication still brings.
    pub first_index: u64,
}

/// The outcome of catching up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Caught {
    /// The node has what it could get; replication brings the rest.
    Up,
    /// A snapshot is there, and the log begins after it: the node has to start again on it.
    Snapshot,
    /// Nobody had what is needed, or nobody confirmed it. To be tried again.
    Nothing,
}

/// The nodes that let this node in, for as long as its ledger does not know it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Bootstrap {
    /// `HOST:PORT` of nodes.
    pub addresses: Vec<String>,
    /// SHA-256 of the CA certificate behind them.
    pub ca: Hash,
}

/// Fetches what this node lacks.
pub(crate) struct CatchUp {
    /// Set on a node that has joined.
    pub bootstrap: Option<Bootstrap>,
    /// The node's parts.
    pub shared: Arc<Shared>,
    /// Where progress is shown.
    pub seat: Arc<Seat>,
    /// How to call the others.
    pub dialer: Dialer,
    /// Whether the node may vote.
    pub ballot: Ballot,
    /// Set when the node stops.
    pub stopping: watch::Receiver<bool>,
}

impl CatchUp {
    /// Is there enough to fetch that it is worth it?
    pub(crate) fn is_far_behind(&self, offers: &[Offer]) -> bool {
        let next = self.shared.ledger.tip().height + 1;
        offers.iter().any(|offer| offer.chain.height > next + LAG_MIN || offer.chain.first_height > next)
    }

    /// Does the ledger know this node? Before it does, it knows perhaps neither the leader nor whoever else may call.
    ///
    /// # Errors
    /// [`Code::NotAMember`] if it knows that this node was removed.
    pub(crate) fn is_known(&self) -> Result<bool, Rejection> {
        let me = self.dialer.me;
        if self.shared.directory.members().iter().any(|member| member.id == me) {
            return Ok(true);
        }
        let records = ledger::governance::nodes(&**self.shared.ledger.state())?;
        match records.iter().any(|record| record.id == me) {
            false => Ok(false),
            true => Err(Rejection::new(Code::NotAMember, "this node was removed from the network")
                .found(format!(
                    "node {me}, removed, by the block of height {} or before",
                    self.shared.ledger.tip().height
                ))
                .next(format!("to bring it in again as a new node: {REJOIN}"))),
        }
    }

    /// Fetches what the others have, as far as it can be believed. No engine may run.
    ///
    /// # Errors
    /// Faults with which the node cannot go on: its disk, or a chain that contradicts itself.
    pub(crate) async fn run(&self, behind: Option<Behind>) -> Result<Caught, Rejection> {
        let offers = self.offers().await;
        let next = self.shared.ledger.tip().height + 1;
        let kept = |offer: &Offer| offer.chain.height >= next && offer.chain.first_height <= next;
        let caught = match offers.iter().any(kept) {
            true => self.pull(&offers, behind).await?,
            false => Caught::Nothing,
        };
        match caught {
            Caught::Nothing => self.take_snapshot(&offers).await,
            caught => Ok(caught),
        }
    }

    async fn offers(&self) -> Vec<Offer> {
        ask::all(self.question(&self.shared.directory.members())).await
    }

    fn question(&self, members: &[Member]) -> Answers {
        let stranger = !members.iter().any(|member| member.id == self.dialer.me);
        let bootstrap = self.bootstrap.as_ref().filter(|_| stranger);
        self.dialer.question(members, bootstrap, self.shared.ledger.network(), ASK_TIME_MAX)
    }

    fn is_stopping(&self) -> bool {
        *self.stopping.borrow()
    }
}
