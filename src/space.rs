//! Space on the disk of the data directory: how much there is, and what is still accepted when little is left.
//!
//! | free | accepted |
//! |---|---|
//! | a tenth of the disk or more | everything |
//! | less | everything; a warning with path and numbers |
//! | less than [`MESSAGES_FREE_BYTES_MIN`], or the log has found no room | only calls that end control ([`ledger::Chaincode::ends`]) |
//! | less than [`ENDS_FREE_BYTES_MIN`], and the reserve is used up | nothing |
//!
//! Somebody else may fill the disk between two looks, to the last byte. Therefore a *reserve* lies in the data
//! directory, a file whose only use is its place. When the log finds no room, the reserve is given up. Entries that are
//! under way are written into that place, and after them everything that ends control.

mod reserve;

use ledger_rejection::{Code, Rejection};
use reserve::Reserve;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU8, AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};

/// With less space than this free, no messages are accepted: what was accepted must still fit.
const MESSAGES_FREE_BYTES_MIN: u64 = 16 << 20;
/// With less space than this free, and no reserve, nothing is accepted at all.
const ENDS_FREE_BYTES_MIN: u64 = 1 << 20;
/// The warning begins below one part in so many of the disk.
const LOW_PART: u64 = 10;
/// The warning ends when so much of the disk more than that is free, one part in so many: it does not come and go.
const LOW_END_PART: u64 = 100;

/// The calls that are accepted with the space that there is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub(crate) enum Accepts {
    /// Everything.
    All,
    /// Calls that end control.
    Ends,
    /// Nothing.
    Nothing,
}

impl Accepts {
    /// The word for it in the status of a node.
    pub(crate) fn word(self) -> &'static str {
        match self {
            Self::All => "all",
            Self::Ends => "ends",
            Self::Nothing => "nothing",
        }
    }
}

/// Bytes of a disk.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Measured {
    /// For whoever may not use what is kept for root.
    pub free: u64,
    /// In all.
    pub total: u64,
}

/// The space of a node's disk.
pub(crate) struct Space {
    data: PathBuf,
    free: AtomicU64,
    total: AtomicU64,
    /// A number of [`Accepts`].
    accepts: AtomicU8,
    /// Little is left, and that was said.
    low: AtomicBool,
    /// The log has found no room, and has not been written since.
    stuck: AtomicBool,
    reserve: Mutex<Reserve>,
}

impl Space {
    /// Looks at the disk of a data directory, and lays the reserve in it.
    pub(crate) fn open(data: &Path) -> Self {
        let space = Self {
            data: std::path::absolute(data).unwrap_or_else(|_| data.to_owned()),
            free: AtomicU64::new(u64::MAX),
            total: AtomicU64::new(u64::MAX),
            accepts: AtomicU8::new(Accepts::All as u8),
            low: AtomicBool::new(false),
            stuck: AtomicBool::new(false),
            reserve: Mutex::new(Reserve::of(data)),
        };
        space.look();
        space
    }

    /// Looks again: takes note of what is accepted from now on, and says what has changed.
    pub(crate) fn look(&self) {
        let measured = match measure(&self.data) {
            Ok(measured) => measured,
            Err(error) => return tracing::debug!(%error, "cannot ask how much space is left"),
        };
        let mut reserve = self.reserve.lock().unwrap_or_else(PoisonError::into_inner);
        let stuck = self.stuck.load(Ordering::Relaxed);
        if !stuck && !reserve.is_settled() && measured.free >= MESSAGES_FREE_BYTES_MIN + reserve::BYTES {
            reserve.lay();
        }
        let settled = reserve.is_settled();
        drop(reserve);
        // What the reserve took is not free any more.
        let measured = measure(&self.data).unwrap_or(measured);
        self.free.store(measured.free, Ordering::Relaxed);
        self.total.store(measured.total, Ordering::Relaxed);
        self.warn_of_little(measured);
        self.accept(accepted(measured.free, settled, stuck), measured);
    }

    /// The log has found no room: the reserve is given up. True if that has made room.
    pub(crate) fn no_room(&self) -> bool {
        let given = self.reserve.lock().unwrap_or_else(PoisonError::into_inner).give_up();
        self.stuck.store(true, Ordering::Relaxed);
        self.look();
        given
    }

    /// The log has been written.
    pub(crate) fn room(&self) {
        if self.stuck.load(Ordering::Relaxed) {
            self.stuck.store(false, Ordering::Relaxed);
        }
    }

    /// Is there too little for messages?
    pub(crate) fn is_full(&self) -> bool {
        self.accepts() > Accepts::All
    }

    /// The calls that are accepted now.
    pub(crate) fn accepts(&self) -> Accepts {
        match self.accepts.load(Ordering::Relaxed) {
            0 => Accepts::All,
            1 => Accepts::Ends,
            _ => Accepts::Nothing,
        }
    }

    /// The finding of the last look.
    pub(crate) fn measured(&self) -> Measured {
        Measured { free: self.free.load(Ordering::Relaxed), total: self.total.load(Ordering::Relaxed) }
    }

    /// The directory whose disk this is.
    pub(crate) fn data(&self) -> &Path {
        &self.data
    }

    /// Why a call is not accepted, if it is not.
    ///
    /// # Errors
    /// [`Code::DiskFull`]. `ends` is only asked for if it matters.
    pub(crate) fn check(&self, ends: impl FnOnce() -> bool) -> Result<(), Rejection> {
        let accepts = self.accepts();
        if accepts == Accepts::All || (accepts == Accepts::Ends && ends()) {
            return Ok(());
        }
        let what = match accepts {
            Accepts::Nothing => "nothing more",
            _ => "nothing more but calls that end control, such as release and revoke",
        };
        let Measured { free, total } = self.measured();
        Err(Rejection::new(Code::DiskFull, format!("the node's disk is almost full, so it accepts {what}"))
            .found(format!("{} of {} free", bytes(free), bytes(total)))
            .wanted(format!("{} free, and {} for the reserve", bytes(MESSAGES_FREE_BYTES_MIN), bytes(reserve::BYTES)))
            .next("free space on the node's disk; it goes on by itself"))
    }

    fn warn_of_little(&self, Measured { free, total }: Measured) {
        let limit = total / LOW_PART;
        let path = self.data.display();
        if free < limit && !self.low.swap(true, Ordering::Relaxed) {
            tracing::warn!(
                %path,
                free = bytes(free),
                of = bytes(total),
                "less than a tenth of the disk is free; below {} no messages are accepted",
                bytes(MESSAGES_FREE_BYTES_MIN)
            );
        } else if free >= limit.saturating_add(total / LOW_END_PART) && self.low.swap(false, Ordering::Relaxed) {
            tracing::warn!(%path, free = bytes(free), of = bytes(total), "more than a tenth of the disk is free again");
        }
    }

    fn accept(&self, accepts: Accepts, Measured { free, total }: Measured) {
        let before = self.accepts.swap(accepts as u8, Ordering::Relaxed);
        if before == accepts as u8 {
            return;
        }
        let (path, free, of) = (self.data.display(), bytes(free), bytes(total));
        match accepts {
            Accepts::All => {
                tracing::error!(%path, free, of, "there is space on the disk again; everything is accepted")
            }
            Accepts::Ends => {
                tracing::error!(%path, free, of, "the disk is almost full; only calls that end control are accepted");
            }
            Accepts::Nothing => tracing::error!(%path, free, of, "the disk is full; nothing more is accepted"),
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

fn measure(path: &Path) -> io::Result<Measured> {
    let found = rustix::fs::statvfs(path)?;
    let size = |blocks: u64| blocks.saturating_mul(found.f_frsize);
    Ok(Measured { free: size(found.f_bavail), total: size(found.f_blocks) })
}

/// A size as people read it.
fn bytes(count: u64) -> String {
    match count {
        0..1024 => format!("{count} bytes"),
        1024..0x10_0000 => format!("{} KiB", count >> 10),
        0x10_0000..0x2_8000_0000 => format!("{} MiB", count >> 20),
        _ => format!("{} GiB", count >> 30),
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

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
    fn the_reserve_takes_its_place_and_gives_it_back() {
        let directory = tempfile::tempdir().unwrap();
        let space = Space::open(directory.path());
        assert_eq!(space.accepts(), Accepts::All, "this test needs a disk with some space");
        let laid = std::fs::metadata(directory.path().join(reserve::FILE)).unwrap();
        assert_eq!(laid.len(), reserve::BYTES);
        assert!(std::os::unix::fs::MetadataExt::blocks(&laid) * 512 >= reserve::BYTES, "no holes");
        assert!(space.no_room() && !space.no_room(), "it is given up once");
        assert!(space.check(|| true).is_ok());
        let refused = space.check(|| false).unwrap_err();
        assert!(refused.code == Code::DiskFull && refused.found.contains("free"), "{refused}");
        space.room();
        space.look();
        assert_eq!(space.accepts(), Accepts::All);
        assert_eq!(std::fs::metadata(directory.path().join(reserve::FILE)).unwrap().len(), reserve::BYTES);
    }

    #[test]
    fn sizes_are_told_in_the_unit_that_people_use() {
        let told: Vec<_> = [999, 2048, 16 << 20, 3 << 30, 20 << 30].map(bytes).into();
        assert_eq!(told, ["999 bytes", "2 KiB", "16 MiB", "3072 MiB", "20 GiB"]);
    }
}
