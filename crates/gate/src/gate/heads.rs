//! The blocks that the node has reported to this gate, and when each arrived, by its own steady clock.
//!
//! Blocks may come late, and commands behind them just as late. The gate's own questions show by how much: the block with its question
//! was made after it asked. So the time from a question to its block counts as age, too, and so does a silence of the node.

use ledger::transaction::{KNOWN_HASH_BYTES, KnownBlock};
use std::collections::VecDeque;

/// Most blocks that a gate remembers; the oldest make room.
pub(super) const HEADS_MAX: usize = 8192;
/// Most answers of the voters that bound when a block was known. A guard asks at most twenty times a second, so they reach back for
/// three seconds: longer than a command is on its way.
const ANSWERS_MAX: usize = 64;
/// A node that sends nothing for so long is silent, microseconds. Its heartbeats come four times a second.
const SILENCE_US: u64 = 500_000;

/// The blocks that the gate knows, without a gap, in order.
#[derive(Debug, Default)]
pub(super) struct Heads {
    /// The height of the first one.
    first: u64,
    known: VecDeque<Head>,
    /// The last answers of the voters.
    answers: VecDeque<Answer>,
    /// The lowest height of a block with a question of this gate. Blocks below may be from before the gate was opened, whenever they
    /// came: a node that lags brings them late.
    asked_in: Option<u64>,
    /// From the last question to the moment at which its block was known, microseconds.
    round_trip: u64,
    /// When the node last sent something, by the steady clock (microseconds).
    heard: Option<u64>,
    /// The node was silent, and no question that was asked since is answered.
    silence: Option<Silence>,
}

/// A block that the gate knows.
#[derive(Clone, Copy, Debug)]
struct Head {
    hash: [u8; KNOWN_HASH_BYTES],
    /// When the gate could have known it at the latest, by the steady clock (microseconds).
    since: u64,
    /// When it arrived, by the steady clock (microseconds).
    arrived: u64,
}

/// An answer of the voters. Times are by the steady clock, microseconds.
#[derive(Clone, Copy, Debug)]
struct Answer {
    /// The height of the block with the question.
    height: u64,
    asked: u64,
    since: u64,
}

/// By the steady clock, microseconds.
#[derive(Clone, Copy, Debug)]
struct Silence {
    since: u64,
    until: u64,
}

/// The result of looking up the block that a message names. Times are by the steady clock, microseconds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Found {
    /// The gate knows the block.
    Known {
        /// When the message was signed, if the signer knew the block as soon as the gate did.
        signed: u64,
        /// How old the message is. It has both halves: the time since it was signed as above, and the time for which the gate has known
        /// the next block. A signer names the newest one, so the shorter of them is the age of a message that nothing has delayed.
        age: u64,
        /// The age that the message has at most, whatever has delayed it: the time since the last question before the block.
        age_max: u64,
    },
    /// It is older than all that the gate knows, or may be from before the gate was opened.
    Older,
    /// The gate knows another block of that height, or none as high.
    Unknown,
}

impl Heads {
    /// Adds blocks up to a height: the first bytes of their hashes, one after the other. None is a heartbeat. Where the gate asks
    /// often, blocks that arrive after a silence count as known since before it.
    pub(super) fn reported(&mut self, height: u64, hashes: &[u8], asks_often: bool, now: u64) {
        let before = self.heard.replace(now).unwrap_or(now);
        if asks_often && now.saturating_sub(before) >= SILENCE_US {
            let since = self.silence.map_or(before, |silence| silence.since);
            self.silence = Some(Silence { since, until: now });
        }
        let (hashes, _) = hashes.as_chunks::<KNOWN_HASH_BYTES>();
        let Some(from) = u64::try_from(hashes.len()).ok().and_then(|count| height.checked_add(1)?.checked_sub(count))
        else {
            return;
        };
        let since = self.silence.map_or(now, |silence| silence.since);
        for (height, hash) in (from..).zip(hashes) {
            self.add(height, *hash, (since, now));
        }
    }

    /// Is a question to be asked, because the node was silent?
    pub(super) fn was_silent(&self) -> bool {
        self.silence.is_some()
    }

    fn add(&mut self, height: u64, hash: [u8; KNOWN_HASH_BYTES], (since, arrived): (u64, u64)) {
        if self.known.is_empty() || height > self.end() {
            self.known.clear();
            self.first = height;
        }
        let Some(place) = height.checked_sub(self.first).and_then(|place| usize::try_from(place).ok()) else { return };
        if self.known.get(place).is_some_and(|known| known.hash == hash) {
            return;
        }
        // The node before it had another block there, and all behind that one: one of them lies, and this one may not.
        self.known.truncate(place);
        let answered = self.answer_above(height.saturating_sub(1));
        let since = answered.map_or(since, |answered| answered.min(since));
        self.known.push_back(Head { hash, since, arrived });
        if self.known.len() > HEADS_MAX {
            self.known.pop_front();
            self.first = self.first.saturating_add(1);
        }
    }

    /// The voters have signed the block of that height with a question that was asked at that moment. A block that was
    /// reported before has a lower height; another one is made up. Where the gate asks often, blocks come as late as that one.
    pub(super) fn answered(&mut self, height: u64, asked: u64, asks_often: bool, now: u64) {
        let real = |(at, head): (u64, &Head)| at < height || head.arrived > asked;
        let kept = (self.first..).zip(&self.known).take_while(|(at, head)| real((*at, head))).count();
        self.known.truncate(kept);
        let known = self.since(height).map_or(now, |head| head.since);
        self.round_trip = if asks_often { known.saturating_sub(asked) } else { 0 };
        self.silence = self.silence.filter(|silence| asked < silence.until);
        self.asked_in = Some(self.asked_in.map_or(height, |lowest| lowest.min(height)));
        self.answers.push_back(Answer { height, asked, since: now });
        if self.answers.len() > ANSWERS_MAX {
            self.answers.pop_front();
        }
    }

    /// The age of a message that names this block.
    pub(super) fn find(&self, named: &KnownBlock, now: u64) -> Found {
        if self.known.is_empty() || named.height < self.first.max(self.asked_in.unwrap_or_default()) {
            return Found::Older;
        }
        match self.since(named.height) {
            Some(Head { hash, since, .. }) if hash[..] == named.hash[..] => {
                let signed = since.saturating_add(named.known_us).min(now);
                let next = named.height.checked_add(1).and_then(|next| self.since(next));
                let next = next.map(|next| next.since).into_iter().chain(self.answer_above(named.height)).min();
                // The block may be older than the gate knows, but not older than a question before it.
                let first =
                    self.answers.iter().filter(|answer| answer.height <= named.height).map(|answer| answer.asked);
                let first = first.max().map_or(0, |asked| asked.saturating_add(named.known_us).min(now));
                let late = |moment: u64| moment.saturating_sub(self.round_trip);
                let latest = late(signed).max(first).max(next.map_or(now, late));
                Found::Known { signed, age: now.saturating_sub(latest), age_max: now.saturating_sub(first) }
            }
            _ => Found::Unknown,
        }
    }

    fn since(&self, height: u64) -> Option<Head> {
        let place = usize::try_from(height.checked_sub(self.first)?).ok()?;
        self.known.get(place).copied()
    }

    /// When the gate learnt of the first remembered answer in a later block than this.
    fn answer_above(&self, height: u64) -> Option<u64> {
        self.answers.iter().find(|answer| answer.height > height).map(|answer| answer.since)
    }

    /// The height behind the last one.
    fn end(&self) -> u64 {
        self.first.saturating_add(self.known.len() as u64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytes::Bytes;

    const MS: u64 = 1_000;

    /// The hash of the block at a height, on a branch.
    fn hash(branch: u8, height: u64) -> [u8; KNOWN_HASH_BYTES] {
        [&[branch][..], &height.to_be_bytes()[1..]].concat().try_into().unwrap_or_default()
    }

    /// A gate that has asked its first question long ago.
    fn asked_before() -> Heads {
        Heads { asked_in: Some(1), ..Heads::default() }
    }

    fn tell(heads: &mut Heads, (branch, from, to): (u8, u64, u64), now: u64) {
        let hashes: Vec<u8> = (from..=to).flat_map(|height| hash(branch, height)).collect();
        heads.reported(to, &hashes, true, now);
    }

    fn named(branch: u8, height: u64, known_us: u64) -> KnownBlock {
        KnownBlock { height, hash: Bytes::copy_from_slice(&hash(branch, height)), known_us }
    }

    fn age(heads: &Heads, named: &KnownBlock, now: u64) -> Option<u64> {
        match heads.find(named, now) {
            Found::Known { age, .. } => Some(age),
            _ => None,
        }
    }

    #[test]
    fn the_age_is_the_time_since_the_signature_by_the_block_that_both_know() {
        let mut heads = Heads::default();
        tell(&mut heads, (1, 5, 6), 100 * MS);
        tell(&mut heads, (1, 7, 9), 200 * MS);
        assert_eq!(age(&heads, &named(1, 6, 90 * MS), 250 * MS), Some(50 * MS), "by the signer's 90 ms");
        assert_eq!(age(&heads, &named(1, 9, 30 * MS), 250 * MS), Some(0), "nobody has seen a later block");
        let found = Found::Known { signed: 230 * MS, age: 0, age_max: 250 * MS };
        assert_eq!(heads.find(&named(1, 9, 30 * MS), 250 * MS), found);
        tell(&mut heads, (1, 10, 10), 260 * MS);
        assert_eq!(age(&heads, &named(1, 9, 30 * MS), 400 * MS), Some(140 * MS), "the next block is known for 140 ms");
        assert_eq!(age(&heads, &named(1, 9, u64::MAX), 400 * MS), Some(0), "never from the future");
    }

    #[test]
    fn a_block_of_another_branch_or_beyond_all_is_unknown_and_one_from_before_is_older() {
        let mut heads = Heads::default();
        assert_eq!(heads.find(&named(1, 5, 0), 0), Found::Older, "nothing is known");
        tell(&mut heads, (1, 5, 6), 0);
        assert_eq!(heads.find(&named(2, 5, 0), 1), Found::Unknown);
        assert_eq!(heads.find(&named(1, 7, 0), 1), Found::Unknown);
        assert_eq!(heads.find(&named(1, 4, 0), 1), Found::Older);
    }

    #[test]
    fn a_repeated_block_keeps_its_first_time_and_a_gap_starts_again() {
        let mut heads = Heads::default();
        tell(&mut heads, (1, 5, 6), 0);
        tell(&mut heads, (1, 5, 7), 9 * MS);
        assert_eq!(heads.find(&named(1, 6, 0), 10 * MS), Found::Known { signed: 0, age: MS, age_max: 10 * MS });
        tell(&mut heads, (1, 20, 20), 10 * MS);
        assert_eq!((heads.first, heads.known.len()), (20, 1));
        tell(&mut heads, (1, 4, 4), 11 * MS);
        assert_eq!((heads.first, heads.known.len()), (20, 1), "older than all that are stored");
    }

    #[test]
    fn blocks_that_a_node_has_made_up_make_room_for_those_of_another_node_and_for_what_voters_have_signed() {
        let mut heads = Heads::default();
        tell(&mut heads, (2, 5, 9), 0);
        tell(&mut heads, (1, 7, 7), 5 * MS);
        assert_eq!(heads.find(&named(2, 8, 0), 6 * MS), Found::Unknown, "it was behind another block");
        let found = Found::Known { signed: 5 * MS, age: 0, age_max: 6 * MS };
        assert_eq!(heads.find(&named(1, 7, 0), 6 * MS), found);
        // Asked at 6 ms, ordered in block 7: no block 7 or 8 was there before.
        tell(&mut heads, (1, 8, 8), 6 * MS);
        heads.answered(7, 6 * MS, true, 10 * MS);
        assert_eq!((heads.first, heads.known.len()), (5, 2));
    }

    #[test]
    fn a_node_that_holds_blocks_back_makes_no_message_younger_than_the_answers_of_the_voters_say() {
        let mut heads = asked_before();
        tell(&mut heads, (1, 5, 5), 0);
        heads.answered(8, 50 * MS, true, 100 * MS);
        tell(&mut heads, (1, 6, 9), 400 * MS);
        assert_eq!(
            age(&heads, &named(1, 7, 10 * MS), 400 * MS),
            Some(340 * MS),
            "known since 100 ms, made 50 ms before"
        );
        assert_eq!(age(&heads, &named(1, 8, 10 * MS), 400 * MS), Some(50 * MS), "only the next block is new");
    }

    #[test]
    fn blocks_that_come_late_are_as_much_older_as_the_block_of_the_last_question_came_late() {
        let mut heads = Heads::default();
        tell(&mut heads, (1, 5, 8), 300 * MS);
        heads.answered(8, 100 * MS, true, 320 * MS);
        tell(&mut heads, (1, 9, 10), 400 * MS);
        assert_eq!(age(&heads, &named(1, 9, 10 * MS), 450 * MS), Some(240 * MS), "40 ms, and 200 ms of the question");
        assert_eq!(age(&heads, &named(1, 9, 300 * MS), 450 * MS), Some(50 * MS), "not older than the question");
        tell(&mut heads, (1, 11, 11), 460 * MS);
        heads.answered(11, 455 * MS, true, 470 * MS);
        assert_eq!(age(&heads, &named(1, 10, 10 * MS), 480 * MS), Some(25 * MS), "the link is fast again");
    }

    #[test]
    fn no_message_is_older_than_the_last_question_before_the_block_that_it_names() {
        let age_max = |heads: &Heads, height, known_us, now| match heads.find(&named(1, height, known_us), now) {
            Found::Known { age_max, .. } => Some(age_max),
            _ => None,
        };
        let mut heads = asked_before();
        tell(&mut heads, (1, 5, 9), 100 * MS);
        heads.answered(8, 80 * MS, true, 120 * MS);
        heads.answered(9, 90 * MS, true, 130 * MS);
        assert_eq!(age_max(&heads, 7, 10 * MS, 150 * MS), Some(150 * MS), "no question is from before block 7");
        assert_eq!(age_max(&heads, 8, 10 * MS, 150 * MS), Some(60 * MS));
        assert_eq!(age_max(&heads, 9, 10 * MS, 150 * MS), Some(50 * MS));
    }

    #[test]
    fn what_comes_behind_a_silence_is_known_since_before_it_until_a_later_question_is_answered() {
        let mut heads = asked_before();
        tell(&mut heads, (1, 5, 5), 0);
        tell(&mut heads, (1, 6, 7), 700 * MS);
        tell(&mut heads, (1, 8, 8), 701 * MS);
        assert!(heads.was_silent());
        assert_eq!(age(&heads, &named(1, 7, 10 * MS), 710 * MS), Some(700 * MS));
        heads.answered(9, 702 * MS, true, 712 * MS);
        tell(&mut heads, (1, 9, 10), 713 * MS);
        assert!(!heads.was_silent());
        assert_eq!(age(&heads, &named(1, 9, 0), 714 * MS), Some(11 * MS));
        let mut feed = asked_before();
        feed.reported(5, &hash(1, 5), false, 0);
        feed.reported(6, &hash(1, 6), false, 700 * MS);
        feed.answered(7, 0, false, 900 * MS);
        assert!(!feed.was_silent(), "a feed asks nobody");
        assert_eq!(age(&feed, &named(1, 6, 10 * MS), 950 * MS), Some(50 * MS), "nor does a slow answer count for ever");
    }

    #[test]
    fn blocks_that_arrive_after_a_question_are_not_made_up_though_a_silence_makes_them_older() {
        let mut heads = Heads::default();
        tell(&mut heads, (1, 5, 5), 0);
        tell(&mut heads, (1, 6, 9), 700 * MS);
        heads.answered(7, 400 * MS, true, 710 * MS);
        assert_eq!((heads.first, heads.known.len()), (5, 5));
    }

    #[test]
    fn no_more_blocks_are_remembered_than_there_is_room_for() {
        let mut heads = Heads::default();
        (1..=HEADS_MAX as u64 + 3).for_each(|height| tell(&mut heads, (1, height, height), height));
        assert_eq!((heads.first, heads.known.len()), (4, HEADS_MAX));
        heads.reported(1, &[0; 64], true, 0);
        heads.reported(u64::MAX, &[0; 8], true, 0);
    }
}
