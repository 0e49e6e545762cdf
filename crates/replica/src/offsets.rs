//! The clock of a node's machine against the clocks of the voters.

use ledger_base::rejection::{Code, Rejection};

/// A node whose clock is so far from those of most voters answers nothing that depends on time, microseconds. Gates tolerate less.
pub const CLOCK_OFF_MAX: u64 = 5_000_000;

/// The clock of another machine as seen from this one, microseconds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Offset {
    /// How far it is ahead; below 0 where it is behind.
    pub ahead: i64,
    /// How far off that may be: half of the way there and back, at least 1.
    pub error: u64,
}

impl Offset {
    /// Of a clock that showed `told` when it was asked at `asked` by the clock of this machine. The answer took `took`. All in
    /// microseconds. None if the difference is too large to be stated.
    pub fn of(told: u64, asked: u64, took: u64) -> Option<Self> {
        let error = (took / 2).max(1);
        let ahead = i128::from(told) - i128::from(asked.saturating_add(error));
        Some(Self { ahead: i64::try_from(ahead).ok()?, error })
    }

    /// How far the clock is ahead at least; 0 where the error may explain the difference.
    fn at_least(self) -> i64 {
        let sure = self.ahead.unsigned_abs().saturating_sub(self.error);
        i64::try_from(sure).unwrap_or(i64::MAX) * self.ahead.signum()
    }
}

/// How far the clocks of most voters are ahead of this machine's at least, microseconds; below 0 where they are behind. `others` are
/// the clocks of the other voters. Of two in the middle the nearer one counts: one other clock says nothing against this one.
pub fn ahead_of_this(others: impl IntoIterator<Item = Offset>) -> i64 {
    let mut all: Vec<i64> = others.into_iter().map(Offset::at_least).chain([0]).collect();
    all.sort_unstable();
    let middle = [all.get((all.len() - 1) / 2), all.get(all.len() / 2)];
    middle.into_iter().flatten().copied().min_by_key(|off| off.unsigned_abs()).unwrap_or_default()
}

/// States how far a machine's clock is from those of most voters, e.g. "3.2 s ahead of those of most voters". `off` is as
/// [`ahead_of_this`] answers it.
pub fn described(off: i64) -> String {
    let (way, far) = (if off > 0 { "behind" } else { "ahead of" }, off.unsigned_abs());
    format!("{}.{} s {way} those of most voters", far / 1_000_000, far / 100_000 % 10)
}

/// Checks that the clock of this node's machine is within the bound. `off` is as [`ahead_of_this`] answers it, `node` the full name
/// of the node.
///
/// # Errors
/// [`Code::ClockOutOfBounds`].
pub fn check(off: i64, node: &str) -> Result<(), Rejection> {
    if off.unsigned_abs() < CLOCK_OFF_MAX {
        return Ok(());
    }
    Err(Rejection::new(
        Code::ClockOutOfBounds,
        format!(
            "the clock of node {node} is wrong, so it accepts only calls \
                                                        that end control"
        ),
    )
    .found(format!("the clock of its machine is {}", described(off)))
    .wanted(format!("less than {} s", CLOCK_OFF_MAX / 1_000_000))
    .next(format!("use another node; on the machine of {node}: timedatectl set-ntp true")))
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    const SECOND: i64 = 1_000_000;

    #[test]
    fn the_clock_of_another_machine_is_read_in_the_middle_of_the_way_there_and_back() {
        let of = |told| Offset::of(told, 5_000_000, 300);
        assert_eq!(of(5_000_150), Some(Offset { ahead: 0, error: 150 }));
        assert_eq!(of(4_000_150).map(|offset| offset.ahead), Some(-1_000_000));
        assert_eq!(of(u64::MAX), None, "too far off");
    }

    #[test]
    fn most_voters_decide_whose_clock_is_wrong_and_one_alone_says_nothing_against_another() {
        let off = |others: &[i64]| ahead_of_this(others.iter().map(|ahead| Offset { ahead: *ahead, error: 100_000 }));
        assert_eq!(off(&[]), 0);
        assert_eq!(off(&[9 * SECOND]), 0, "nobody knows which of two is wrong");
        assert_eq!(off(&[0, 9 * SECOND]), 0, "the other one is wrong");
        assert_eq!(off(&[9 * SECOND, 9 * SECOND]), 8_900_000, "this one is, by that at least");
        assert_eq!(off(&[-9 * SECOND, 9 * SECOND]), 0);
        assert_eq!(off(&[50_000, 50_000]), 0, "the error may explain it");
    }

    #[test]
    fn a_node_whose_clock_is_out_of_bounds_names_itself_and_the_next_step() {
        assert_eq!(check(4_999_999, "Org1/node1"), Ok(()));
        let refused = check(-3600 * SECOND, "Org1/node1").unwrap_err();
        assert_eq!(refused.code, Code::ClockOutOfBounds);
        assert_eq!(refused.found, "the clock of its machine is 3600.0 s ahead of those of most voters");
        assert!(refused.advice().contains("on the machine of Org1/node1: timedatectl"), "{refused}");
        assert!(check(5 * SECOND, "Org1/node1").unwrap_err().found.contains("5.0 s behind"));
    }
}
