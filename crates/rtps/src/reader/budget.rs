//! The bytes that samples of each writer hold in a reader, and which of them give way where they are too many.
//!
//! Each writer may hold an equal share. Any of them may use the rest. Where there is too little, a writer above its share
//! gives way: first one that has waited too long for the same sample, then the one whose sample came last. So the oldest large
//! samples are completed one after the other, and a writer within its share loses nothing to others.

use super::store::Store;
use super::{Reader, WriterProxy};
use crate::endpoint::Delivered;
use crate::guid::Guid;
use crate::limits::ASSEMBLY_MICROS_MAX;

/// Room is made down to this part of the limit, so that not each datagram has to make some: one sixteenth stays free.
const FREE_PART: usize = 16;

/// The samples of one writer that wait.
#[derive(Debug, Default)]
pub(super) struct Holding {
    bytes: usize,
    /// The sample that is waited for, or the first behind it.
    lowest: Option<i64>,
    /// Since when it is the lowest one.
    since: u64,
}

impl Holding {
    pub(super) fn bytes(&self) -> usize {
        self.bytes
    }

    /// Returns how many bytes it was before.
    pub(super) fn update(&mut self, now: u64, store: &Store) -> usize {
        let lowest = store.lowest();
        if lowest != self.lowest {
            (self.lowest, self.since) = (lowest, now);
        }
        std::mem::replace(&mut self.bytes, store.bytes())
    }

    /// The order in which holdings give way: the greatest first.
    fn rank(&self, now: u64) -> (bool, u64) {
        let is_overdue = now.saturating_sub(self.since) > ASSEMBLY_MICROS_MAX;
        (is_overdue, if is_overdue { u64::MAX - self.since } else { self.since })
    }
}

impl Reader {
    /// Bytes of samples that wait.
    pub(crate) fn held(&self) -> usize {
        self.held
    }

    /// The bytes of a writer have changed.
    pub(super) fn account(&mut self, now: u64, writer: Guid) {
        let Some(matched) = self.writers.get_mut(&writer) else { return };
        let before = matched.holding.update(now, matched.proxy.store());
        self.held = self.held.saturating_sub(before).saturating_add(matched.holding.bytes);
    }

    /// Keeps the limit of this reader.
    pub(super) fn keep_limit(&mut self, now: u64, out: &mut Vec<Delivered>) {
        if self.held > self.room {
            self.make_room(now, self.room - self.room / FREE_PART, out);
        }
    }

    /// How urgently this reader gives way, where several share a limit. None if it holds nothing.
    pub(crate) fn rank(&self, now: u64) -> Option<(bool, u64)> {
        let share = self.held / self.writers.len().max(1);
        self.holdings().filter(|(_, holding)| holding.bytes >= share.max(1)).map(|(_, holding)| holding.rank(now)).max()
    }

    /// Drops samples until at most `target` bytes wait.
    pub(crate) fn make_room(&mut self, now: u64, target: usize, out: &mut Vec<Delivered>) {
        let share = target / self.writers.len().max(1);
        while self.held > target {
            let above = self.holdings().filter(|(_, holding)| holding.bytes > share);
            let Some((writer, bytes)) =
                above.max_by_key(|(_, holding)| holding.rank(now)).map(|(writer, holding)| (writer, holding.bytes))
            else {
                break;
            };
            let limit = share.max(bytes.saturating_sub(self.held - target));
            if let Some(matched) = self.writers.get_mut(&writer) {
                match &mut matched.proxy {
                    WriterProxy::Reliable(proxy) => {
                        proxy.give_way(now, limit);
                        self.due = self.due.into_iter().chain(proxy.due()).min();
                    }
                    WriterProxy::BestEffort(proxy) => proxy.give_way(limit, out),
                }
            }
            self.account(now, writer);
        }
    }

    fn holdings(&self) -> impl Iterator<Item = (Guid, &Holding)> {
        self.writers.iter().map(|(writer, matched)| (*writer, &matched.holding))
    }
}

/// Keeps a limit that readers share. A reader within its share gives nothing.
pub(crate) fn share(now: u64, limit: usize, readers: &mut [(&mut Reader, &mut Vec<Delivered>)]) {
    let target = limit - limit / FREE_PART;
    let share = target / readers.len().max(1);
    let held = |readers: &[(&mut Reader, &mut Vec<Delivered>)]| -> usize {
        readers.iter().map(|(reader, _)| reader.held).sum()
    };
    if held(readers) <= limit {
        return;
    }
    loop {
        let excess = held(readers).saturating_sub(target);
        let above = readers.iter_mut().filter(|(reader, _)| reader.held > share);
        match above.max_by_key(|(reader, _)| reader.rank(now)) {
            Some((reader, out)) if excess > 0 => {
                reader.make_room(now, share.max(reader.held.saturating_sub(excess)), out);
            }
            _ => break,
        }
    }
}
