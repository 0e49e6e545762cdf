//! Space on a node's disk: what is still accepted when little is left, and who says so.
//!
//! | free | accepted |
//! |---|---|
//! | a tenth of the disk or more | everything |
//! | less | everything; a warning with path and numbers |
//! | less than [`MESSAGES_FREE_BYTES_MIN`], or the log has found no room | only calls that end control ([`ledger::Chaincode::ends`]) |
//! | less than [`ENDS_FREE_BYTES_MIN`], and the reserve is used up | nothing |
//!
//! Somebody else may fill the disk between two looks, to the last byte. Therefore a *reserve* lies beside the log, a file
//! whose only use is its place. When the log finds no room, the reserve is given up. Entries that are under way are
//! written into that place, and after them everything that ends control.
//!
//! A look at the disk says that there is room again, after the log was written, and only when the reserve fits, too.

use ledger_base::rejection::{Code, Rejection};
use ledger_base::units::size;
use ledger_storage::block_store::StoreError;

/// With less space than this free, no messages are accepted: what was accepted must still fit.
pub const MESSAGES_FREE_BYTES_MIN: u64 = 16 << 20;
/// With less space than this free, and no reserve, nothing is accepted at all.
pub const ENDS_FREE_BYTES_MIN: u64 = 1 << 20;
/// Size of the reserve: the largest block fits twice, with what follows it.
pub const RESERVE_BYTES: u64 = 16 << 20;
/// An organisation has 1/N of what is free for messages written in a second. It has less the fuller the disk
/// is, and needs 12 minutes for half of what is left.
const ORGANISATION_PART: u64 = 1024;
/// It has this number of bytes a second in any case, while messages are accepted: robots are driven and report with less.
const ORGANISATION_BYTES_MIN: u64 = 1 << 20;
/// The warning begins below one part in so many of the disk.
const LOW_PART: u64 = 10;
/// The warning ends when so much of the disk more than that is free, one part in so many: it does not come and go.
const LOW_END_PART: u64 = 100;

/// The calls that are accepted with the space that there is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Accepts {
    /// Everything.
    All,
    /// Calls that end control.
    Ends,
    /// Nothing.
    Nothing,
}

impl Accepts {
    /// The word for it in the status of a node.
    pub fn word(self) -> &'static str {
        match self {
            Self::All => "all",
            Self::Ends => "ends",
            Self::Nothing => "nothing",
        }
    }
}

/// Bytes of a disk.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Measured {
    /// For whoever may not use what is kept for root.
    pub free: u64,
    /// In all.
    pub total: u64,
}

/// The state of the reserve.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reserve {
    /// The place is kept.
    Laid,
    /// It is not, and should be.
    Missing,
    /// It cannot be kept, for a reason that more space does not change.
    Impossible,
}

/// The disk under a [`Space`].
pub trait Ground {
    /// How much there is; nothing if it cannot be asked now.
    fn measure(&mut self) -> Option<Measured>;

    /// How the reserve is.
    fn reserve(&self) -> Reserve;

    /// Takes the place of the reserve, [`RESERVE_BYTES`].
    fn lay(&mut self);

    /// Gives the place back; true if that has made room.
    fn give_up(&mut self) -> bool;
}

/// The outcome of a write of the log.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wrote {
    /// It is on the disk.
    All,
    /// There was no room.
    NoRoom,
    /// Something else was wrong.
    Failed,
}

impl<T> From<&Result<T, StoreError>> for Wrote {
    fn from(written: &Result<T, StoreError>) -> Self {
        match written {
            Ok(_) => Self::All,
            Err(StoreError::DiskFull { .. }) => Self::NoRoom,
            Err(_) => Self::Failed,
        }
    }
}

impl<T> From<&Result<T, Rejection>> for Wrote {
    fn from(written: &Result<T, Rejection>) -> Self {
        match written {
            Ok(_) => Self::All,
            Err(fault) if fault.code == Code::DiskFull => Self::NoRoom,
            Err(_) => Self::Failed,
        }
    }
}

/// The space of a node's disk.
#[derive(Debug)]
pub struct Space {
    /// The directory whose disk this is, for people.
    path: String,
    measured: Measured,
    accepts: Accepts,
    /// Little is left, and that was said.
    low: bool,
    /// The log has found no room, and has not been written since.
    stuck: bool,
}

impl Space {
    /// Looks at the disk for the first time.
    pub fn of(path: String, ground: &mut impl Ground) -> Self {
        let measured = Measured { free: u64::MAX, total: u64::MAX };
        let mut space = Self { path, measured, accepts: Accepts::All, low: false, stuck: false };
        space.look(ground);
        space
    }

    /// Looks again: takes note of what is accepted from now on, and says what has changed.
    pub fn look(&mut self, ground: &mut impl Ground) {
        self.measured = ground.measure().unwrap_or(self.measured);
        let lacks = ground.reserve() == Reserve::Missing;
        if lacks && !self.stuck && self.measured.free >= MESSAGES_FREE_BYTES_MIN + RESERVE_BYTES {
            ground.lay();
            // What the reserve took is not free any more.
            self.measured = ground.measure().unwrap_or(self.measured);
        }
        self.warn_of_little();
        self.accept(accepted(self.measured.free, ground.reserve() != Reserve::Missing, self.stuck));
    }

    /// Takes note of a write of the log. True if it is to be tried again at once, since the reserve has made room.
    pub fn wrote(&mut self, ground: &mut impl Ground, wrote: Wrote) -> bool {
        match wrote {
            Wrote::All => self.stuck = false,
            Wrote::NoRoom => {
                let given = ground.reserve() == Reserve::Laid && ground.give_up();
                self.stuck = true;
                self.look(ground);
                return given;
            }
            Wrote::Failed => {}
        }
        false
    }

    /// The calls that are accepted now.
    pub fn accepts(&self) -> Accepts {
        self.accepts
    }

    /// Is there too little for messages? Then what can wait takes no room either: zeros ahead of the log, and the world
    /// state, which the blocks have.
    pub fn is_full(&self) -> bool {
        self.accepts > Accepts::All
    }

    /// The finding of the last look.
    pub fn measured(&self) -> Measured {
        self.measured
    }

    /// Bytes of transactions a second that are accepted of one organisation.
    pub fn organisation_bytes(&self) -> u64 {
        let free = self.measured.free.saturating_sub(MESSAGES_FREE_BYTES_MIN);
        (free / ORGANISATION_PART).max(ORGANISATION_BYTES_MIN)
    }

    /// Why a call is not accepted, if it is not.
    ///
    /// # Errors
    /// [`Code::DiskFull`]. `ends` is only asked for if it matters.
    pub fn check(&self, ends: impl FnOnce() -> bool) -> Result<(), Rejection> {
        if self.accepts == Accepts::All || (self.accepts == Accepts::Ends && ends()) {
            return Ok(());
        }
        let what = match self.accepts {
            Accepts::Nothing => "no calls",
            _ => "only calls that end control, such as release and revoke",
        };
        let Measured { free, total } = self.measured;
        Err(Rejection::new(Code::DiskFull, format!("the node's disk is almost full, so it accepts {what}"))
            .found(format!("{} of {} free", size(free), size(total)))
            .wanted(format!("{} free, and {} for the reserve", size(MESSAGES_FREE_BYTES_MIN), size(RESERVE_BYTES)))
            .next("free space on the node's disk; it continues automatically"))
    }

    fn warn_of_little(&mut self) {
        let Measured { free, total } = self.measured;
        let (limit, path) = (total / LOW_PART, &self.path);
        let enough = limit.saturating_add(total / LOW_END_PART);
        if free < limit && !std::mem::replace(&mut self.low, true) {
            tracing::warn!(
                %path,
                free = size(free),
                of = size(total),
                "less than a tenth of the disk is free; below {} no messages are accepted",
                size(MESSAGES_FREE_BYTES_MIN)
            );
        } else if free >= enough && std::mem::take(&mut self.low) {
            tracing::warn!(%path, free = size(free), of = size(total), "more than a tenth of the disk is free again");
        }
    }

    fn accept(&mut self, accepts: Accepts) {
        if std::mem::replace(&mut self.accepts, accepts) == accepts {
            return;
        }
        let (path, free, of) = (&self.path, size(self.measured.free), size(self.measured.total));
        match accepts {
            Accepts::All => {
                tracing::error!(%path, free, of, "disk space available again; accepting all calls");
            }
            Accepts::Ends => {
                tracing::error!(%path, free, of, "disk almost full; accepting only calls that end control");
            }
            Accepts::Nothing => tracing::error!(%path, free, of, "disk full; accepting no calls"),
        }
    }
}

/// The calls that are accepted with so much free. `settled`: the reserve is there, or there can be none.
fn accepted(free: u64, settled: bool, stuck: bool) -> Accepts {
    match (settled, stuck) {
        (false, _) if free < ENDS_FREE_BYTES_MIN => Accepts::Nothing,
        (true, false) if free >= MESSAGES_FREE_BYTES_MIN => Accepts::All,
        _ => Accepts::Ends,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GIB: u64 = 1 << 30;

    /// A disk of one GiB; the reserve takes its place.
    struct Disk {
        free: u64,
        reserve: Reserve,
    }

    impl Ground for Disk {
        fn measure(&mut self) -> Option<Measured> {
            Some(Measured { free: self.free, total: GIB })
        }

        fn reserve(&self) -> Reserve {
            self.reserve
        }

        fn lay(&mut self) {
            (self.reserve, self.free) = (Reserve::Laid, self.free - RESERVE_BYTES);
        }

        fn give_up(&mut self) -> bool {
            (self.reserve, self.free) = (Reserve::Missing, self.free + RESERVE_BYTES);
            true
        }
    }

    fn with(free: u64) -> (Disk, Space) {
        let mut disk = Disk { free, reserve: Reserve::Missing };
        let space = Space::of("/data".into(), &mut disk);
        (disk, space)
    }

    #[test]
    fn messages_are_refused_before_what_ends_control() {
        let enough = MESSAGES_FREE_BYTES_MIN;
        assert_eq!(accepted(enough, true, false), Accepts::All);
        assert_eq!(accepted(enough - 1, true, false), Accepts::Ends);
        assert_eq!(accepted(0, true, false), Accepts::Ends, "the reserve is there for that");
        assert_eq!(accepted(enough, true, true), Accepts::Ends, "a quota is full, not the disk");
        assert_eq!(accepted(enough, false, false), Accepts::Ends, "until the reserve is there again");
        assert_eq!(accepted(ENDS_FREE_BYTES_MIN - 1, false, true), Accepts::Nothing);
    }

    #[test]
    fn a_log_without_room_gets_the_reserve_once_and_then_nothing_is_accepted() {
        let (mut disk, mut space) = with(GIB);
        assert_eq!((disk.reserve, space.accepts()), (Reserve::Laid, Accepts::All));
        disk.free = 0;
        assert!(space.wrote(&mut disk, Wrote::NoRoom), "the reserve has made room");
        assert_eq!((disk.reserve, space.accepts()), (Reserve::Missing, Accepts::Ends));
        assert!(space.check(|| true).is_ok(), "a robot can be taken back");
        disk.free = 0;
        assert!(!space.wrote(&mut disk, Wrote::NoRoom), "it is given up once");
        assert_eq!(space.accepts(), Accepts::Nothing);
        assert_eq!(space.check(|| true).map_err(|refused| refused.code), Err(Code::DiskFull));
    }

    #[test]
    fn there_is_room_again_after_a_write_and_a_look_and_not_after_one_of_them() {
        let (mut disk, mut space) = with(GIB);
        disk.free = 0;
        assert!(space.wrote(&mut disk, Wrote::NoRoom));
        disk.free = GIB / 2;
        space.look(&mut disk);
        assert!(
            space.is_full() && disk.reserve == Reserve::Missing,
            "the log was not written yet: a quota may be full"
        );
        assert!(!space.wrote(&mut disk, Wrote::Failed) && space.is_full());
        assert!(!space.wrote(&mut disk, Wrote::All) && space.is_full(), "a write says nothing about the next one");
        space.look(&mut disk);
        assert_eq!((disk.reserve, space.accepts()), (Reserve::Laid, Accepts::All));
    }

    #[test]
    fn the_reserve_is_laid_only_where_messages_fit_beside_it() {
        let (mut disk, mut space) = with(MESSAGES_FREE_BYTES_MIN + RESERVE_BYTES - 1);
        assert_eq!((disk.reserve, space.accepts()), (Reserve::Missing, Accepts::Ends));
        disk.free += 1;
        space.look(&mut disk);
        assert_eq!((disk.reserve, disk.free), (Reserve::Laid, MESSAGES_FREE_BYTES_MIN));
        assert_eq!((space.accepts(), space.measured().free), (Accepts::All, MESSAGES_FREE_BYTES_MIN));
    }

    #[test]
    fn where_no_reserve_can_be_kept_the_space_that_is_left_serves() {
        let mut disk = Disk { free: GIB, reserve: Reserve::Impossible };
        let mut space = Space::of("/data".into(), &mut disk);
        assert_eq!(space.accepts(), Accepts::All);
        disk.free = 0;
        assert!(!space.wrote(&mut disk, Wrote::NoRoom));
        assert_eq!(space.accepts(), Accepts::Ends);
    }

    #[test]
    fn a_refusal_tells_what_is_free_and_what_is_needed() {
        let (_, space) = with(3 << 20);
        let refused = space.check(|| false).map_err(|refused| (refused.code, refused.found, refused.wanted));
        let wanted = "16 MiB free, and 16 MiB for the reserve".into();
        assert_eq!(refused, Err((Code::DiskFull, "3.0 MiB of 1.0 GiB free".into(), wanted)));
    }

    #[test]
    fn an_organisation_has_less_the_fuller_the_disk_is_and_something_while_messages_are_accepted() {
        let share =
            |free| Space::of(String::new(), &mut Disk { free, reserve: Reserve::Impossible }).organisation_bytes();
        assert_eq!(share(8 * GIB), (8 * GIB - MESSAGES_FREE_BYTES_MIN) / ORGANISATION_PART);
        assert!(share(4 * GIB) < share(8 * GIB) && share(2 * GIB) < share(4 * GIB));
        assert_eq!(share(MESSAGES_FREE_BYTES_MIN), ORGANISATION_BYTES_MIN);
    }
}
