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

use bytes::{BufMut, Bytes, BytesMut};
use ledger_gate::sample::{CDR_LE, Sample};
use ledger_hash::Hash;
use ledger_rejection::Rejection;

use super::super::calls::message_of;

/// Bytes in front of the CDR of a request.
const PART_BYTES: usize = 8;
/// Most goals in a status that are looked at.
const STATES_MAX: usize = 1024;

/// The id of feedback.
pub(in crate::route) const FEEDBACK: Hash = said(1);
/// The id of a status.
pub(in crate::route) const STATUS: Hash = said(2);

/// `SendGoal_Response`: not accepted, stamp zero.
pub(in crate::route) const GOAL_REFUSED: [u8; 12] = [0; 12];
/// `CancelGoal_Response`: `ERROR_REJECTED`, and no goal is being cancelled.
pub(in crate::route) const CANCEL_REFUSED: [u8; 8] = [1, 0, 0, 0, 0, 0, 0, 0];

/// The id of a goal, which its client has made up.
pub(in crate::route) type GoalId = [u8; 16];

/// The part of an action that a request is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(in crate::route) enum Part {
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
pub(in crate::route) fn request_of(part: Part, message: &[u8]) -> Result<Sample, Rejection> {
    let mut body = BytesMut::with_capacity(PART_BYTES.saturating_add(message.len()));
    body.put_u64_le(part as u64);
    body.put_slice(message);
    Sample::new(CDR_LE, &body)
}

/// The part and the message of a request; none if it is no request.
pub(in crate::route) fn split_request(sample: &Sample) -> Option<(Part, Bytes)> {
    let body = message_of(sample)?;
    let number = u64::from_le_bytes(*body.first_chunk::<PART_BYTES>()?);
    let part = Part::ALL.into_iter().find(|part| *part as u64 == number)?;
    Some((part, body.slice(PART_BYTES..)))
}

/// The goal with whose id a message begins: a request for a goal or a result, or feedback.
pub(in crate::route) fn goal_of(message: &[u8]) -> Option<GoalId> {
    message.first_chunk().copied()
}

/// The request to cancel one goal: its id, and no time.
pub(in crate::route) fn cancel_of(goal: GoalId) -> [u8; 24] {
    let mut message = [0; 24];
    message.iter_mut().zip(goal).for_each(|(to, from)| *to = from);
    message
}

/// Does the reply to a goal accept it?
pub(in crate::route) fn is_accepted(reply: &[u8]) -> bool {
    reply.first().is_some_and(|accepted| *accepted != 0)
}

/// Does the reply to a cancelling say that there is no such goal, or that it is over (`ERROR_UNKNOWN_GOAL_ID`,
/// `ERROR_GOAL_TERMINATED`)?
pub(in crate::route) fn is_unknown_or_over(reply: &[u8]) -> bool {
    matches!(reply.first(), Some(2 | 3))
}

/// Has a goal of this state ended (`STATUS_SUCCEEDED`, `STATUS_CANCELED`, `STATUS_ABORTED`)?
pub(in crate::route) fn is_over(state: u8) -> bool {
    matches!(state, 4..=6)
}

/// The goals that have ended by a status, `action_msgs/msg/GoalStatusArray`: a length, and for each goal its id, a time, its state.
pub(in crate::route) fn over_in(status: &[u8]) -> Vec<GoalId> {
    let mut over = Vec::new();
    let Some((length, _)) = status.split_first_chunk::<4>() else { return over };
    let count = usize::try_from(u32::from_le_bytes(*length)).unwrap_or(usize::MAX).min(STATES_MAX);
    let mut at = 4_usize;
    for _ in 0..count {
        let Some(id) = status.get(at..).and_then(|rest| rest.first_chunk::<16>()) else { break };
        // The time is aligned to four bytes; the state is one.
        let state = (at + 16).next_multiple_of(4) + 8;
        match status.get(state) {
            Some(state) if is_over(*state) => over.push(*id),
            Some(_) => {}
            None => break,
        }
        at = state + 1;
    }
    over
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
    fn the_goals_that_are_over_are_read_from_a_status_however_it_is_cut_off() {
        let mut status = 3_u32.to_le_bytes().to_vec();
        for (goal, state) in [(7_u8, 4_u8), (8, 2), (9, 5)] {
            status.extend([goal; 16]);
            status.resize(status.len().next_multiple_of(4), 0);
            status.extend([0; 8]);
            status.push(state);
        }
        assert_eq!(over_in(&status), [[7; 16], [9; 16]]);
        for length in 0..status.len() {
            assert!(over_in(&status[..length]).len() < 2, "{length}");
        }
        status[..4].copy_from_slice(&u32::MAX.to_le_bytes());
        assert_eq!(over_in(&status).len(), 2, "a length that lies");
    }

    #[test]
    fn one_goal_is_cancelled_by_its_id_alone() {
        assert_eq!(cancel_of([7; 16])[..], [[7; 16].as_slice(), &[0; 8]].concat());
        assert_eq!(goal_of(&cancel_of([7; 16])), Some([7; 16]));
    }
}
