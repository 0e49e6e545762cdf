//! Control calls and questions of robots that wait for their verdict, and when a voter complains about the leader because of one.
//!
//! ```text
//! kept          the oldest call of each identity: submitted here, or passed on by another node
//! given         to the leader, again with each new leader and once a second
//! passed on     to all voters, if this node has it from a client and it is not executed after half a second;
//!               a question after a quarter of a second, and from then on it is control
//! complaint     the leader ordered blocks at least two seconds of its own time later (a question: 0.75 s), and this call is in none;
//!               or for five seconds nothing was executed here but the empty blocks of new terms;
//!               or it was elected three times in at least five seconds, and nobody else in between
//! forgotten     with its verdict, after its `not_after`, or if it would be rejected now
//! ```
//! **Exceptions.** A leader that orders nothing for a moment (cut off, with a slow disk) puts no block behind the call. A
//! voter that lags executes old blocks, which were ordered before. A call that did not reach the leader from here reaches it from
//! another voter. A creator that is over its budget has to wait. A leader that is silent for five seconds is no use, whether it
//! lies or its disk stands still.

use bytes::Bytes;
use ledger::transaction::Transaction;
use ledger_base::hash::Hash;
use ledger_raft::UNANSWERED_BYTES_MAX;
use std::collections::BTreeMap;

/// Longest transaction that overtakes data, in bytes. A policy of the largest size is longer; a call that takes a right away
/// and a certificate have room.
pub(crate) const URGENT_BYTES_MAX: usize = 8 * 1024;
/// Most calls that are kept, one of each identity.
const CALLS_MAX: usize = 1024;
/// A call of an own client is passed on after this time, microseconds.
const PASS_ON_AFTER: u64 = 500_000;
/// The same of a question: the robot that asks stops after a second without an answer.
const PASS_ON_QUESTION_AFTER: u64 = 250_000;
/// A leader may leave a call out of its blocks for this time, microseconds.
const BOUND: u64 = 2_000_000;
/// The shortest such time: for questions. For calls that end sooner than in four seconds, it is half of the time that they have.
const BOUND_MIN: u64 = 750_000;
/// A leader may order nothing at all for this time while a call waits, microseconds. One that has itself elected again and again
/// has no longer.
const SILENCE_MAX: u64 = 5_000_000;
/// A leader that was elected just now is not silent yet, microseconds: nothing was ordered while there was none.
const SILENCE_MIN: u64 = 1_000_000;
/// Elections of one leader, without another one in between, that are too many while a call waits.
const ELECTIONS_MAX: u32 = 3;
/// A call is given to the leader again after this time, microseconds: messages are lost.
const GIVE_AGAIN: u64 = 1_000_000;
/// Pause between two looks at the calls, microseconds.
const LOOK_EVERY: u64 = 50_000;
/// Calls that one node may pass on in a second. Each costs a look, as a submission does.
const PASSED_ON_MAX: u32 = 32;
/// Microseconds.
const SECOND: u64 = 1_000_000;

/// The view of a node on its leader and on what is executed.
#[derive(Clone, Copy, Debug)]
pub(crate) struct View {
    /// Time since the node started, microseconds.
    pub(crate) elapsed: u64,
    /// The node's clock, microseconds since the UNIX epoch.
    pub(crate) clock: u64,
    /// Term and number of the leader, if another node leads.
    pub(crate) leader: Option<(u64, u64)>,
    /// Height of the newest executed block.
    pub(crate) height: u64,
    /// Its term.
    pub(crate) term: u64,
    /// Its block time, microseconds since the UNIX epoch.
    pub(crate) time: u64,
}

/// The next step with a call.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Step {
    /// Give it to the leader.
    Give(Bytes),
    /// Send it to all voters.
    PassOn(Bytes),
    /// Complain about the leader, if the call is still admissible; forget it otherwise.
    Complain(Box<Transaction>),
}

/// The kinds of calls that are kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    /// It changes who controls, and overtakes data.
    Control,
    /// A robot asks for its certified state. It waits with the data for a moment.
    Question,
}

/// The calls that wait, by their creators.
#[derive(Debug, Default)]
pub(crate) struct Withheld {
    calls: BTreeMap<Hash, Call>,
    looked: u64,
    /// Height and term of the newest executed block.
    newest: (u64, u64),
    /// Since when no block with content was executed, in time since the node started.
    silent_since: u64,
    /// The calls that each node has passed on in the current second.
    passed_on: BTreeMap<u64, (u64, u32)>,
}

#[derive(Debug)]
struct Call {
    transaction: Transaction,
    kind: Kind,
    /// Of the creator; when there is no room, the one with the most calls loses one.
    organisation: String,
    /// Since when it is kept, in time since the node started, microseconds.
    since: u64,
    /// It is not to be passed on, or was.
    passed: bool,
    /// The leader gets it as the call of an own client.
    submitted: bool,
    /// The leader that has it, since when by both clocks, and when it was given last.
    given: Option<Given>,
}

#[derive(Clone, Copy, Debug)]
struct Given {
    /// Term and node.
    leader: (u64, u64),
    /// When this node had the call for the first time, in time since the node started; and how often it was elected since.
    first: u64,
    elections: u32,
    /// When it had the call in this term, by both clocks.
    elapsed: u64,
    clock: u64,
    /// When it was given the call last.
    last: u64,
}

impl Withheld {
    /// Is it time to look at the calls?
    pub(crate) fn is_due(&self, elapsed: u64) -> bool {
        !self.calls.is_empty() && elapsed.saturating_sub(self.looked) >= LOOK_EVERY
    }

    /// May this node pass on one more call in this second?
    pub(crate) fn may_pass_on(&mut self, from: u64, elapsed: u64) -> bool {
        let second = elapsed / SECOND;
        self.passed_on.retain(|_, (of, _)| *of == second);
        let (_, calls) = self.passed_on.entry(from).or_insert((second, 0));
        *calls += 1;
        *calls <= PASSED_ON_MAX
    }

    /// Keeps a call, unless an older one of its creator is kept. `own`: a client of this node has submitted it.
    pub(crate) fn keep(
        &mut self,
        transaction: &Transaction,
        kind: Kind,
        organisation: impl FnOnce() -> String,
        own: bool,
        elapsed: u64,
    ) {
        let creator = transaction.creator();
        if self.calls.contains_key(&creator) || transaction.encoded().len() > UNANSWERED_BYTES_MAX {
            return;
        }
        let organisation = organisation();
        if self.calls.len() >= CALLS_MAX && !self.make_room(&organisation) {
            return;
        }
        let transaction = transaction.clone();
        self.calls.insert(
            creator,
            Call { transaction, kind, organisation, since: elapsed, passed: !own, submitted: own, given: None },
        );
    }

    /// Lets the newest call of the organisation go that has the most, if that is more than this one has.
    fn make_room(&mut self, organisation: &str) -> bool {
        let mut counts = BTreeMap::<&str, usize>::new();
        for call in self.calls.values() {
            *counts.entry(&call.organisation).or_default() += 1;
        }
        let own = counts.get(organisation).copied().unwrap_or_default();
        let most = counts.into_iter().max_by_key(|(_, count)| *count).filter(|(_, count)| *count > own + 1);
        let Some(crowding) = most.map(|(crowding, _)| crowding.to_owned()) else { return false };
        let of_it = self.calls.iter().filter(|(_, call)| call.organisation == crowding);
        let newest = of_it.max_by_key(|(_, call)| call.since).map(|(creator, _)| *creator);
        newest.and_then(|creator| self.calls.remove(&creator)).is_some()
    }

    /// Forgets a call: it would be rejected now.
    pub(crate) fn forget(&mut self, transaction: &Transaction) {
        let is_it = |call: &Call| call.transaction.id() == transaction.id();
        if self.calls.get(&transaction.creator()).is_some_and(is_it) {
            self.calls.remove(&transaction.creator());
        }
    }

    /// The next steps. To be called often. `is_settled`: has it a verdict, or can it have none any more?
    pub(crate) fn tend(&mut self, view: View, is_settled: impl Fn(&Transaction) -> bool) -> Vec<Step> {
        if !self.is_due(view.elapsed) {
            return Vec::new();
        }
        self.looked = view.elapsed;
        // The first block of a term is empty.
        let (height, term) = self.newest;
        if view.height > height + u64::from(view.term != term) {
            self.silent_since = view.elapsed;
        }
        self.newest = (view.height, view.term);
        let silent_since = self.silent_since;
        self.calls.retain(|_, call| !is_settled(&call.transaction));
        let mut steps = Vec::new();
        for call in self.calls.values_mut() {
            call.next(view, silent_since, &mut steps);
        }
        steps
    }
}

impl Call {
    fn next(&mut self, view: View, silent_since: u64, steps: &mut Vec<Step>) {
        let pass_on_after = if self.kind == Kind::Question { PASS_ON_QUESTION_AFTER } else { PASS_ON_AFTER };
        if !self.passed && view.elapsed.saturating_sub(self.since) >= pass_on_after {
            self.passed = true;
            steps.push(Step::PassOn(self.transaction.encoded().clone()));
            // The leader has a question as data until now.
            self.submitted &= self.kind == Kind::Control;
        }
        // A question may be late like data before other voters have it.
        let Some(leader) = view.leader.filter(|_| self.passed || self.kind == Kind::Control) else { return };
        let View { elapsed, clock, .. } = view;
        let given = match self.given {
            Some(given) if given.leader == leader => given,
            before => {
                if !std::mem::take(&mut self.submitted) {
                    steps.push(Step::Give(self.transaction.encoded().clone()));
                }
                let same = before.filter(|before| before.leader.1 == leader.1);
                let (first, elections) =
                    same.map_or((elapsed, 1), |same| (same.first, same.elections.saturating_add(1)));
                *self.given.insert(Given { leader, first, elections, elapsed, clock, last: elapsed })
            }
        };
        if elapsed.saturating_sub(given.last) >= GIVE_AGAIN {
            self.given = Some(Given { last: elapsed, ..given });
            steps.push(Step::Give(self.transaction.encoded().clone()));
        }
        let left = self.transaction.body().not_after.saturating_sub(given.clock);
        let bound = if self.kind == Kind::Question { BOUND_MIN } else { (left / 2).clamp(BOUND_MIN, BOUND) };
        let is_overtaken = view.term == leader.0 && view.time >= given.clock.saturating_add(bound);
        let is_late = is_overtaken && elapsed.saturating_sub(given.elapsed) >= bound;
        let is_silent = elapsed.saturating_sub(given.first.max(silent_since)) >= SILENCE_MAX
            && elapsed.saturating_sub(given.elapsed) >= SILENCE_MIN;
        let is_renewed = given.elections >= ELECTIONS_MAX && elapsed.saturating_sub(given.first) >= SILENCE_MAX;
        if is_late || is_silent || is_renewed {
            steps.push(Step::Complain(Box::new(self.transaction.clone())));
        }
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use ledger::transaction::{Body, NONCE_BYTES};
    use ledger_identity::key::{KeyKind, SigningKey};
    use ring::rand::SystemRandom;
    use std::sync::OnceLock;

    /// The clock when the tests begin.
    const NOW: u64 = 1_893_456_000_000_000;

    fn call_until(creator: u8, nonce: u8, not_after: u64) -> Transaction {
        static KEY: OnceLock<SigningKey> = OnceLock::new();
        let key = KEY.get_or_init(|| SigningKey::generate(KeyKind::Ed25519, &SystemRandom::new()).unwrap());
        let (network, creator) = (Bytes::from(vec![1; 32]), Bytes::from(vec![creator; 32]));
        let nonce = Bytes::from(vec![nonce; NONCE_BYTES]);
        let (chaincode, function) = ("abac".to_owned(), "stop".to_owned());
        let known_block = None;
        let body = Body { network, creator, nonce, not_after, chaincode, function, args: Vec::new(), known_block };
        Transaction::sign(&body, key).unwrap()
    }

    fn call(creator: u8, nonce: u8) -> Transaction {
        call_until(creator, nonce, NOW + 60 * SECOND)
    }

    fn kept(calls: &[Transaction], own: bool) -> Withheld {
        let mut withheld = Withheld::default();
        calls.iter().for_each(|call| withheld.keep(call, Kind::Control, || "Org1".to_owned(), own, SECOND));
        withheld
    }

    /// So long after the call came: node 1 leads in term 5, and blocks are executed at once.
    fn view(after: u64) -> View {
        let height = after / 100_000;
        View { elapsed: SECOND + after, clock: NOW + after, leader: Some((5, 1)), height, term: 5, time: NOW + after }
    }

    /// When the calls are complained about, in milliseconds after they came.
    fn complaints(withheld: &mut Withheld, view: impl Fn(u64) -> View) -> Vec<u64> {
        let times = (0..10 * SECOND).step_by(100_000);
        let complains = |step: &Step| matches!(step, Step::Complain(_));
        let found = times.filter(|after| withheld.tend(view(*after), |_| false).iter().any(complains));
        found.map(|after| after / 1000).collect()
    }

    #[test]
    fn a_call_that_blocks_of_two_seconds_do_not_have_is_complained_about() {
        let found = complaints(&mut kept(&[call(1, 1)], false), view);
        assert_eq!(found.first(), Some(&2000));
        assert_eq!(found.last(), Some(&9900), "for as long as it lasts");
        let sooner = complaints(&mut kept(&[call_until(1, 1, NOW + 2 * SECOND)], false), view);
        assert_eq!(sooner.first(), Some(&1000), "half of the time that it has");
        let at_once = complaints(&mut kept(&[call_until(1, 1, NOW + 1)], false), view);
        assert_eq!(at_once.first(), Some(&800), "and not less than three quarters of a second");
    }

    #[test]
    fn a_leader_that_orders_nothing_is_complained_about_after_five_seconds() {
        let stands = |until: u64| move |after: u64| View { time: NOW, height: after.min(until), ..view(after) };
        let silent = complaints(&mut kept(&[call(1, 1)], false), stands(0));
        assert_eq!(silent.first(), Some(&5000));
        let later = complaints(&mut kept(&[call(1, 1)], false), stands(3 * SECOND));
        assert_eq!(later.first(), Some(&8000), "five seconds after its last block");
    }

    #[test]
    fn a_leader_that_has_itself_elected_again_and_again_is_complained_about_after_five_seconds() {
        // In each of its terms it orders messages, and then the empty block of the next one.
        let renews = |by: u64| {
            move |after: u64| {
                let terms = after / 600_000;
                let leader = if terms % 4 == 3 { by } else { 1 };
                View { leader: Some((5 + terms, leader)), term: 5 + terms, ..view(after) }
            }
        };
        assert_eq!(complaints(&mut kept(&[call(1, 1)], false), renews(1)).first(), Some(&5000));
        let none: [u64; 0] = [];
        assert_eq!(complaints(&mut kept(&[call(1, 1)], false), renews(2)), none, "another one led in between");
        // Nor does the empty block of a term count as ordering.
        let empty = |after: u64| {
            let terms = after / 4_500_000;
            View { leader: Some((5 + terms, 1)), height: terms, term: 5 + terms, time: NOW, ..view(after) }
        };
        assert_eq!(
            complaints(&mut kept(&[call(1, 1)], false), empty).first(),
            Some(&5500),
            "and a second after it began"
        );
    }

    #[test]
    fn a_leader_that_orders_nothing_behind_the_call_is_not_complained_about() {
        let none: [u64; 0] = [];
        let idle = |after: u64| View { time: NOW + after.min(SECOND), ..view(after) };
        assert_eq!(complaints(&mut kept(&[call(1, 1)], false), idle), none, "blocks of before");
        let lagging = |after: u64| View { time: (NOW + after).saturating_sub(9 * SECOND), ..view(after) };
        assert_eq!(complaints(&mut kept(&[call(1, 1)], false), lagging), none, "this node executes old blocks");
        let before = |after: u64| View { term: 4, ..view(after) };
        assert_eq!(complaints(&mut kept(&[call(1, 1)], false), before), none, "blocks of another leader");
        let fast = |after: u64| View { time: NOW + after + 3 * SECOND, ..view(after) };
        assert_eq!(
            complaints(&mut kept(&[call(1, 1)], false), fast).first(),
            Some(&2000),
            "its clock alone is no reason"
        );
        let leads = |after: u64| View { leader: None, ..view(after) };
        assert_eq!(complaints(&mut kept(&[call(1, 1)], false), leads), none, "nobody else leads");
    }

    #[test]
    fn each_leader_has_its_own_time_and_gets_the_call_at_once() {
        let mut withheld = kept(&[call(1, 1)], false);
        let given = |withheld: &mut Withheld, view| {
            withheld.tend(view, |_| false).contains(&Step::Give(call(1, 1).encoded().clone()))
        };
        assert!(given(&mut withheld, view(0)) && !given(&mut withheld, view(500_000)));
        assert!(given(&mut withheld, view(SECOND)), "messages are lost");
        let next = |after: u64| View { leader: Some((6, 2)), term: 6, ..view(after) };
        assert!(given(&mut withheld, next(1_500_000)));
        let found = complaints(&mut withheld, |after| next(after + 1_600_000));
        assert_eq!(found.first(), Some(&1900), "two seconds after it was given");
    }

    #[test]
    fn the_oldest_call_of_a_creator_is_kept_until_it_has_a_verdict() {
        let mut withheld = kept(&[call(1, 1), call(1, 2), call(2, 3)], false);
        let complained = |withheld: &mut Withheld, after, settled: &[Transaction]| -> Vec<Transaction> {
            let steps = withheld.tend(view(after), |call| settled.contains(call));
            let of = steps.into_iter().filter_map(|step| match step {
                Step::Complain(call) => Some(*call),
                _ => None,
            });
            of.collect()
        };
        complained(&mut withheld, 0, &[]);
        assert_eq!(complained(&mut withheld, 2 * SECOND, &[]), [call(1, 1), call(2, 3)]);
        assert_eq!(complained(&mut withheld, 3 * SECOND, &[call(1, 1)]), [call(2, 3)]);
        withheld.forget(&call(2, 4));
        assert!(!withheld.calls.is_empty(), "it is another one");
        withheld.forget(&call(2, 3));
        assert!(withheld.calls.is_empty());
    }

    #[test]
    fn a_call_of_an_own_client_is_passed_on_once() {
        let count = |own| {
            let mut withheld = kept(&[call(1, 1)], own);
            let steps = (0..50).flat_map(|nth| withheld.tend(view(nth * 100_000), |_| false)).collect::<Vec<_>>();
            steps.into_iter().filter(|step| matches!(step, Step::PassOn(_))).count()
        };
        assert_eq!((count(true), count(false)), (1, 0));
        let mut early = kept(&[call(1, 1)], true);
        assert!(!early.tend(view(PASS_ON_AFTER - 1), |_| false).iter().any(|step| matches!(step, Step::PassOn(_))));
    }

    #[test]
    fn a_node_passes_on_so_many_calls_a_second_and_an_organisation_leaves_the_others_room() {
        let mut withheld = Withheld::default();
        let mut passed = |from, elapsed| (0..1000).filter(|_| withheld.may_pass_on(from, elapsed)).count();
        assert_eq!((passed(2, SECOND), passed(2, SECOND + 1), passed(3, SECOND)), (32, 0, 32));
        assert_eq!(passed(2, 2 * SECOND), 32);
        let mut full = Withheld::default();
        for creator in 0..=CALLS_MAX {
            let mut body = call(0, 0).body().clone();
            body.creator = Hash::of(&[&creator.to_be_bytes()]).0.to_vec().into();
            let key = SigningKey::generate(KeyKind::Ed25519, &SystemRandom::new()).unwrap();
            full.keep(&Transaction::sign(&body, &key).unwrap(), Kind::Control, || "Org1".to_owned(), false, 0);
        }
        assert_eq!(full.calls.len(), CALLS_MAX);
        full.keep(&call(9, 9), Kind::Control, || "Org2".to_owned(), false, 0);
        assert!(full.calls.contains_key(&call(9, 9).creator()) && full.calls.len() == CALLS_MAX);
    }

    #[test]
    fn a_question_is_passed_on_sooner_becomes_control_then_and_is_complained_about_after_less_than_a_second() {
        let mut withheld = Withheld::default();
        let question = call(1, 1);
        withheld.keep(&question, Kind::Question, || "Org1".to_owned(), true, SECOND);
        let steps = |withheld: &mut Withheld, after| withheld.tend(view(after), |_| false);
        assert_eq!(steps(&mut withheld, 200_000), [], "the leader has it as data");
        let encoded = question.encoded().clone();
        assert_eq!(steps(&mut withheld, 250_000), [Step::PassOn(encoded.clone()), Step::Give(encoded)]);
        assert_eq!(steps(&mut withheld, 950_000), [], "it is control for 0.7 s");
        let complaint = [Step::Complain(Box::new(question))];
        assert_eq!(steps(&mut withheld, 1_000_000), complaint, "0.75 s");
    }
}
