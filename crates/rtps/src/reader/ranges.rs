//! Sets of sequence numbers as ranges, so that a range of any length costs the same.

/// Most ranges of numbers that were delivered; below them everything counts as delivered.
const DELIVERED_RANGES_MAX: usize = 8;

/// Disjoint ranges, in order. Both ends belong to a range.
#[derive(Debug, Default)]
pub(super) struct NumberRanges {
    ranges: Vec<(i64, i64)>,
}

impl NumberRanges {
    /// Adds a range. Ranges that overlap or touch become one.
    pub(super) fn insert(&mut self, from: i64, to: i64) {
        if from > to {
            return;
        }
        let begin = self.ranges.partition_point(|(_, end)| end.saturating_add(1) < from);
        let end = self.ranges.partition_point(|(start, _)| *start <= to.saturating_add(1)).max(begin);
        let merged = self.ranges.get(begin..end).unwrap_or_default();
        let from = merged.first().map_or(from, |(start, _)| from.min(*start));
        let to = merged.last().map_or(to, |(_, end)| to.max(*end));
        self.ranges.splice(begin..end, [(from, to)]);
    }

    /// Adds a range without the numbers that another set has.
    pub(super) fn insert_without(&mut self, from: i64, to: i64, other: &Self) {
        let mut rest = from;
        for (start, end) in other.ranges.iter().filter(|(start, end)| *end >= from && *start <= to) {
            self.insert(rest, start.saturating_sub(1));
            rest = end.saturating_add(1);
        }
        self.insert(rest, to);
    }

    /// The end of the range that has this number.
    pub(super) fn end_of(&self, number: i64) -> Option<i64> {
        let index = self.ranges.partition_point(|(_, end)| *end < number);
        self.ranges.get(index).filter(|(start, _)| *start <= number).map(|(_, end)| *end)
    }

    /// The start of the first range above this number.
    pub(super) fn start_above(&self, number: i64) -> Option<i64> {
        self.ranges.get(self.ranges.partition_point(|(start, _)| *start <= number)).map(|(start, _)| *start)
    }

    /// Forgets ranges that are wholly below this number.
    pub(super) fn forget_below(&mut self, number: i64) {
        self.ranges.drain(..self.ranges.partition_point(|(_, end)| *end < number));
    }

    /// How many numbers from `from` to `to` are in it.
    pub(super) fn count_within(&self, from: i64, to: i64) -> u64 {
        let overlap = |(start, end): &(i64, i64)| (*end).min(to).saturating_sub((*start).max(from)).saturating_add(1);
        self.ranges.iter().map(overlap).filter_map(|count| u64::try_from(count).ok()).fold(0, u64::saturating_add)
    }

    /// Forgets the numbers up to this one.
    pub(super) fn forget_until(&mut self, number: i64) {
        self.forget_below(number.saturating_add(1));
        if let Some((start, _)) = self.ranges.first_mut() {
            *start = (*start).max(number.saturating_add(1));
        }
    }

    /// Forgets the range with the highest numbers.
    pub(super) fn forget_last(&mut self) {
        self.ranges.pop();
    }

    /// Forgets the range with the lowest numbers.
    pub(super) fn forget_first(&mut self) {
        self.ranges.drain(..self.ranges.len().min(1));
    }

    pub(super) fn clear(&mut self) {
        self.ranges.clear();
    }

    pub(super) fn len(&self) -> usize {
        self.ranges.len()
    }
}

/// The numbers that were delivered, so that none is delivered twice, also after numbers went back and forth. Of many ranges the
/// lowest are forgotten: everything up to them counts as delivered.
#[derive(Debug, Default)]
pub(super) struct DeliveredNumbers {
    floor: i64,
    ranges: NumberRanges,
}

impl DeliveredNumbers {
    pub(super) fn insert(&mut self, number: i64) {
        self.ranges.insert(number, number);
        if self.ranges.len() > DELIVERED_RANGES_MAX
            && let Some((_, end)) = self.ranges.ranges.first().copied()
        {
            self.floor = self.floor.max(end);
            self.ranges.forget_below(end.saturating_add(1));
        }
    }

    pub(super) fn contains(&self, number: i64) -> bool {
        self.end_of(number).is_some()
    }

    /// The end of the range that has this number.
    pub(super) fn end_of(&self, number: i64) -> Option<i64> {
        self.ranges.end_of(number).or_else(|| (number <= self.floor).then_some(self.floor))
    }

    /// The start of the first range above this number.
    pub(super) fn start_above(&self, number: i64) -> Option<i64> {
        self.ranges.start_above(number)
    }

    /// How many numbers from `from` to `to` are in it.
    pub(super) fn count_within(&self, from: i64, to: i64) -> u64 {
        let below = self.floor.min(to).saturating_sub(from).saturating_add(1);
        let above = self.ranges.count_within(from.max(self.floor.saturating_add(1)), to);
        u64::try_from(below).unwrap_or(0).saturating_add(above)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_that_overlap_or_touch_become_one() {
        let mut ranges = NumberRanges::default();
        for (from, to) in [(10, 20), (30, 40), (50, 60), (8, 9), (41, 49), (5, 4), (100, i64::MAX), (i64::MIN, 0)] {
            ranges.insert(from, to);
        }
        assert_eq!(ranges.ranges, [(i64::MIN, 0), (8, 20), (30, 60), (100, i64::MAX)]);
        assert_eq!((ranges.end_of(8), ranges.end_of(21), ranges.end_of(60)), (Some(20), None, Some(60)));
        assert_eq!((ranges.start_above(8), ranges.start_above(100)), (Some(30), None));
        assert_eq!((ranges.count_within(15, 40), ranges.count_within(21, 29), ranges.count_within(9, 8)), (17, 0, 0));
        ranges.forget_below(60);
        assert_eq!(ranges.ranges, [(30, 60), (100, i64::MAX)]);
        ranges.insert(1, 1000);
        assert_eq!(ranges.ranges, [(1, i64::MAX)]);
    }

    #[test]
    fn a_range_is_added_without_the_numbers_of_another_set_and_forgotten_up_to_a_number() {
        let (mut ranges, mut other) = (NumberRanges::default(), NumberRanges::default());
        for (from, to) in [(1, 3), (5, 6), (9, 20)] {
            other.insert(from, to);
        }
        ranges.insert_without(2, 12, &other);
        assert_eq!(ranges.ranges, [(4, 4), (7, 8)]);
        ranges.forget_until(7);
        assert_eq!(ranges.ranges, [(8, 8)]);
    }

    #[test]
    fn of_many_delivered_ranges_the_lowest_count_as_one() {
        let mut delivered = DeliveredNumbers::default();
        (1..100).for_each(|number| delivered.insert(2 * number));
        assert_eq!(delivered.ranges.len(), DELIVERED_RANGES_MAX);
        assert_eq!(
            [1, 101, 182, 183, 197, 198, 199].map(|number| delivered.contains(number)),
            [true, true, true, false, false, true, false]
        );
        assert_eq!((delivered.count_within(181, 186), delivered.count_within(1, 182)), (4, 182));
    }
}
