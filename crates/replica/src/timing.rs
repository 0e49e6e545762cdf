//! The times of ordering: ticks, elections, and how long data waits.

/// Shortest time without a leader after which a node may stand for election, microseconds: below it a slow disk looks like a
/// dead leader.
pub const ELECTION_TIME_MIN: u64 = 100_000;
/// Longest such time, microseconds.
pub const ELECTION_TIME_MAX: u64 = 60_000_000;
/// A leader is heard so often in an election time.
const HEARTBEATS: usize = 5;

/// The times of one node, which its operator may set. The default suits a network on one site.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Timing {
    /// Length of a tick, microseconds.
    pub tick: u64,
    /// Ticks without a leader after which a node stands for election.
    pub election_ticks: usize,
    /// Longest time that data waits to be looked at, and again for its block, microseconds. Then it is refused.
    pub data_wait: u64,
}

impl Default for Timing {
    fn default() -> Self {
        Self { tick: 50_000, election_ticks: 10, data_wait: 200_000 }
    }
}

impl Timing {
    /// Time without a leader after which a node stands for election, microseconds.
    pub fn election_time(&self) -> u64 {
        self.tick.saturating_mul(u64::try_from(self.election_ticks).unwrap_or(u64::MAX))
    }

    /// Can a leader be told from a dead one by these times?
    pub fn can_elect(&self) -> bool {
        self.election_ticks > self.heartbeat_ticks()
            && (ELECTION_TIME_MIN..=ELECTION_TIME_MAX).contains(&self.election_time())
    }

    /// Ticks between two heartbeats of a leader.
    pub(crate) fn heartbeat_ticks(&self) -> usize {
        (self.election_ticks / HEARTBEATS).max(1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_leader_is_heard_several_times_before_a_node_stands_for_election() {
        for (election_ticks, heartbeat_ticks) in [(2, 1), (10, 2), (20, 4), (1000, 200)] {
            assert_eq!(Timing { election_ticks, ..Timing::default() }.heartbeat_ticks(), heartbeat_ticks);
        }
    }

    #[test]
    fn an_election_time_has_bounds() {
        let timing = Timing::default();
        assert!(timing.can_elect() && timing.election_time() == 500_000);
        assert!(!Timing { election_ticks: 1, ..timing }.can_elect(), "no heartbeat comes before");
        let of = |time| Timing { tick: time / 10, ..timing };
        assert!(of(ELECTION_TIME_MIN).can_elect() && of(ELECTION_TIME_MAX).can_elect());
        assert!(!of(ELECTION_TIME_MIN - 10).can_elect() && !of(ELECTION_TIME_MAX + 10).can_elect());
    }
}
