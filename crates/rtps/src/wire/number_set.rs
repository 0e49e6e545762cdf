//! Sets of sequence numbers and of fragment numbers (§9.4.2.6, §9.4.2.8).

use crate::limits::SET_BITS_MAX;
use crate::wire::submessage::NumberSet;

impl NumberSet {
    /// An empty set that begins at `base`.
    pub fn new(base: i64) -> Self {
        Self { base, bits: 0, bitmap: [0; 8] }
    }

    /// Adds a number. False, and no change, if it is below the base or more than 255 above it.
    pub fn insert(&mut self, number: i64) -> bool {
        let Some(bit) = self.bit_of(number) else { return false };
        let Some(word) = self.bitmap.get_mut(bit as usize / 32) else { return false };
        *word |= 1 << (31 - bit % 32);
        self.bits = self.bits.max(bit + 1);
        true
    }

    /// Is this number in the set?
    pub fn contains(&self, number: i64) -> bool {
        self.bit_of(number).is_some_and(|bit| self.has_bit(bit))
    }

    /// The numbers in the set, ascending.
    pub fn iter(&self) -> impl Iterator<Item = i64> + '_ {
        (0..self.bits.min(SET_BITS_MAX))
            .filter(|bit| self.has_bit(*bit))
            .filter_map(|bit| self.base.checked_add(bit.into()))
    }

    /// The part of the set from this number on.
    pub fn tail(&self, first: i64) -> Self {
        let mut tail = Self::new(first.max(self.base));
        for number in self.iter().filter(|number| *number >= first) {
            tail.insert(number);
        }
        tail
    }

    /// Is no number in the set?
    pub fn is_empty(&self) -> bool {
        self.iter().next().is_none()
    }

    /// Is it a set of sequence numbers? The standard demands a base of 1; Fast DDS's first ACKNACK to a writer has a base of 0.
    pub fn is_valid_for_sequences(&self) -> bool {
        self.base >= 0 && self.ends_at_or_below(i64::MAX)
    }

    /// Is it a set of fragment numbers?
    pub fn is_valid_for_fragments(&self) -> bool {
        self.base >= 1 && self.base <= u32::MAX.into() && self.ends_at_or_below(u32::MAX.into())
    }

    fn ends_at_or_below(&self, last: i64) -> bool {
        self.bits <= SET_BITS_MAX && self.base.checked_add(i64::from(self.bits) - 1).is_some_and(|end| end <= last)
    }

    fn bit_of(&self, number: i64) -> Option<u32> {
        let bit = u32::try_from(number.checked_sub(self.base)?).ok()?;
        (bit < SET_BITS_MAX).then_some(bit)
    }

    fn has_bit(&self, bit: u32) -> bool {
        bit < self.bits && self.bitmap.get(bit as usize / 32).is_some_and(|word| word & 1 << (31 - bit % 32) != 0)
    }
}

/// How many words of the bitmap are on the wire.
pub(crate) fn bitmap_words(bits: u32) -> usize {
    bits.min(SET_BITS_MAX).div_ceil(32) as usize
}

/// The bitmap without the bits behind its last one.
pub(crate) fn masked(mut bitmap: [u32; 8], bits: u32) -> [u32; 8] {
    for (start, word) in (0..).step_by(32).zip(&mut bitmap) {
        let used = bits.saturating_sub(start).min(32);
        *word &= u32::MAX.checked_shl(32 - used).unwrap_or(0);
    }
    bitmap
}

#[cfg(test)]
mod tests {
    use super::*;

    fn numbers(set: &NumberSet) -> Vec<i64> {
        set.iter().collect()
    }

    #[test]
    fn a_set_holds_256_numbers_from_its_base_on() {
        let mut set = NumberSet::new(5);
        assert!(set.is_empty());
        assert_eq!([4, 5, 260, 261].map(|number| set.insert(number)), [false, true, true, false]);
        assert_eq!((numbers(&set), set.bits), (vec![5, 260], 256));
        assert_eq!([4, 5, 6, 260, 261].map(|number| set.contains(number)), [false, true, false, true, false]);
        assert!(set.is_valid_for_sequences() && set.is_valid_for_fragments());
    }

    #[test]
    fn bits_are_counted_from_the_most_significant_one() {
        let mut set = NumberSet::new(1);
        set.insert(1);
        set.insert(33);
        assert_eq!(set.bitmap, [1 << 31, 1 << 31, 0, 0, 0, 0, 0, 0]);
    }

    #[test]
    fn nothing_overflows_at_the_ends_of_the_numbers() {
        for base in [i64::MIN, -1, 0, i64::MAX - 1, i64::MAX] {
            let mut set = NumberSet::new(base);
            for number in [i64::MIN, -1, 0, 1, i64::MAX - 1, i64::MAX] {
                assert_eq!(set.insert(number), set.contains(number));
            }
            assert_eq!(set.is_valid_for_sequences(), base >= 0, "{base}");
            set.bits = 256;
            assert_eq!(set.is_valid_for_sequences(), base == 0, "{base}");
            assert!(set.iter().all(|number| number >= base));
        }
    }

    #[test]
    fn sets_beyond_the_range_of_their_numbers_are_invalid() {
        let set = |base, bits| NumberSet { base, bits, bitmap: [u32::MAX; 8] };
        assert!(set(0, 0).is_valid_for_sequences() && !set(0, 0).is_valid_for_fragments());
        assert!(!set(-1, 2).is_valid_for_sequences());
        assert!(!set(1, 257).is_valid_for_sequences() && !set(1, u32::MAX).is_valid_for_fragments());
        let last = i64::from(u32::MAX);
        assert!(set(last, 1).is_valid_for_fragments() && !set(last, 2).is_valid_for_fragments());
        assert!(set(i64::MAX, 1).is_valid_for_sequences() && !set(i64::MAX, 2).is_valid_for_sequences());
        assert_eq!(set(1, u32::MAX).iter().count(), 256);
    }

    #[test]
    fn bits_behind_the_last_one_are_cleared() {
        assert_eq!(masked([u32::MAX; 8], 33), [u32::MAX, 1 << 31, 0, 0, 0, 0, 0, 0]);
        assert_eq!(masked([u32::MAX; 8], 0), [0; 8]);
        assert_eq!(masked([u32::MAX; 8], 256), [u32::MAX; 8]);
    }
}
