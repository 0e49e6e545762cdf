//! The bytes of an action on the ledger, and what a bridge reads of them. The types of goal, feedback and result are the
//! action's own, and no bridge needs them. The id of a goal and its state stand at the same place in every action.
//!
//! ```text
//! a request                                    what the robot says
//! 0              4                12           0              4                     36
//! +--------------+----------------+--------    +--------------+---------------------+--------
//! | 00 01 00 00  | part, 7 zeros  | CDR ...    | 00 01 00 00  | id of the request's | CDR ...
//! +--------------+----------------+--------    |              | transaction         |
//!                                              +--------------+---------------------+--------
//! ```
//! Feedback and status answer no request. There the id is 31 zero bytes and a 1 for feedback, or a 2 for status: no
//! transaction has such a hash. Both heads keep the alignment of all numbers behind them.
//!
//! A sign of life holds the ids of the goals that were accepted and have not ended, 16 bytes each. Of those that the robot's bridge has
//! lost it says the ids, behind a 3 as for feedback.

use bytes::{BufMut, Bytes, BytesMut};
use ledger_base::hash::Hash;
use ledger_base::rejection::Rejection;
use ledger_gate::sample::{CDR_LE, Sample};

use crate::routes::ends::{CALLS_MAX, message_of};

/// Bytes in front of the CDR of a request.
const PART_BYTES: usize = 8;
/// Most goals in a status that are looked at.
const STATES_MAX: usize = 1024;

/// The id of feedback.
pub(in crate::routes) const FEEDBACK: Hash = said(1);
/// The id of a status.
pub(in crate::routes) const STATUS: Hash = said(2);
/// The id of the goals that the robot's bridge has lost.
pub(in crate::routes) const LOST: Hash = said(3);

/// `SendGoal_Response`: not accepted, stamp zero.
pub(in crate::routes) const GOAL_REFUSED: [u8; 12] = [0; 12];
/// `CancelGoal_Response`: `ERROR_REJECTED`, and no goal is being cancelled.
pub(in crate::routes) const CANCEL_REFUSED: [u8; 8] = [1, 0, 0, 0, 0, 0, 0, 0];

/// The id of a goal, which its client has made up.
pub(in crate::routes) type GoalId = [u8; 16];

/// The part of an action that a request is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(in crate::routes) enum Part {
    /// A goal is set.
    Goal = 1,
    /// Goals are cancelled.
    Cancel = 2,
    /// A result is asked for.
    Result = 3,
    /// A sign of life while goals run.
    Alive = 4,
}

impl Part {
    const ALL: [Self; 4] = [Self::Goal, Self::Cancel, Self::Result, Self::Alive];
}

const fn said(what: u8) -> Hash {
    let mut id = [0; 32];
    id[31] = what;
    Hash(id)
}

/// A request on the ledger.
///
/// # Errors
/// As [`Sample::new`].
pub(in crate::routes) fn request_of(part: Part, message: &[u8]) -> Result<Sample, Rejection> {
    let mut body = BytesMut::with_capacity(PART_BYTES.saturating_add(message.len()));
    body.put_u64_le(part as u64);
    body.put_slice(message);
    Sample::new(CDR_LE, &body)
}

/// The part and the message of a request; none if it is no request.
pub(in crate::routes) fn split_request(sample: &Sample) -> Option<(Part, Bytes)> {
    let body = message_of(sample)?;
    let number = u64::from_le_bytes(*body.first_chunk::<PART_BYTES>()?);
    let part = Part::ALL.into_iter().find(|part| *part as u64 == number)?;
    Some((part, body.slice(PART_BYTES..)))
}

/// The goal with whose id a message begins: a request for a goal or a result, or feedback.
pub(in crate::routes) fn goal_of(message: &[u8]) -> Option<GoalId> {
    message.first_chunk().copied()
}

/// The goals of a sign of life, or those that were lost.
pub(in crate::routes) fn ids_in(message: &[u8]) -> impl Iterator<Item = GoalId> {
    message.as_chunks::<16>().0.iter().take(CALLS_MAX).copied()
}

/// The request to cancel one goal: its id, and no time.
pub(in crate::routes) fn cancel_of(goal: GoalId) -> [u8; 24] {
    let mut message = [0; 24];
    message.iter_mut().zip(goal).for_each(|(to, from)| *to = from);
    message
}

/// Does the reply to a goal accept it?
pub(in crate::routes) fn is_accepted(reply: &[u8]) -> bool {
    reply.first().is_some_and(|accepted| *accepted != 0)
}

/// Does the reply to a cancelling, or to a request for a result, say that there is no such goal (`ERROR_UNKNOWN_GOAL_ID`,
/// `STATUS_UNKNOWN`)?
pub(in crate::routes) fn is_of_no_goal(part: Part, reply: &[u8]) -> bool {
    matches!((part, reply.first()), (Part::Cancel, Some(2)) | (Part::Result, Some(0)))
}

/// Does the reply to a cancelling say that there is no such goal, or that it is over (`ERROR_UNKNOWN_GOAL_ID`,
/// `ERROR_GOAL_TERMINATED`)?
pub(in crate::routes) fn is_unknown_or_over(reply: &[u8]) -> bool {
    matches!(reply.first(), Some(2 | 3))
}

/// Has a goal of this state ended (`STATUS_SUCCEEDED`, `STATUS_CANCELED`, `STATUS_ABORTED`)?
pub(in crate::routes) fn is_over(state: u8) -> bool {
    matches!(state, 4..=6)
}

/// The status of a goal that was lost: `STATUS_ABORTED`, and no time.
pub(in crate::routes) fn aborted(goal: GoalId) -> [u8; 29] {
    let mut status = [0; 29];
    let head = 1_u32.to_le_bytes().into_iter().chain(goal);
    status.iter_mut().zip(head).for_each(|(to, from)| *to = from);
    status[28] = 6;
    status
}

/// A goal in a status.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::routes) struct GoalState {
    pub(in crate::routes) goal: GoalId,
    /// When the server has accepted it, by the server's clock (microseconds since 1970).
    pub(in crate::routes) accepted: u64,
    pub(in crate::routes) state: u8,
}

impl GoalState {
    /// Has it ended?
    pub(in crate::routes) fn is_over(&self) -> bool {
        is_over(self.state)
    }
}

/// The goals of a status, `action_msgs/msg/GoalStatusArray`: a length, and for each goal its id, a time, its state.
pub(in crate::routes) fn goals_in(status: &[u8]) -> Vec<GoalState> {
    let mut goals = Vec::new();
    let Some((length, _)) = status.split_first_chunk::<4>() else { return goals };
    let count = usize::try_from(u32::from_le_bytes(*length)).unwrap_or(usize::MAX).min(STATES_MAX);
    let mut at = 4_usize;
    for _ in 0..count {
        let Some(goal) = status.get(at..).and_then(|rest| rest.first_chunk::<16>()) else { break };
        // The time is aligned to four bytes; the state is one.
        let time = (at + 16).next_multiple_of(4);
        let Some((accepted, state)) = status.get(time..).and_then(time_and_state) else { break };
        goals.push(GoalState { goal: *goal, accepted, state });
        at = time + 9;
    }
    goals
}

/// A `builtin_interfaces/msg/Time` in microseconds, and the byte behind it.
fn time_and_state(bytes: &[u8]) -> Option<(u64, u8)> {
    let (seconds, rest) = bytes.split_first_chunk::<4>()?;
    let (nanoseconds, rest) = rest.split_first_chunk::<4>()?;
    let seconds = u64::try_from(i32::from_le_bytes(*seconds)).unwrap_or(0);
    let micros = seconds * 1_000_000 + u64::from(u32::from_le_bytes(*nanoseconds) / 1000);
    Some((micros, *rest.first()?))
}

#[cfg(test)]
#[expect(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]
mod tests {
    use super::*;
    use ledger_gate::sample::CDR_BE;

    #[test]
    fn the_format_of_a_request_does_not_change() {
        for (number, part) in (1..).zip(Part::ALL) {
            let sample = request_of(part, b"cdr").unwrap();
            assert_eq!(sample.wire()[..], [&[0, 1, 0, 0, number, 0, 0, 0, 0, 0, 0, 0][..], b"cdr"].concat());
            assert_eq!(split_request(&sample).unwrap(), (part, Bytes::from_static(b"cdr")));
        }
    }

    #[test]
    fn what_is_too_short_or_of_no_known_part_or_of_another_byte_order_is_no_request() {
        for length in 0..PART_BYTES {
            assert_eq!(split_request(&Sample::new(CDR_LE, &vec![1; length]).unwrap()), None);
        }
        for head in [[0; 8], [5, 0, 0, 0, 0, 0, 0, 0], [1, 0, 0, 0, 0, 0, 0, 1]] {
            assert_eq!(split_request(&Sample::new(CDR_LE, &head).unwrap()), None, "{head:?}");
        }
        assert_eq!(split_request(&Sample::new(CDR_BE, &[1, 0, 0, 0, 0, 0, 0, 0]).unwrap()), None);
    }

    #[test]
    fn the_goals_of_a_status_are_read_however_it_is_cut_off() {
        let mut status = 3_u32.to_le_bytes().to_vec();
        for (goal, state) in [(7_u8, 4_u8), (8, 2), (9, 5)] {
            status.extend([goal; 16]);
            status.resize(status.len().next_multiple_of(4), 0);
            status.extend(i32::from(goal).to_le_bytes());
            status.extend(5_999_u32.to_le_bytes());
            status.push(state);
        }
        let of = |goal: u8, state| GoalState { goal: [goal; 16], accepted: u64::from(goal) * 1_000_000 + 5, state };
        let all = [of(7, 4), of(8, 2), of(9, 5)];
        assert_eq!(goals_in(&status), all);
        assert_eq!(all.map(|stated| stated.is_over()), [true, false, true]);
        for length in 0..status.len() {
            let cut = goals_in(&status[..length]);
            assert!(cut.len() < 3 && all.starts_with(&cut), "{length}");
        }
        status[..4].copy_from_slice(&u32::MAX.to_le_bytes());
        assert_eq!(goals_in(&status), all, "a length that lies");
    }

    #[test]
    fn a_reply_says_that_there_is_no_such_goal_by_the_code_of_its_service() {
        let says = |part| (0..=6).filter(move |code| is_of_no_goal(part, &[*code])).collect::<Vec<u8>>();
        assert_eq!(Part::ALL.map(says), [vec![], vec![2], vec![0], vec![]]);
        assert!(!is_of_no_goal(Part::Result, &[]));
    }

    #[test]
    fn a_lost_goal_is_over_in_its_status() {
        assert_eq!(goals_in(&aborted([7; 16])), [GoalState { goal: [7; 16], accepted: 0, state: 6 }]);
        let ids: Vec<_> = ids_in(&[[7_u8; 16], [8; 16]].concat()).collect();
        assert_eq!(ids, [[7; 16], [8; 16]]);
        assert_eq!(ids_in(&[1_u8; 15]).count(), 0);
        assert_eq!(ids_in(&[1_u8; 17 * CALLS_MAX]).count(), CALLS_MAX);
    }

    #[test]
    fn a_time_before_1970_is_none() {
        let bytes = [(-1_i32).to_le_bytes(), 7_000_u32.to_le_bytes()].concat();
        assert_eq!(time_and_state(&[&bytes[..], &[2]].concat()), Some((7, 2)));
        assert_eq!(time_and_state(&bytes), None);
    }

    #[test]
    fn one_goal_is_cancelled_by_its_id_alone() {
        assert_eq!(cancel_of([7; 16])[..], [[7; 16].as_slice(), &[0; 8]].concat());
        assert_eq!(goal_of(&cancel_of([7; 16])), Some([7; 16]));
    }
}
