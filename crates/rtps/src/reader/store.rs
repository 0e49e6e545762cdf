//! Samples of a writer that wait for others or for their own fragments, within a limit of bytes and samples.

use super::assembly::{ASSEMBLY_OVERHEAD, Assembly, Fit};
use super::content::Content;
use crate::limits::ASSEMBLY_SAMPLES_MAX;
use crate::time::Ticks;
use crate::wire::submessage::{DataFrag, NumberSet};
use std::collections::BTreeMap;

/// Bytes of the maps of a store that has one sample of each kind.
pub(super) const STORE_BYTES: usize = 12 * size_of::<(i64, Content, i64, Assembly)>();

/// Whole samples, and samples in assembly, by number. No number is in both.
#[derive(Debug)]
pub(super) struct Store {
    /// Most bytes that both may take.
    room: usize,
    whole: BTreeMap<i64, Content>,
    assemblies: BTreeMap<i64, Assembly>,
    /// The bytes of both.
    bytes: usize,
}

impl Store {
    pub(super) fn with_room(room: usize) -> Self {
        Self { room, whole: BTreeMap::new(), assemblies: BTreeMap::new(), bytes: 0 }
    }

    /// Puts a whole sample in, unless it is there.
    pub(super) fn put(&mut self, number: i64, content: Content) {
        if !self.whole.contains_key(&number) {
            self.drop_assembly(number);
            self.put_whole(number, content.detached());
        }
    }

    fn put_whole(&mut self, number: i64, content: Content) {
        self.bytes = self.bytes.saturating_add(content.bytes());
        self.whole.insert(number, content);
    }

    /// Puts fragments in. True if one of them is new.
    pub(super) fn put_fragments(&mut self, number: i64, fragment: &DataFrag, timestamp: Option<Ticks>) -> bool {
        if self.whole.contains_key(&number) {
            return false;
        }
        match self.assemblies.get_mut(&number).map(|assembly| assembly.fits(fragment)) {
            Some(Fit::Other) => return false,
            Some(Fit::Same) => {}
            Some(Fit::Replaces) | None => {
                let Some(assembly) = Assembly::new(fragment) else { return false };
                self.drop_assembly(number);
                self.bytes = self.bytes.saturating_add(ASSEMBLY_OVERHEAD);
                self.assemblies.insert(number, assembly);
            }
        }
        let Some(assembly) = self.assemblies.get_mut(&number) else { return false };
        self.bytes = self.bytes.saturating_sub(assembly.bytes());
        let is_new = assembly.add(fragment, timestamp);
        self.bytes = self.bytes.saturating_add(assembly.bytes());
        if assembly.is_complete()
            && let Some(assembly) = self.drop_assembly(number)
        {
            self.put_whole(number, assembly.finish());
        }
        is_new
    }

    /// Takes a whole sample out.
    pub(super) fn take(&mut self, number: i64) -> Option<Content> {
        let content = self.whole.remove(&number)?;
        self.bytes = self.bytes.saturating_sub(content.bytes());
        Some(content)
    }

    pub(super) fn is_whole(&self, number: i64) -> bool {
        self.whole.contains_key(&number)
    }

    /// The missing fragments of a sample in assembly.
    pub(super) fn missing_fragments(&self, number: i64) -> Option<NumberSet> {
        self.assemblies.get(&number).map(Assembly::missing)
    }

    pub(super) fn is_assembling(&self, number: i64) -> bool {
        self.assemblies.contains_key(&number)
    }

    pub(super) fn is_empty(&self) -> bool {
        self.whole.is_empty() && self.assemblies.is_empty()
    }

    /// The highest number in assembly.
    pub(super) fn highest_assembly(&self) -> Option<i64> {
        self.assemblies.keys().next_back().copied()
    }

    /// The first whole sample from this number on.
    pub(super) fn whole_from(&self, number: i64) -> Option<i64> {
        self.whole.range(number..).next().map(|(number, _)| *number)
    }

    /// The first sample above this number, whole or in assembly.
    pub(super) fn above(&self, number: i64) -> Option<i64> {
        let from = number.saturating_add(1);
        let assembly = self.assemblies.range(from..).next().map(|(number, _)| *number);
        self.whole_from(from).into_iter().chain(assembly).min()
    }

    /// Drops everything below this number.
    pub(super) fn drop_below(&mut self, number: i64) {
        while let Some(lowest) = self.lowest().filter(|lowest| *lowest < number) {
            self.drop_one(lowest);
        }
    }

    /// The lowest number in it.
    pub(super) fn lowest(&self) -> Option<i64> {
        self.whole.keys().next().into_iter().chain(self.assemblies.keys().next()).min().copied()
    }

    fn highest(&self) -> Option<i64> {
        self.whole.keys().next_back().into_iter().chain(self.assemblies.keys().next_back()).max().copied()
    }

    /// The bytes that it may take at most.
    pub(super) fn room(&self) -> usize {
        self.room
    }

    /// Drops the highest numbers until the rest fits: a reliable reader needs the lowest first, and can request the others again.
    /// The lowest number that was dropped.
    pub(super) fn shrink_from_top(&mut self, room: usize) -> Option<i64> {
        let mut dropped = None;
        while self.is_above(room) {
            dropped = self.highest();
            self.drop_one(dropped?);
        }
        dropped
    }

    /// Drops the lowest numbers until the rest fits: a best-effort reader wants the newest. The numbers that were dropped.
    pub(super) fn shrink_from_bottom(&mut self, room: usize) -> Vec<i64> {
        let mut dropped = Vec::new();
        while self.is_above(room)
            && let Some(lowest) = self.lowest()
        {
            self.drop_one(lowest);
            dropped.push(lowest);
        }
        dropped
    }

    fn is_above(&self, room: usize) -> bool {
        self.bytes > room || self.whole.len().saturating_add(self.assemblies.len()) > ASSEMBLY_SAMPLES_MAX
    }

    /// Drops everything. The numbers.
    pub(super) fn clear(&mut self) -> Vec<i64> {
        self.bytes = 0;
        self.whole.clear();
        std::mem::take(&mut self.assemblies).into_keys().collect()
    }

    /// How many samples in assembly are below this number.
    pub(super) fn assemblies_below(&self, number: i64) -> u64 {
        u64::try_from(self.assemblies.range(..number).count()).unwrap_or(u64::MAX)
    }

    /// Is half of the room free?
    pub(super) fn has_room(&self) -> bool {
        self.bytes <= self.room / 2
            && self.whole.len().saturating_add(self.assemblies.len()) <= ASSEMBLY_SAMPLES_MAX / 2
    }

    fn drop_one(&mut self, number: i64) {
        self.take(number);
        self.drop_assembly(number);
    }

    fn drop_assembly(&mut self, number: i64) -> Option<Assembly> {
        let assembly = self.assemblies.remove(&number)?;
        self.bytes = self.bytes.saturating_sub(assembly.bytes()).saturating_sub(ASSEMBLY_OVERHEAD);
        Some(assembly)
    }

    /// The bytes of all samples in it.
    pub(super) fn bytes(&self) -> usize {
        self.bytes
    }
}
