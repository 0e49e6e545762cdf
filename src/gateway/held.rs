//! Calls that came over one stream and that this node's state refuses, until it is known whether that state is current.
//!
//! The rest of the stream goes on meanwhile. Only what is about the same as something that is held waits behind it: else a
//! client's later call would overtake its earlier one. Control, as everywhere, waits for control only.

use super::current::{Known, Question};
use super::line::Arrived;
use ledger::Refusal;
use ledger_raft::Lane;
use ledger_rejection::{Code, Rejection};
use std::collections::VecDeque;
use std::collections::hash_map::{Entry, HashMap, RandomState};
use std::future::pending;
use std::hash::BuildHasher;

/// One that is held.
pub(super) struct Item {
    pub(super) arrived: Arrived,
    /// Why the state refuses it; none for one that waits behind another and was not looked at.
    pub(super) refusal: Option<Box<Refusal>>,
}

/// Those of one stream, each lane in the order in which they came.
#[derive(Default)]
pub(super) struct Held {
    control: VecDeque<(u64, Item)>,
    data: VecDeque<(u64, Item)>,
    /// How many there are about each subject, control and data.
    subjects: HashMap<u64, (usize, usize)>,
    hasher: RandomState,
    /// The question that is under way.
    asked: Option<Question>,
    /// The answer to the last one.
    known: Option<Known>,
    /// How many of the first of each lane, control and data, the question serves: those that came before it.
    served: (usize, usize),
}

impl Held {
    pub(super) fn is_empty(&self) -> bool {
        self.control.is_empty() && self.data.is_empty()
    }

    /// Must it wait behind one that is held?
    pub(super) fn holds_back(&self, arrived: &Arrived) -> bool {
        !self.subjects.is_empty()
            && self.subjects.get(&self.subject(arrived)).is_some_and(|(control, _)| match arrived.ticket.lane {
                Lane::Control => *control > 0,
                Lane::Data => true,
            })
    }

    /// Takes one in; `ask` asks whether the state is current, if no question is under way.
    pub(super) fn push(&mut self, item: Item, ask: impl Fn() -> Question) {
        let subject = self.subject(&item.arrived);
        let (control, data) = self.subjects.entry(subject).or_default();
        let (queue, count) = match item.arrived.ticket.lane {
            Lane::Control => (&mut self.control, control),
            Lane::Data => (&mut self.data, data),
        };
        *count += 1;
        queue.push_back((subject, item));
        self.go_on(ask);
    }

    /// Waits for the answer to the question that is under way; for ever if there is none. Cancelling it loses nothing.
    pub(super) async fn answered(&mut self) {
        let Some(asked) = &mut self.asked else { return pending().await };
        let known = asked.await;
        self.asked = None;
        let gone = || Err(Rejection::new(Code::ShuttingDown, "the node is stopping"));
        self.known = Some(known.unwrap_or_else(|_| gone()));
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
    pub(super) fn take(&mut self, lane: Lane, ask: impl Fn() -> Question) -> Option<(Item, Known)> {
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
            *count = count.saturating_sub(1);
            if counts.get() == &(0, 0) {
                counts.remove();
            }
        }
        if self.served == (0, 0) {
            self.known = None;
            self.go_on(ask);
        }
        Some((item, known))
    }

    /// Asks for all that are there, unless others are being served.
    fn go_on(&mut self, ask: impl Fn() -> Question) {
        if self.asked.is_none() && self.known.is_none() && !self.is_empty() {
            self.served = (self.control.len(), self.data.len());
            self.asked = Some(ask());
        }
    }

    /// The subject of a call: usually a service, whatever is done with it. Two that are taken for one wait for each
    /// other.
    fn subject(&self, arrived: &Arrived) -> u64 {
        let body = arrived.transaction.body();
        self.hasher.hash_one((&body.chaincode, body.args.first()))
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::gateway::line::Ticket;
    use crate::gateway::share::Shares;
    use futures::FutureExt;
    use ledger::transaction::{Body, Transaction};
    use ledger_identity::key::{KeyKind, SigningKey};
    use ring::rand::SystemRandom;
    use std::cell::RefCell;
    use std::time::Instant;
    use tokio::sync::oneshot;

    /// One stream, and the questions that it asked.
    struct Stream {
        held: Held,
        shares: Shares,
        key: SigningKey,
        questions: RefCell<Vec<oneshot::Sender<Known>>>,
    }

    impl Stream {
        fn new() -> Self {
            let key = SigningKey::generate(KeyKind::Ed25519, &SystemRandom::new()).unwrap();
            Self { held: Held::default(), shares: Shares::new(1000, 2), key, questions: RefCell::default() }
        }

        fn call(&self, lane: Lane, function: &str, service: &'static str) -> Arrived {
            let body = Body {
                network: vec![1; 32].into(),
                creator: vec![2; 32].into(),
                nonce: vec![3; 16].into(),
                not_after: 4,
                chaincode: "abac".into(),
                function: function.into(),
                args: vec![service.into()],
            };
            let transaction = Transaction::sign(&body, &self.key).unwrap();
            let place = self.shares.of("Org1/Salma".into()).place(lane, transaction.encoded().len()).unwrap();
            let ticket = Ticket { min_height: 0, first_attempt: true, lane, since: Instant::now(), place };
            Arrived { transaction, ticket }
        }

        fn holds(&mut self, lane: Lane, function: &str, service: &'static str) {
            let item = Item { arrived: self.call(lane, function, service), refusal: None };
            self.held.push(item, || ask(&self.questions));
        }

        /// The oldest question is answered.
        fn answer(&mut self, height: u64) {
            self.questions.borrow_mut().remove(0).send(Ok(height)).unwrap();
            self.held.answered().now_or_never().unwrap();
        }

        /// The functions of all that can be decided now, in order.
        fn decided(&mut self) -> Vec<String> {
            let mut decided = Vec::new();
            while let Some(lane) = self.held.due() {
                let (item, known) = self.held.take(lane, || ask(&self.questions)).unwrap();
                decided.push(format!("{} {}", item.arrived.transaction.body().function, known.unwrap()));
            }
            decided
        }
    }

    fn ask(questions: &RefCell<Vec<oneshot::Sender<Known>>>) -> Question {
        let (sender, question) = oneshot::channel();
        questions.borrow_mut().push(sender);
        question
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
        assert_eq!(stream.questions.borrow().len(), 1, "one at a time");
        stream.answer(3);
        stream.holds(Lane::Control, "third", "Husky");
        assert_eq!(stream.decided(), ["first 3"], "the second came after the question");
        assert_eq!(stream.questions.borrow().len(), 1);
        stream.holds(Lane::Data, "fourth", "Husky");
        stream.answer(5);
        assert_eq!(stream.decided(), ["third 5", "second 5"]);
        stream.answer(6);
        assert_eq!(stream.decided(), ["fourth 6"]);
        assert!(stream.held.is_empty() && stream.questions.borrow().is_empty());
        assert_eq!(stream.shares.in_flight(), 0, "places come back");
    }

    #[test]
    fn a_node_that_stops_answers_those_it_holds() {
        let mut stream = Stream::new();
        stream.holds(Lane::Data, "set", "Husky");
        stream.questions.borrow_mut().clear();
        stream.held.answered().now_or_never().unwrap();
        let (_, known) = stream.held.take(Lane::Data, || ask(&stream.questions)).unwrap();
        assert_eq!(known.unwrap_err().code, Code::ShuttingDown);
    }
}
