//! Compares the chain of this node with those of the voters, and stops a node that differs or was removed.
//! [`ledger_replica::company`] decides.
//!
//! ```text
//! chain_monitor asks, remembers, and ends a node that is wrong
//!   confirmed   what voters have confirmed, across restarts
//!   difference  where it began: height and key
//! ```

mod confirmed;
mod difference;

pub(crate) use confirmed::confirmed_heights;

use crate::ordering::Ordering;
use crate::storage::files::DIVERGED_FILE;

use crate::ordering::directory::Member;
use crate::peers::connections::Dialer;
use crate::peers::question::Asked;
use crate::peers::quorum_certificates::Certificates;
use crate::peers::reachability::Reachability;
use confirmed::Confirmed;
use ledger::Ledger;
use ledger_base::rejection::{Code, Rejection};
use ledger_raft::{Contradiction, PeerMessage, Receipt};
use ledger_replica::company::{self, Follows, Place, Point, Said};
use ledger_replica::offsets::{self, Offset};
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::atomic::{AtomicI64, Ordering as Memory};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use tokio::time::{MissedTickBehavior, interval};

/// How often it is seen whether there is something to ask.
const LOOK_EVERY: Duration = Duration::from_secs(1);
/// How often the voters are asked while all is well.
const ASK_EVERY: Duration = Duration::from_secs(5);
/// How long a node reaches no leader before it asks whether it was removed.
const PATIENCE: Duration = Duration::from_secs(3);
/// How long a node whose certificates are strict looks for a certificate of the other history, before it stops without one.
const FORKED_PATIENCE: Duration = Duration::from_secs(10);
/// Most nodes with another block that are asked for a certificate in a round.
const BRANCHES_MAX: usize = 8;

type Machine = company::Company<Arc<Ledger>>;

/// The view that the rest of the node has of the comparison.
pub(crate) struct ChainMonitor {
    machine: Mutex<Machine>,
    /// Since when no leader is reached.
    cut_off: Mutex<Option<Instant>>,
    /// The clocks of those that answered the last question, by their numbers.
    clocks: Mutex<BTreeMap<u64, Offset>>,
    /// How far the clocks of most voters are ahead of this machine's, microseconds; 0 while that is not known.
    off: AtomicI64,
    /// The full name of this node.
    me: String,
    kept: Confirmed,
}

impl ChainMonitor {
    /// Of this node.
    pub(crate) fn new(ledger: &Arc<Ledger>, me: &Member, data: PathBuf) -> Self {
        let kept = Confirmed::of(data);
        let machine = Machine::new(Arc::clone(ledger), &me.organisation, kept.read());
        Self {
            machine: Mutex::new(machine),
            cut_off: Mutex::default(),
            clocks: Mutex::default(),
            off: AtomicI64::new(0),
            me: me.full_name(),
            kept,
        }
    }

    /// A member told its chain.
    pub(crate) fn told(&self, member: &Member, point: Point) {
        if let Err(fault) = self.machine().told(member.id, &member.full_name(), point) {
            tracing::warn!(code = fault.code.name(), reason = %fault, "cannot compare the chain of another node");
        }
    }

    /// The log of another node contradicts the one of this node.
    pub(crate) fn contradicted(&self, name: &str, found: &Contradiction) {
        self.machine().contradicted(name, found);
    }

    /// The own chain at a height, or at its tip.
    pub(crate) fn own(&self, height: u64) -> Option<Point> {
        self.machine().own(height).ok().flatten()
    }

    /// The newest receipt of a voter, for a height that it has confirmed.
    pub(crate) fn confirmed(&self, id: u64) -> Option<Receipt> {
        self.machine().confirmed().get(&id).cloned()
    }

    /// Is this a request for a vote that this node must not give?
    pub(crate) fn withholds(&self, from: u64, message: &PeerMessage) -> bool {
        self.machine().withholds(from, message)
    }

    /// The nodes that contradict this one or have lost blocks, in words; empty if there are none.
    pub(crate) fn describe(&self) -> String {
        self.machine().describe()
    }

    /// The clock of that node's machine, if it answered the last question.
    pub(crate) fn clock_of(&self, id: u64) -> Option<Offset> {
        self.clocks().get(&id).copied()
    }

    /// How far the clocks of most voters are ahead of this machine's at least, microseconds; below 0 where they are behind, 0 while
    /// that is not known.
    pub(crate) fn clock_off(&self) -> i64 {
        self.off.load(Memory::Relaxed)
    }

    /// Checks that the clock of this machine is near those of most voters.
    ///
    /// # Errors
    /// [`Code::ClockOutOfBounds`].
    pub(crate) fn check_clock(&self) -> Result<(), Rejection> {
        offsets::check(self.clock_off(), &self.me)
    }

    /// For how long this node has reached no leader.
    pub(crate) fn cut_off_for(&self, reachability: &Reachability) -> Duration {
        let mut since = self.cut_off.lock().unwrap_or_else(PoisonError::into_inner);
        *since = (!reachability.reaches_leader()).then(|| since.unwrap_or_else(Instant::now));
        since.map_or(Duration::ZERO, |since| since.elapsed().max(Duration::from_micros(1)))
    }

    fn machine(&self) -> MutexGuard<'_, Machine> {
        self.machine.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn clocks(&self) -> MutexGuard<'_, BTreeMap<u64, Offset>> {
        self.clocks.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The task that asks.
pub(crate) struct Asking {
    pub monitor: Arc<ChainMonitor>,
    pub certificates: Arc<Certificates>,
    pub ordering: Arc<Ordering>,
    pub reachability: Arc<Reachability>,
    pub dialer: Dialer,
}

impl Asking {
    /// Asks until the node stops.
    pub(crate) async fn run(self) {
        let mut time = interval(LOOK_EVERY);
        time.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let (mut asked, mut forked): (Option<Instant>, Option<Instant>) = (None, None);
        loop {
            time.tick().await;
            let cut_off = self.monitor.cut_off_for(&self.reachability);
            let hurries = cut_off > PATIENCE || self.monitor.machine().is_in_doubt();
            if asked.is_none_or(|asked| hurries || asked.elapsed() >= ASK_EVERY) {
                asked = Some(Instant::now());
                match self.round(cut_off > PATIENCE).await {
                    Ok(Some(end)) if end.code == Code::Forked && self.is_strict() => {
                        let since = *forked.get_or_insert_with(Instant::now);
                        if since.elapsed() > FORKED_PATIENCE {
                            return self.stop(uncertified(&end)).await;
                        }
                    }
                    Ok(Some(end)) => return self.stop(end).await,
                    Ok(None) => forked = None,
                    Err(fault) => {
                        tracing::warn!(code = fault.code.name(), reason = %fault, "cannot compare the chains of the others")
                    }
                }
                self.monitor.keep();
            }
        }
    }

    /// Asks once; answers why this node cannot go on.
    async fn round(&self, cut_off: bool) -> Result<Option<Rejection>, Rejection> {
        let members = self.ordering.directory.members();
        let voters = members.iter().filter(|member| member.votes());
        let place = Place {
            voters: voters.map(|member| (member.id, member.organisation.clone())).collect(),
            members: members.iter().map(|member| member.id).collect(),
            cut_off,
        };
        // Those who order know the chain. A node that was removed knows only older members, and asks them all.
        let asked: Vec<_> = members.iter().filter(|member| cut_off || member.votes()).cloned().collect();
        let mut height = None;
        loop {
            let said = self.ask(&asked, height.unwrap_or(u64::MAX)).await;
            self.ask_for_certificates(&said, &members).await;
            let follows = self.monitor.machine().heard(&said, &place, height)?;
            match follows {
                Follows::Nothing => return Ok(None),
                Follows::Ask(at) if height.is_none() => height = Some(at),
                Follows::Ask(_) => return Ok(None),
                Follows::Stop(reason) => return Ok(Some(reason)),
                Follows::Fetch(behind) => {
                    tracing::warn!(
                        "no leader reached, and other nodes do not know this node; fetching their decisions"
                    );
                    self.ordering.behind.send_replace(Some(behind));
                    return Ok(None);
                }
            }
        }
    }

    async fn ask(&self, members: &[Member], height: u64) -> Vec<Said> {
        let own = self.monitor.own(height);
        let answers = self.dialer.compare(members, self.ordering.storage.ledger.network(), own).await;
        let clocks: BTreeMap<u64, Offset> =
            answers.iter().filter_map(|asked| Some((asked.who.id, asked.clock?))).collect();
        let voters = members.iter().filter(|member| member.votes()).filter_map(|member| clocks.get(&member.id));
        self.monitor.off.store(offsets::ahead_of_this(voters.copied()), Memory::Relaxed);
        *self.monitor.clocks() = clocks;
        answers.into_iter().map(|Asked { who, has, at, stranger, .. }| Said { who, has, at, stranger }).collect()
    }

    /// Asks those that have another block for the certificate that covers it. A strict one contradicts this node.
    async fn ask_for_certificates(&self, said: &[Said], members: &[Member]) {
        let differs =
            |at: &Point| self.monitor.own(at.height).is_some_and(|own| own.height == at.height && own.hash != at.hash);
        let other = said.iter().filter_map(|one| Some((one.who.id, one.at.filter(differs)?.height)));
        // The log may contradict theirs behind what is executed here.
        let next = self.monitor.own(u64::MAX).map_or(0, |tip| tip.height) + 1;
        let contradicting = self.monitor.machine().contradicting().into_iter().map(|id| (id, next));
        for (id, height) in other.chain(contradicting).take(BRANCHES_MAX) {
            let Some(member) = members.iter().find(|member| member.id == id) else { continue };
            if let Some(branch) = self.dialer.certified(member, height).await {
                self.certificates.branch(branch);
            }
        }
    }

    fn is_strict(&self) -> bool {
        self.ordering.storage.ledger.voters().is_ok_and(|voters| voters.rule.strict_since.is_some())
    }

    /// This node is wrong: it stops serving, and says where that began.
    async fn stop(&self, reason: Rejection) {
        self.ordering.slot.stop();
        if reason.code != Code::Diverged {
            return self.ordering.failure.fail(reason);
        }
        let mark = self.ordering.storage.data.join(DIVERGED_FILE);
        if let Err(error) = std::fs::write(&mark, self.monitor.describe()) {
            tracing::error!(%error, mark = %mark.display(), "cannot mark the world state");
        }
        let noticed = self.monitor.machine().differing().map(|(name, height)| (name.to_owned(), height));
        let began = match noticed {
            Some((name, height)) => {
                difference::find(&self.ordering.storage.ledger, &self.ordering.directory, &self.dialer, (&name, height))
                    .await
            }
            None => String::new(),
        };
        let wanted = if began.is_empty() { reason.wanted.clone() } else { format!("{}; {began}", reason.wanted) };
        self.ordering.failure.fail(reason.wanted(wanted));
    }
}

impl ChainMonitor {
    /// Keeps what voters have confirmed, if it is time.
    fn keep(&self) {
        let confirmed = self.machine().confirmed().clone();
        self.kept.write(&confirmed);
    }
}

/// Most voters have another history, and no certificate of it was shown.
fn uncertified(reason: &Rejection) -> Rejection {
    Rejection::new(Code::Forked, "the history of most voters differs from this node's, and neither is certified")
        .found(reason.found.clone())
        .wanted(reason.wanted.clone())
        .next(
            "stop all nodes, choose a history, and run ledgerd recover --force-single --config FILE on the node with \
             its newest blocks: \"No history is certified\" in docs/operations.md",
        )
}
