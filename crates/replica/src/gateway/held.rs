//! Calls of one stream that this node's state refuses, until it is known whether that state is current.
//!
//! The rest of the stream goes on meanwhile. Only what is about the same as something that is held waits behind it: else a
//! client's later call would overtake its earlier one. Control, as everywhere, waits for control only.

use super::line::Arrived;
use crate::reads::Known;
use ledger::Refusal;
use ledger_base::mutation::{Mutation, active};
use ledger_base::{costly_invariant, invariant};
use ledger_raft::Lane;
use std::collections::VecDeque;
use std::collections::hash_map::{Entry, HashMap, RandomState};
use std::hash::BuildHasher;

/// One that is held.
pub struct Item<C> {
    /// The call.
    pub arrived: Arrived<C>,
    /// Why the state refuses it; none for one that waits behind another and was not looked at.
    pub refusal: Option<Box<Refusal>>,
}

/// Those of one stream, each lane in the order in which they came.
pub(super) struct Held<C> {
    control: VecDeque<(u64, Item<C>)>,
    data: VecDeque<(u64, Item<C>)>,
    /// How many there are about each subject, control and data.
    subjects: HashMap<u64, (usize, usize)>,
    hasher: RandomState,
    /// A question is under way.
    asked: bool,
    /// The answer to the last one.
    known: Option<Known>,
    /// How many of the first of each lane, control and data, the question serves: those that came before it.
    served: (usize, usize),
}

impl<C> Default for Held<C> {
    fn default() -> Self {
        Self {
            control: VecDeque::new(),
            data: VecDeque::new(),
            subjects: HashMap::new(),
            hasher: RandomState::new(),
            asked: false,
            known: None,
            served: (0, 0),
        }
    }
}

impl<C> Held<C> {
    pub(super) fn is_empty(&self) -> bool {
        self.control.is_empty() && self.data.is_empty()
    }

    /// Must it wait behind one that is held?
    pub(super) fn holds_back(&self, arrived: &Arrived<C>) -> bool {
        !self.subjects.is_empty()
            && !active(Mutation::OvertakeWhatIsHeld)
            && self.subjects.get(&self.subject(arrived)).is_some_and(|(control, _)| match arrived.ticket.lane {
                Lane::Control => *control > 0,
                Lane::Data => true,
            })
    }

    /// Takes one in.
    pub(super) fn push(&mut self, item: Item<C>) {
        let subject = self.subject(&item.arrived);
        let (control, data) = self.subjects.entry(subject).or_default();
        let (queue, count) = match item.arrived.ticket.lane {
            Lane::Control => (&mut self.control, control),
            Lane::Data => (&mut self.data, data),
        };
        *count += 1;
        queue.push_back((subject, item));
        self.check();
    }

    /// Is a question to be asked, whether the state is current? It then serves all that are there. Its answer goes to
    /// [`Held::answered`].
    pub(super) fn asks(&mut self) -> bool {
        if self.asked || self.known.is_some() || self.is_empty() {
            return false;
        }
        self.served = (self.control.len(), self.data.len());
        self.asked = true;
        self.check();
        true
    }

    /// The answer to the question that was under way.
    pub(super) fn answered(&mut self, known: Known) {
        let (asked, known_before) = (self.asked, &self.known);
        invariant!(
            asked && known_before.is_none(),
            "an answer follows a question, and is used before the next",
            "{known:?} after {known_before:?}, asked: {asked}"
        );
        self.asked = false;
        self.known = Some(known);
    }

    /// The lane that can be decided now.
    pub(super) fn due(&self) -> Option<Lane> {
        match (&self.known, self.served) {
            (Some(_), (1.., _)) => Some(Lane::Control),
            (Some(_), (0, 1..)) => Some(Lane::Data),
            _ => None,
        }
    }

    /// Takes the first of the lane that is due, and what is known for it.
    pub(super) fn take(&mut self, lane: Lane) -> Option<(Item<C>, Known)> {
        let known = self.known.clone()?;
        let (queue, served) = match lane {
            Lane::Control => (&mut self.control, &mut self.served.0),
            Lane::Data => (&mut self.data, &mut self.served.1),
        };
        *served = served.checked_sub(1)?;
        let (subject, item) = queue.pop_front()?;
        if let Entry::Occupied(mut counts) = self.subjects.entry(subject) {
            let (control, data) = counts.get_mut();
            let count = if lane == Lane::Control { control } else { data };
            let before = *count;
            invariant!(before > 0, "each held call is counted with its subject", "{before} before one was taken");
            *count -= 1;
            if counts.get() == &(0, 0) {
                counts.remove();
            }
        }
        if self.served == (0, 0) {
            self.known = None;
        }
        self.check();
        Some((item, known))
    }

    /// States that a question serves some of the calls that are held, and that all of them are counted.
    fn check(&self) {
        let (held, served) = ((self.control.len(), self.data.len()), self.served);
        invariant!(
            served.0 <= held.0 && served.1 <= held.1,
            "a question serves calls that are held",
            "it serves {served:?} of {held:?}"
        );
        let open = self.asked || self.known.is_some();
        invariant!(open == (served != (0, 0)), "an open question serves a call", "open: {open}, serves {served:?}");
        costly_invariant!(
            self.counted() == held,
            "each held call is counted with its subject",
            "{:?} of {held:?}",
            self.counted()
        );
    }

    /// How many are counted, control and data.
    fn counted(&self) -> (usize, usize) {
        self.subjects.values().fold((0, 0), |sum, count| (sum.0 + count.0, sum.1 + count.1))
    }

    /// The subject of a call: usually a service. Two that are taken for one wait for each other.
    fn subject(&self, arrived: &Arrived<C>) -> u64 {
        let body = arrived.transaction.body();
        self.hasher.hash_one((&body.chaincode, body.args.first()))
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::gateway::{InFlight, Shares, Ticket};
    use ledger::transaction::{Body, Transaction};
    use ledger_identity::key::{KeyKind, SigningKey};

    /// One stream, and the number of questions that it asked and that are not answered.
    struct Stream {
        held: Held<InFlight>,
        shares: Shares,
        key: SigningKey,
        questions: usize,
    }

    impl Stream {
        fn new() -> Self {
            let key = testkit::key(KeyKind::Ed25519);
            Self { held: Held::default(), shares: Shares::new(1000), key, questions: 0 }
        }

        fn call(&self, lane: Lane, function: &str, service: &'static str) -> Arrived<InFlight> {
            let body = Body {
                network: vec![1; 32].into(),
                creator: vec![2; 32].into(),
                nonce: vec![3; 16].into(),
                not_after: 4,
                chaincode: "abac".into(),
                function: function.into(),
                args: vec![service.into()],
                known_block: None,
            };
            let transaction = Transaction::sign(&body, &self.key).unwrap();
            let client = self.shares.of("Org1/Salma".into()).place(lane, transaction.encoded().len()).unwrap();
            Arrived { transaction, ticket: Ticket { min_height: 0, first_attempt: true, lane, since: 0 }, client }
        }

        fn holds(&mut self, lane: Lane, function: &str, service: &'static str) {
            self.held.push(Item { arrived: self.call(lane, function, service), refusal: None });
            self.questions += usize::from(self.held.asks());
        }

        /// The question is answered.
        fn answer(&mut self, height: u64) {
            self.questions -= 1;
            self.held.answered(Ok(height));
        }

        /// The functions of all that can be decided now, in order.
        fn decided(&mut self) -> Vec<String> {
            let mut decided = Vec::new();
            while let Some(lane) = self.held.due() {
                let (item, known) = self.held.take(lane).unwrap();
                self.questions += usize::from(self.held.asks());
                decided.push(format!("{} {}", item.arrived.transaction.body().function, known.unwrap()));
            }
            decided
        }
    }

    #[test]
    fn a_later_call_about_the_same_waits_behind_and_the_rest_of_the_stream_goes_on() {
        let mut stream = Stream::new();
        assert!(!stream.held.holds_back(&stream.call(Lane::Data, "set", "Husky")));
        stream.holds(Lane::Control, "acquire", "Husky");
        assert!(stream.held.holds_back(&stream.call(Lane::Data, "set", "Husky")), "it would overtake the acquire");
        assert!(stream.held.holds_back(&stream.call(Lane::Control, "release", "Husky")));
        assert!(!stream.held.holds_back(&stream.call(Lane::Data, "set", "Turtlebot4")));
        stream.answer(3);
        assert_eq!(stream.decided(), ["acquire 3"]);
        assert!(!stream.held.holds_back(&stream.call(Lane::Data, "set", "Husky")));
        stream.holds(Lane::Data, "set", "Husky");
        assert!(stream.held.holds_back(&stream.call(Lane::Data, "set", "Husky")));
        assert!(
            !stream.held.holds_back(&stream.call(Lane::Control, "release", "Husky")),
            "control waits for no message"
        );
    }

    #[test]
    fn a_question_serves_those_that_came_before_it_and_no_other() {
        let mut stream = Stream::new();
        stream.holds(Lane::Data, "first", "Husky");
        stream.holds(Lane::Data, "second", "Husky");
        assert_eq!(stream.questions, 1, "one at a time");
        stream.answer(3);
        stream.holds(Lane::Control, "third", "Husky");
        assert_eq!(stream.decided(), ["first 3"], "the second came after the question");
        assert_eq!(stream.questions, 1);
        stream.holds(Lane::Data, "fourth", "Husky");
        stream.answer(5);
        assert_eq!(stream.decided(), ["third 5", "second 5"]);
        stream.answer(6);
        assert_eq!(stream.decided(), ["fourth 6"]);
        assert!(stream.held.is_empty() && stream.questions == 0);
        assert_eq!(stream.shares.in_flight(), 0, "places come back");
    }
}
