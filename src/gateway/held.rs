//! What came over one stream and this node's state refuses, until it is known whether that state is current.
//!
//! The rest of the stream goes on meanwhile. Only what is about the same as something that is held waits behind it: else a
//! client's later call would overtake its earlier one. Control, as everywhere, waits for control only.

use super::Current;
use super::current::Known;
use super::line::Arrived;
use ledger::{Code, Refusal, Rejection};
use ledger_raft::Lane;
use std::collections::VecDeque;
use std::collections::hash_map::{Entry, HashMap, RandomState};
use std::future::pending;
use std::hash::BuildHasher;
use tokio::sync::oneshot;

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
    asked: Option<oneshot::Receiver<Known>>,
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
            && self.subjects.get(&self.subject(arrived)).is_some_and(|(control, _)| match arrived.lane {
                Lane::Control => *control > 0,
                Lane::Data => true,
            })
    }

    /// Takes one in.
    pub(super) fn push(&mut self, item: Item, current: &Current) {
        let subject = self.subject(&item.arrived);
        let (control, data) = self.subjects.entry(subject).or_default();
        let (queue, count) = match item.arrived.lane {
            Lane::Control => (&mut self.control, control),
            Lane::Data => (&mut self.data, data),
        };
        *count += 1;
        queue.push_back((subject, item));
        self.go_on(current);
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
    pub(super) fn take(&mut self, lane: Lane, current: &Current) -> Option<(Item, Known)> {
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
            self.go_on(current);
        }
        Some((item, known))
    }

    /// Asks for all that are there, unless others are being served.
    fn go_on(&mut self, current: &Current) {
        if self.asked.is_none() && self.known.is_none() && !self.is_empty() {
            self.served = (self.control.len(), self.data.len());
            self.asked = Some(current.ask());
        }
    }

    /// What a call is about: usually a service, whatever is done with it. Two that are taken for one wait for each other.
    fn subject(&self, arrived: &Arrived) -> u64 {
        let body = arrived.transaction.body();
        self.hasher.hash_one((&body.chaincode, body.args.first()))
    }
}
