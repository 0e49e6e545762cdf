//! How long a node keeps blocks.
//!
//! Blocks are dropped in whole segments, the oldest first, and only those that a snapshot of this node makes needless.
//! The rest can be executed from that snapshot, by this node after a restart, by one that joins, and by an auditor.

use crate::block_store::Finished;
use ledger_base::rejection::{Code, Rejection};
use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;

/// Shortest age that can be set, microseconds.
pub const AGE_MIN_US: u64 = 10 * 60 * 1_000_000;

/// Blocks of this time are kept in any case while they are not [`SIZE_PARTS_MAX`] times as large as the size that is set, microseconds. It is twice as long as a transaction may be repeated, and its verdict asked for.
pub const KEPT_MIN_US: u64 = 4 * 60 * 1_000_000;

const _: () = assert!(KEPT_MIN_US <= AGE_MIN_US);

/// However new blocks are, no more of them are kept than N times the size that is set: a flood fills a disk in seconds.
pub const SIZE_PARTS_MAX: u64 = 2;

/// Smallest limit of the size, bytes: several segments at their default size.
pub const SIZE_MIN_BYTES: u64 = 64 << 20;

/// A setting of the node. Reads and prints as `forever`, an age like `30d` or `12h`, a size like `20GiB` or `500MiB`, or both
/// like `30d,20GiB`. Then blocks are dropped that are beyond one of them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Retention {
    /// Blocks older than this are dropped, microseconds of block time.
    age: Option<u64>,
    /// The oldest blocks are dropped when finished segments are larger than this, bytes.
    size: Option<u64>,
}

/// The known extent of a node's blocks.
pub struct Kept<'a> {
    /// Its finished segments, the oldest first.
    pub finished: &'a [Finished],
    /// Height of the oldest snapshot that the node keeps; without one nothing is dropped.
    pub oldest_snapshot: Option<u64>,
    /// Block time of the newest block executed, microseconds.
    pub time: u64,
    /// Block time at a height; none if it is not known, then the block is kept.
    pub time_of: &'a dyn Fn(u64) -> Option<u64>,
}

impl Retention {
    /// Everything is kept.
    pub const FOREVER: Self = Self { age: None, size: None };

    /// From which block on this node keeps its blocks and what follows from them: to be given to
    /// [`BlockStore::prune`](crate::block_store::BlockStore::prune). 0: nothing is dropped.
    pub fn keep_from(&self, kept: &Kept<'_>) -> u64 {
        let Some(snapshot) = kept.oldest_snapshot else { return 0 };
        let mut bytes: u64 = kept.finished.iter().map(|segment| segment.bytes).sum();
        let mut keep_from = 0;
        for segment in kept.finished {
            let newest = segment.next_index.saturating_sub(1);
            if newest > snapshot || !self.drops(newest, bytes, kept) {
                break;
            }
            bytes -= segment.bytes;
            keep_from = segment.next_index;
        }
        keep_from
    }

    /// Is a segment dropped, with this newest block, if this number of bytes is kept with it? The time of the block is read from
    /// disk, so it is asked for only where it matters.
    fn drops(&self, newest: u64, bytes: u64, kept: &Kept<'_>) -> bool {
        let beyond = |times: u64| self.size.is_some_and(|size| bytes > size.saturating_mul(times));
        let is_older = |age: u64| {
            let limit = kept.time.saturating_sub(age.max(KEPT_MIN_US));
            (kept.time_of)(newest).is_some_and(|time| time < limit)
        };
        beyond(SIZE_PARTS_MAX) || (beyond(1) && is_older(0)) || self.age.is_some_and(is_older)
    }
}

const AGES: [(&str, u64); 3] = [("d", 86_400_000_000), ("h", 3_600_000_000), ("min", 60_000_000)];
const SIZES: [(&str, u64); 3] = [("TiB", 1 << 40), ("GiB", 1 << 30), ("MiB", 1 << 20)];

impl FromStr for Retention {
    type Err = Rejection;

    fn from_str(text: &str) -> Result<Self, Rejection> {
        let refuse = |wanted: &str| {
            Rejection::new(Code::BadConfiguration, "this is not a retention").found(format!("{text:?}")).wanted(wanted)
        };
        if text == "forever" {
            return Ok(Self::FOREVER);
        }
        let mut retention = Self::FOREVER;
        for part in text.split(',') {
            let split = part.find(|c: char| !c.is_ascii_digit()).unwrap_or(part.len());
            let (number, unit) = part.split_at(split);
            let number = |factor: u64| number.parse::<u64>().ok().and_then(|number| number.checked_mul(factor));
            let find =
                |units: &[(&str, u64)]| units.iter().find(|(name, _)| *name == unit).and_then(|(_, f)| number(*f));
            match (find(&AGES), find(&SIZES)) {
                (Some(age), _) if age < AGE_MIN_US => return Err(refuse("at least 10min")),
                (_, Some(size)) if size < SIZE_MIN_BYTES => return Err(refuse("at least 64MiB")),
                (Some(age), _) if retention.age.is_none() => retention.age = Some(age),
                (_, Some(size)) if retention.size.is_none() => retention.size = Some(size),
                _ => {
                    return Err(refuse(
                        "forever, an age like 30d, 12h or 90min, a size like 2TiB, 20GiB or 500MiB, or both: 30d,20GiB",
                    ));
                }
            }
        }
        Ok(retention)
    }
}

impl fmt::Display for Retention {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let shown = |number: u64, units: [(&str, u64); 3]| {
            // The smallest unit, if none divides it: no such value is ever read.
            let fits = units.iter().find(|(_, factor)| number.is_multiple_of(*factor)).or(units.last());
            let (unit, factor) = fits.copied().unwrap_or(("", 1));
            format!("{}{unit}", number / factor)
        };
        match (self.age.map(|age| shown(age, AGES)), self.size.map(|size| shown(size, SIZES))) {
            (None, None) => f.write_str("forever"),
            (Some(one), None) | (None, Some(one)) => f.write_str(&one),
            (Some(age), Some(size)) => write!(f, "{age},{size}"),
        }
    }
}

impl TryFrom<String> for Retention {
    type Error = Rejection;

    fn try_from(text: String) -> Result<Self, Rejection> {
        text.parse()
    }
}

impl From<Retention> for String {
    fn from(retention: Retention) -> Self {
        retention.to_string()
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    const MINUTE: u64 = 60_000_000;

    /// Ten segments of 100 blocks and 100 MiB; a block a minute.
    fn kept_from(retention: &str, oldest_snapshot: Option<u64>) -> u64 {
        let finished: Vec<Finished> = (0..10)
            .map(|i| Finished { first_index: i * 100 + 1, next_index: i * 100 + 101, bytes: 100 << 20 })
            .collect();
        let time_of = |height: u64| Some(height * MINUTE);
        let kept = Kept { finished: &finished, oldest_snapshot, time: 1050 * MINUTE, time_of: &time_of };
        retention.parse::<Retention>().unwrap().keep_from(&kept)
    }

    #[test]
    fn blocks_beyond_age_or_size_are_dropped_in_whole_segments() {
        assert_eq!(kept_from("forever", Some(1000)), 0);
        // Block 450 is 600 minutes old.
        assert_eq!(kept_from("600min", Some(1000)), 401);
        assert_eq!(kept_from("10h", Some(1000)), 401);
        assert_eq!(kept_from("1d", Some(1000)), 0);
        assert_eq!(kept_from("300MiB", Some(1000)), 701);
        assert_eq!(kept_from("1GiB", Some(1000)), 0);
    }

    #[test]
    fn where_age_and_size_are_set_blocks_beyond_one_of_them_are_dropped() {
        assert_eq!(kept_from("600min,1GiB", Some(1000)), 401, "beyond the age");
        assert_eq!(kept_from("1d,300MiB", Some(1000)), 701, "beyond the size");
        assert_eq!(kept_from("1d,1GiB", Some(1000)), 0);
    }

    #[test]
    fn nothing_is_dropped_that_no_snapshot_holds() {
        assert_eq!(kept_from("64MiB", None), 0);
        assert_eq!(kept_from("64MiB", Some(500)), 501);
        assert_eq!(kept_from("64MiB", Some(499)), 401);
        assert_eq!(kept_from("10min", Some(250)), 201);
    }

    /// From where one segment of so many bytes is kept, whose newest block is that old, or of unknown age.
    fn one_kept_from(bytes: u64, age: Option<u64>) -> u64 {
        let finished = [Finished { first_index: 1, next_index: 11, bytes }];
        let time_of = |_| age.map(|_| 5 * MINUTE);
        let time = 5 * MINUTE + age.unwrap_or(1000 * MINUTE);
        let kept = Kept { finished: &finished, oldest_snapshot: Some(10), time, time_of: &time_of };
        Retention { age: None, size: Some(SIZE_MIN_BYTES) }.keep_from(&kept)
    }

    #[test]
    fn blocks_of_the_last_minutes_are_kept_up_to_twice_the_size() {
        let twice = SIZE_PARTS_MAX * SIZE_MIN_BYTES;
        assert_eq!(one_kept_from(twice, Some(KEPT_MIN_US)), 0);
        assert_eq!(one_kept_from(twice, Some(KEPT_MIN_US + 1)), 11);
        assert_eq!(one_kept_from(twice, None), 0, "its age is not known");
        for age in [Some(0), Some(KEPT_MIN_US), None] {
            assert_eq!(one_kept_from(twice + 1, age), 11, "a flood");
        }
    }

    #[test]
    fn a_setting_prints_as_it_is_read() {
        for text in ["forever", "30d", "12h", "90min", "20GiB", "500MiB", "2TiB", "30d,20GiB"] {
            assert_eq!(text.parse::<Retention>().unwrap().to_string(), text);
        }
        assert_eq!("24h".parse::<Retention>().unwrap().to_string(), "1d");
        assert_eq!("20GiB,30d".parse::<Retention>().unwrap().to_string(), "30d,20GiB");
        for text in [
            "",
            "never",
            "9min",
            "63MiB",
            "30",
            "d",
            "-1d",
            "1.5h",
            "99999999999999TiB",
            "1 d",
            "1d,2d",
            "1GiB,2GiB",
            "1d,",
            "forever,1d",
            "1d,63MiB",
        ] {
            assert_eq!(text.parse::<Retention>().unwrap_err().code, Code::BadConfiguration, "{text}");
        }
    }
}
