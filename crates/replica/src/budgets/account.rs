//! One account: two buckets that fill again with time.

/// Time of a rate that may be used at once, microseconds.
pub const BURST: u64 = 4_000_000;
/// Most time that is owed, microseconds: a rate that was far too low, and was raised, is forgotten after it.
const OWED_MAX: u64 = 60_000_000;

/// The limit of an account, for each second.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Rate {
    pub(super) bytes: u64,
    pub(super) messages: u64,
}

impl Rate {
    pub(super) const UNLIMITED: Self = Self { bytes: u64::MAX, messages: u64::MAX };
}

/// The amount that is counted at once.
#[derive(Clone, Copy, Debug)]
pub(super) struct Counted {
    pub(super) bytes: u64,
    pub(super) messages: u64,
}

/// The account of an identity, an organisation or a service.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Account {
    /// The amount that this gateway has let in, by its steady clock.
    pub(super) own: Level,
    /// The amount that blocks hold, by block time.
    pub(super) all: Level,
}

impl Account {
    /// Time until more may be let in, microseconds; 0 if it may be now.
    pub(super) fn wait(&self, elapsed: u64, clock: u64) -> u64 {
        self.own.wait(elapsed).max(self.all.wait(clock))
    }

    /// Is something counted that has not passed at this block time?
    pub(super) fn owes(&self, time: u64) -> bool {
        self.all.bytes.max(self.all.messages) > time
    }
}

/// The generic cell rate algorithm: the times until which what was counted takes at the rates, microseconds.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Level {
    bytes: u64,
    messages: u64,
}

impl Level {
    /// Time until what was counted is a burst at most, microseconds. The last one may go beyond the burst, so that a message of
    /// any size passes at some time.
    pub(super) fn wait(&self, now: u64) -> u64 {
        self.bytes.max(self.messages).saturating_sub(now.saturating_add(BURST))
    }

    pub(super) fn count(&mut self, rate: Rate, now: u64, counted: Counted) {
        let until = |before: u64, amount: u64, rate: u64| {
            let takes = amount.saturating_mul(1_000_000) / rate.max(1);
            before.max(now).saturating_add(takes).min(now.saturating_add(BURST + OWED_MAX))
        };
        self.bytes = until(self.bytes, counted.bytes, rate.bytes);
        self.messages = until(self.messages, counted.messages, rate.messages);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: u64 = 1_000_000;
    const RATE: Rate = Rate { bytes: 1000, messages: 10 };
    const ONE: Counted = Counted { bytes: 100, messages: 1 };

    /// How many pass at once.
    fn passing(level: &mut Level, rate: Rate, now: u64, counted: Counted) -> usize {
        let mut passed = 0;
        while level.wait(now) == 0 && passed < 10_000 {
            level.count(rate, now, counted);
            passed += 1;
        }
        passed
    }

    #[test]
    fn a_burst_passes_and_then_the_rate() {
        let mut level = Level::default();
        // The one that uses the burst up passes, too.
        assert_eq!(passing(&mut level, RATE, SECOND, ONE), 41);
        assert_eq!(level.wait(SECOND), 100_000, "the rest of the last one");
        assert_eq!(passing(&mut level, RATE, SECOND + 100_000, ONE), 1);
        assert_eq!(passing(&mut level, RATE, 2 * SECOND + 100_000, ONE), 10, "a second at the rate");
        assert_eq!(passing(&mut level, RATE, 1000 * SECOND, ONE), 41, "no more than a burst is saved");
    }

    #[test]
    fn bytes_and_messages_are_limited_each() {
        let (mut small, mut large) = (Level::default(), Level::default());
        assert_eq!(passing(&mut small, RATE, 0, Counted { bytes: 1, messages: 1 }), 41);
        assert_eq!(passing(&mut large, RATE, 0, Counted { bytes: 1000, messages: 1 }), 5);
    }

    #[test]
    fn a_message_of_any_size_passes_and_is_owed() {
        let mut level = Level::default();
        assert_eq!(passing(&mut level, RATE, 0, Counted { bytes: 10_000, messages: 1 }), 1);
        assert_eq!(level.wait(0), 6 * SECOND);
        assert_eq!(passing(&mut level, RATE, 6 * SECOND, ONE), 1);
    }

    #[test]
    fn an_account_owes_a_minute_at_most() {
        let mut level = Level::default();
        let nothing = Rate { bytes: 1, messages: 1 };
        level.count(nothing, 0, Counted { bytes: 1 << 40, messages: 1 });
        assert_eq!(level.wait(0), OWED_MAX);
    }

    #[test]
    fn blocks_and_the_own_gateway_count_each() {
        let mut account = Account::default();
        account.all.count(RATE, 0, Counted { bytes: 10_000, messages: 1 });
        assert_eq!(account.wait(100 * SECOND, 0), 6 * SECOND, "let in elsewhere");
        assert_eq!(account.wait(100 * SECOND, 6 * SECOND), 0);
        account.own.count(RATE, 100 * SECOND, Counted { bytes: 10_000, messages: 1 });
        assert_eq!(account.wait(100 * SECOND, 6 * SECOND), 6 * SECOND);
    }
}
