//! Calls that have come over one stream and were not looked at yet.
//!
//! Control goes first. Data waits only so long. Beyond that the node gets more than it can look at, and only the newest call
//! about each subject goes on. A newer command is worth more than an older one, and the last of a burst may stop the robot.
//! It, too, is refused after twice as long. Every refusal is told and counted.

use bytes::Bytes;
use ledger::transaction::Transaction;
use ledger_base::invariant;
use ledger_base::mutation::{Mutation, active};
use ledger_base::rejection::{Code, Rejection};
use ledger_raft::Lane;
use std::collections::{HashSet, VecDeque};

/// A transaction that has come and was not looked at yet.
pub struct Arrived<C> {
    /// It has the form of one.
    pub transaction: Transaction,
    /// Its circumstances.
    pub ticket: Ticket,
    /// Where the answer goes. It has a place until then.
    pub client: C,
}

/// The circumstances of a transaction until it is answered.
#[derive(Clone, Copy, Debug)]
pub struct Ticket {
    /// Height at which it is to be looked at.
    pub min_height: u64,
    /// The client says that it gave it to no node before.
    pub first_attempt: bool,
    /// How urgent it says it is.
    pub lane: Lane,
    /// When it came, microseconds.
    pub since: u64,
}

/// Those of one stream, in the order in which they came.
pub(super) struct Line<C> {
    control: VecDeque<Arrived<C>>,
    data: VecDeque<Arrived<C>>,
}

impl<C> Default for Line<C> {
    fn default() -> Self {
        Self { control: VecDeque::new(), data: VecDeque::new() }
    }
}

impl<C> Line<C> {
    pub(super) fn push(&mut self, arrived: Arrived<C>) {
        let lane = self.lane(arrived.ticket.lane);
        let (since, before) = (arrived.ticket.since, lane.back().map_or(0, |last| last.ticket.since));
        invariant!(since >= before, "calls of a line stand in the order in which they came", "{since} after {before}");
        lane.push_back(arrived);
    }

    /// How many there are.
    pub(super) fn len(&self) -> usize {
        self.control.len() + self.data.len()
    }

    /// The lane that is to be looked at next.
    pub(super) fn next(&self) -> Option<Lane> {
        if active(Mutation::DataOvertakesControl) && !self.data.is_empty() {
            return Some(Lane::Data);
        }
        match (self.control.is_empty(), self.data.is_empty()) {
            (false, _) => Some(Lane::Control),
            (true, false) => Some(Lane::Data),
            (true, true) => None,
        }
    }

    /// The height that the first of a lane waits for.
    pub(super) fn min_height(&mut self, lane: Lane) -> Option<u64> {
        self.lane(lane).front().map(|arrived| arrived.ticket.min_height)
    }

    /// The first of a lane waits for no height any more.
    pub(super) fn reached(&mut self, lane: Lane) {
        if let Some(first) = self.lane(lane).front_mut() {
            first.ticket.min_height = 0;
        }
    }

    /// The first few of a lane.
    pub(super) fn first(&mut self, lane: Lane, count: usize) -> impl Iterator<Item = &Transaction> {
        self.lane(lane).iter().take(count).map(|arrived| &arrived.transaction)
    }

    /// Takes the first of a lane.
    pub(super) fn take(&mut self, lane: Lane) -> Option<Arrived<C>> {
        self.lane(lane).pop_front()
    }

    /// When the first data has waited too long: takes out all but the newest about each subject, and that too if it has
    /// waited twice as long.
    pub(super) fn take_late(&mut self, now: u64, wait_max: u64) -> Vec<(Arrived<C>, Rejection)> {
        let waited = |arrived: &Arrived<C>| now.saturating_sub(arrived.ticket.since);
        if self.data.front().is_none_or(|first| waited(first) <= wait_max) {
            return Vec::new();
        }
        let mut seen = HashSet::new();
        let mut newest: Vec<_> = self.data.iter().rev().map(|arrived| seen.insert(subject(arrived))).collect();
        drop(seen);
        let (mut refused, line) = (Vec::new(), (self.data.len(), self.data.front().map_or(0, waited)));
        for arrived in std::mem::take(&mut self.data) {
            let newest = newest.pop().unwrap_or(true);
            let waited = waited(&arrived);
            if newest && waited <= wait_max * 2 {
                self.data.push_back(arrived);
            } else {
                refused.push((arrived, overloaded(newest, waited, line, wait_max)));
            }
        }
        let (left, out) = (self.data.len(), refused.len());
        invariant!(left + out == line.0, "a call stays in the line or is refused", "{left} and {out} of {}", line.0);
        refused
    }

    fn lane(&mut self, lane: Lane) -> &mut VecDeque<Arrived<C>> {
        match lane {
            Lane::Control => &mut self.control,
            Lane::Data => &mut self.data,
        }
    }
}

/// Why data is not looked at that has waited so long, where so much waits of which the oldest has waited so long.
pub(super) fn overloaded(newest: bool, waited: u64, (waiting, oldest): (usize, u64), wait_max: u64) -> Rejection {
    let message = match newest {
        true => "the node is overloaded",
        false => "the node is overloaded: a newer call about the same subject replaced this one",
    };
    Rejection::new(Code::Overloaded, message)
        .found(format!(
            "it waited {} ms, the oldest of {waiting} on this connection {} ms",
            waited / 1000,
            oldest / 1000
        ))
        .wanted(format!("at most {} ms (order.wait_ms)", wait_max / 1000))
}

/// The subject of a call: usually a service.
fn subject<C>(arrived: &Arrived<C>) -> (&str, &str, Option<&Bytes>) {
    let body = arrived.transaction.body();
    (&body.chaincode, &body.function, body.args.first())
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::gateway::{InFlight, Shares};
    use ledger::transaction::Body;
    use ledger_identity::key::{KeyKind, SigningKey};

    const DATA_WAIT_MAX: u64 = 100_000;

    struct Stream {
        line: Line<InFlight>,
        shares: Shares,
        key: SigningKey,
    }

    impl Stream {
        fn new() -> Self {
            let key = testkit::key(KeyKind::Ed25519);
            Self { line: Line::default(), shares: Shares::new(1000), key }
        }

        /// Something about a service comes so many milliseconds after the start.
        fn comes(&mut self, lane: Lane, service: &'static str, at_ms: u64) {
            let body = Body {
                network: vec![1; 32].into(),
                creator: vec![2; 32].into(),
                nonce: vec![3; 16].into(),
                not_after: at_ms,
                chaincode: "abac".into(),
                function: "set".into(),
                args: vec![service.into()],
                known_block: None,
            };
            let transaction = Transaction::sign(&body, &self.key).unwrap();
            let client = self.shares.of("Org1/Salma".into()).place(lane, transaction.encoded().len()).unwrap();
            let ticket = Ticket { min_height: 0, first_attempt: true, lane, since: at_ms * 1000 };
            self.line.push(Arrived { transaction, ticket, client });
        }

        /// When those came that are refused after so many milliseconds, and what they are told.
        fn refused(&mut self, after_ms: u64) -> Vec<(u64, Rejection)> {
            let late = self.line.take_late(after_ms * 1000, DATA_WAIT_MAX);
            late.into_iter().map(|(arrived, reason)| (arrived.transaction.body().not_after, reason)).collect()
        }

        fn left(&mut self) -> Vec<u64> {
            let taken = std::iter::from_fn(|| self.line.take(Lane::Data));
            taken.map(|arrived| arrived.transaction.body().not_after).collect()
        }
    }

    #[test]
    fn control_is_looked_at_before_data_that_was_there_first() {
        let mut stream = Stream::new();
        assert_eq!(stream.line.next(), None);
        stream.comes(Lane::Data, "Husky", 0);
        assert_eq!(stream.line.next(), Some(Lane::Data));
        stream.comes(Lane::Control, "Husky", 1);
        assert_eq!(stream.line.next(), Some(Lane::Control));
        stream.line.take(Lane::Control).unwrap();
        assert_eq!(stream.line.next(), Some(Lane::Data));
    }

    #[test]
    fn nothing_is_refused_while_the_first_has_not_waited_too_long() {
        let mut stream = Stream::new();
        for at in 0..50 {
            stream.comes(Lane::Data, "Husky", at);
        }
        assert!(stream.refused(100).is_empty());
        assert_eq!(stream.left(), (0..50).collect::<Vec<_>>());
    }

    #[test]
    fn beyond_it_the_newest_command_of_each_service_replaces_the_older_ones() {
        let mut stream = Stream::new();
        for (service, at) in [("Husky", 0), ("Turtlebot4", 5), ("Husky", 60), ("Turtlebot4", 70), ("Husky", 80)] {
            stream.comes(Lane::Data, service, at);
        }
        let refused = stream.refused(110);
        assert_eq!(refused.iter().map(|(at, _)| *at).collect::<Vec<_>>(), [0, 5, 60]);
        for (at, reason) in refused {
            assert_eq!(reason.code, Code::Overloaded);
            assert!(reason.message.contains("newer"), "{reason}");
            assert!(
                reason.found.contains(&format!("waited {} ms", 110 - at)) && reason.wanted.contains("100 ms"),
                "{reason}"
            );
        }
        assert_eq!(stream.left(), [70, 80], "in their order");
    }

    #[test]
    fn the_last_command_of_a_burst_goes_on() {
        let mut stream = Stream::new();
        for _ in 0..10 {
            stream.comes(Lane::Data, "Husky", 0);
        }
        assert_eq!(stream.refused(150).len(), 9);
        assert_eq!(stream.left(), [0]);
    }

    #[test]
    fn the_newest_is_refused_too_after_twice_as_long() {
        let mut stream = Stream::new();
        stream.comes(Lane::Data, "Husky", 0);
        stream.comes(Lane::Data, "Turtlebot4", 90);
        assert!(stream.refused(200).is_empty());
        let refused = stream.refused(201);
        assert_eq!(refused.iter().map(|(at, _)| *at).collect::<Vec<_>>(), [0]);
        assert!(refused.iter().all(|(_, reason)| !reason.message.contains("newer")));
        assert_eq!(stream.left(), [90]);
    }

    #[test]
    fn control_waits_as_long_as_it_takes() {
        let mut stream = Stream::new();
        stream.comes(Lane::Control, "Husky", 0);
        stream.comes(Lane::Data, "Husky", 0);
        assert_eq!(stream.refused(1000).len(), 1);
        assert_eq!(stream.line.next(), Some(Lane::Control));
    }

    #[test]
    fn what_is_refused_gives_its_place_back() {
        let mut stream = Stream::new();
        stream.comes(Lane::Data, "Husky", 0);
        assert_eq!(stream.shares.in_flight(), 1);
        drop(stream.refused(1000));
        assert_eq!(stream.shares.in_flight(), 0);
    }

    #[test]
    #[should_panic(expected = "calls of a line stand in the order in which they came")]
    fn a_call_that_came_before_the_last_one_is_found() {
        let mut stream = Stream::new();
        stream.comes(Lane::Data, "drive", 5);
        stream.comes(Lane::Data, "drive", 4);
    }
}
