//! The decisions of a seed before anything happens: how large the network is, and how badly it is treated.

use crate::clock::{MILLISECOND, SECOND};
use crate::coverage::Fault;
use ledger_replica::Timing;
use std::collections::BTreeSet;
use testkit::Random;

/// The circumstances of one run. Times in microseconds.
#[derive(Clone, Debug)]
pub struct Plan {
    /// Nodes that order at first.
    pub voters: u64,
    /// Nodes that follow at first.
    pub learners: u64,
    /// Organisations that run nodes.
    pub organisations: usize,
    /// Kinds of faults that happen.
    pub faults: BTreeSet<Fault>,
    /// How long they happen.
    pub chaos: u64,
    /// Average time between two of those that happen at a moment (crashes, partitions …).
    pub between_faults: u64,
    /// The times of the nodes.
    pub timing: Timing,
    /// All nodes share one set of caches of access control: faster, and less like real processes.
    pub shares_caches: bool,
    /// How many clients work.
    pub clients: usize,
    /// Average pause of a client between two operations.
    pub think: u64,
    /// Size of a segment: small, so that many begin.
    pub segment_bytes: u64,
    /// Blocks between two snapshots.
    pub snapshot_every: u64,
    /// Zeros are written ahead of the log, as in a node; without, every write needs new space.
    pub prepares: bool,
    /// Time between two flushes of the world state.
    pub state_flush: u64,
    /// A voter that orders no control calls while it leads, as long as there are faults.
    pub withholds: Option<u64>,
    /// The network and the disks.
    pub network: NetworkPlan,
    /// Longest time of an ordinary flush of the log.
    pub disk_max: u64,
    /// Newer rules are activated, which some nodes do not speak yet: [`ledger::Rules::OF_TESTS`], which are in no release.
    pub activates: bool,
    /// Owners choose who wins, users wait in line, robots are stopped; in the other seeds there are only the older calls.
    pub contests: bool,
    /// Users also submit tasks, and the readers of services are limited.
    pub tasks: bool,
    /// One robot has a confidential service; its readers come and go.
    pub confidential: bool,
    /// Admins apply, propose and approve whole sets of policies, and bring the lists of their CAs.
    pub governs: bool,
}

/// The network's treatment of messages.
#[derive(Clone, Debug)]
pub struct NetworkPlan {
    /// Shortest and longest ordinary way of a message.
    pub delay_min: u64,
    /// See `delay_min`.
    pub delay_max: u64,
    /// Out of a thousand, how many are lost …
    pub lose_per_mille: u64,
    /// … come twice …
    pub duplicate_per_mille: u64,
    /// … overtake others …
    pub reorder_per_mille: u64,
    /// … or take a hundred times as long.
    pub delay_per_mille: u64,
}

/// After the chaos, the cluster must have converged and served within this time.
pub const HEAL_MAX: u64 = 90 * SECOND;

impl Plan {
    /// The plan of a seed.
    pub fn new(seed: u64) -> Self {
        let mut random = Random::new(seed, "plan");
        let voters = [3, 3, 3, 5, 5, 7].get(random.below(6) as usize).copied().unwrap_or(3);
        // One seed in sixteen is quiet, so that what goes wrong in a storm can be told from what always goes wrong.
        let quiet = random.below(16) == 0;
        let mut faults = BTreeSet::new();
        for fault in Fault::ALL.iter().copied() {
            let on = random.percent(55);
            if on && !quiet {
                faults.insert(fault);
            }
        }
        let rate = |fault, random: &mut Random, max| if faults.contains(&fault) { random.between(1, max) } else { 0 };
        let network = NetworkPlan {
            delay_min: random.between(50, 500),
            delay_max: random.between(600, 20 * MILLISECOND),
            lose_per_mille: rate(Fault::Loss, &mut random, 150),
            duplicate_per_mille: rate(Fault::Duplication, &mut random, 150),
            reorder_per_mille: rate(Fault::Reordering, &mut random, 300),
            delay_per_mille: rate(Fault::Delay, &mut random, 30),
        };
        Self {
            voters,
            learners: random.below(3),
            organisations: random.between(2, 3) as usize,
            chaos: random.between(30 * SECOND, 90 * SECOND),
            between_faults: random.between(200 * MILLISECOND, 4 * SECOND),
            timing: Timing { tick: random.between(20, 50) * MILLISECOND, ..Timing::default() },
            shares_caches: random.percent(70),
            clients: random.between(4, 8) as usize,
            think: random.between(100 * MILLISECOND, 800 * MILLISECOND),
            segment_bytes: random.between(8, 64) * 1024,
            snapshot_every: random.between(10, 80),
            prepares: random.percent(60),
            state_flush: random.between(100 * MILLISECOND, 3 * SECOND),
            disk_max: if faults.contains(&Fault::SlowDisk) { random.between(5, 60) * MILLISECOND } else { MILLISECOND },
            activates: random.percent(40),
            // Drawn from nothing: the other seeds go on as they did, and with them the bugs that they notice.
            contests: seed.is_multiple_of(3),
            tasks: seed.is_multiple_of(6),
            governs: seed.is_multiple_of(2),
            confidential: seed % 5 == 4,
            withholds: (seed % 7 == 5).then(|| 1 + seed % voters),
            network,
            faults,
        }
    }
}
