//! Random interleavings of passing a service on and of confirming contenders, beside everything else that ends a grant. The
//! judge follows the calls and keeps its own account of promises.

use crate::fleet::{Fleet, SECOND, TURTLEBOT, identity, owner};
use ledger_abac::{Acquired, Confirmation, Grant, LineState};
use ledger_identity::{Identity, Role};
use proptest::prelude::*;
use std::collections::{BTreeMap, BTreeSet};

#[derive(Clone, Debug)]
enum Step {
    Acquire(usize),
    Release(usize),
    Delegate { from: usize, to: usize, may_delegate: bool, seconds: Option<u64> },
    Handover { from: usize, to: usize },
    Recall(usize),
    Confirm { who: usize, contender: usize },
    Publish(usize),
    Revoke(usize),
    Forbid(Vec<usize>),
    Stop,
    Resume,
    Wait(u64),
    Restart,
}

impl Step {
    fn caller(&self) -> Option<usize> {
        match self {
            Self::Acquire(who) | Self::Release(who) | Self::Recall(who) | Self::Publish(who) => Some(*who),
            Self::Delegate { from: who, .. } | Self::Handover { from: who, .. } | Self::Confirm { who, .. } => {
                Some(*who)
            }
            _ => None,
        }
    }
}

const PEOPLE: usize = 5;
/// Confirmations that a contender needs, and their time.
const CONFIRM: usize = 2;
const CONFIRM_WITHIN: u64 = 8 * SECOND;

fn person(who: usize) -> Identity {
    identity("Org1", &format!("P{who}"), Role::Member, &["Turtlebot4", "safety"], 60 + who as u8)
}

fn name(who: usize) -> String {
    person(who).id()
}

fn steps() -> impl Strategy<Value = Vec<Step>> {
    let who = || 0..PEOPLE;
    let step = prop_oneof![
        5 => who().prop_map(Step::Acquire),
        2 => who().prop_map(Step::Release),
        5 => (who(), who(), any::<bool>(), prop::option::of(1_u64..20))
            .prop_map(|(from, to, may_delegate, seconds)| Step::Delegate { from, to, may_delegate, seconds }),
        1 => (who(), who()).prop_map(|(from, to)| Step::Handover { from, to }),
        3 => who().prop_map(Step::Recall),
        8 => (who(), who()).prop_map(|(who, contender)| Step::Confirm { who, contender }),
        3 => who().prop_map(Step::Publish),
        1 => who().prop_map(Step::Revoke),
        1 => prop::collection::vec(who(), 0..3).prop_map(Step::Forbid),
        1 => Just(Step::Stop),
        2 => Just(Step::Resume),
        3 => (1_u64..12).prop_map(Step::Wait),
        1 => Just(Step::Restart),
    ];
    prop::collection::vec(step, 1..120)
}

/// The account of what was promised.
#[derive(Default)]
struct Judge {
    newest: u64,
    revoked: BTreeSet<usize>,
    forbidden: BTreeSet<usize>,
    stopped: bool,
    /// Since when each one asks to be confirmed, and by whom it was.
    asks: BTreeMap<String, (u64, BTreeSet<usize>)>,
    /// Those who were confirmed, and wait in line since.
    in_line: BTreeSet<String>,
}

impl Judge {
    fn is_confirmed(&self, who: &str, now: u64) -> bool {
        self.asks.get(who).is_some_and(|(since, by)| {
            let others = by.iter().filter(|other| name(**other) != who && !self.revoked.contains(other));
            now < since + CONFIRM_WITHIN && others.count() >= CONFIRM
        })
    }

    /// The state after a block keeps every promise.
    fn look(&mut self, fleet: &Fleet, confirms: bool, since: usize) {
        let state = fleet.simulate(&owner(), "line", &[TURTLEBOT.into()]).unwrap();
        let state: LineState = serde_json::from_slice(&state).unwrap();
        assert!(state.holders.len() <= 1, "{state:?}");
        let mut ended = None;
        for event in &fleet.events[since..] {
            match event.name.as_str() {
                "released" => {
                    let told: ledger_abac::Released = serde_json::from_slice(&event.payload).unwrap();
                    ended = Some(told.epoch).filter(|_| told.goes_on);
                }
                "granted" => {
                    let grant: Grant = serde_json::from_slice(&event.payload).unwrap();
                    assert_eq!(grant.epoch, self.newest + 1, "no epoch comes twice: {grant:?}");
                    assert_eq!(grant.follows, ended, "it follows what ended in its block: {grant:?}");
                    let was_confirmed =
                        self.is_confirmed(&grant.holder, fleet.time) || self.in_line.contains(&grant.holder);
                    assert!(!confirms || was_confirmed, "nobody agreed: {grant:?}");
                    self.in_line.remove(&grant.holder);
                    self.asks.remove(&grant.holder);
                    self.newest = grant.epoch;
                }
                _ => {}
            }
        }
        for grant in &state.holders {
            let mut links: Vec<&String> = grant.givers.iter().chain([&grant.holder]).collect();
            let out = |id: &&String| {
                let who = (0..PEOPLE).find(|who| name(*who) == **id).unwrap();
                self.revoked.contains(&who) || self.forbidden.contains(&who)
            };
            assert!(!links.iter().any(out), "a link of the chain may not hold it: {grant:?}");
            assert!(!self.stopped, "{grant:?}");
            links.sort();
            links.dedup();
            assert_eq!(links.len(), grant.givers.len() + 1, "nobody is twice in a chain: {grant:?}");
        }
        self.in_line = state.line.into_iter().map(|place| place.contender).collect();
    }
}

fn run(steps: &[Step], sharing: &str, confirms: bool) {
    let mut fleet = Fleet::of_the_paper();
    fleet.members.1.lock().unwrap().extend((0..PEOPLE).map(person));
    fleet.ok(&owner(), "configure", &[TURTLEBOT, sharing]);
    let mut judge = Judge::default();
    for step in steps {
        // The ledger refuses calls by a revoked certificate before any chaincode hears of them.
        if step.caller().is_some_and(|who| judge.revoked.contains(&who)) {
            continue;
        }
        let since = fleet.events.len();
        match step {
            Step::Acquire(who) => {
                if let Ok(answer) = fleet.call(&person(*who), "acquire", &[TURTLEBOT.into()])
                    && let Acquired::Pending { pending } = serde_json::from_slice(&answer).unwrap()
                {
                    let asked = pending.until - CONFIRM_WITHIN;
                    let known = judge.asks.entry(name(*who)).or_insert_with(|| (asked, BTreeSet::new()));
                    if known.0 != asked {
                        *known = (asked, BTreeSet::new());
                    }
                }
            }
            Step::Release(who) => drop(fleet.call(&person(*who), "release", &[TURTLEBOT.into()])),
            Step::Delegate { from, to, may_delegate, seconds } => {
                let limit = seconds.map(|seconds| format!(r#","for_ms":{}"#, seconds * 1000)).unwrap_or_default();
                let options = format!(r#"{{"may_delegate":{may_delegate}{limit}}}"#);
                let args = [TURTLEBOT.into(), name(*to).into(), options.into()];
                drop(fleet.call(&person(*from), "delegate", &args));
            }
            Step::Handover { from, to } => {
                drop(fleet.call(&person(*from), "handover", &[TURTLEBOT.into(), name(*to).into()]));
            }
            Step::Recall(who) => drop(fleet.call(&person(*who), "recall", &[TURTLEBOT.into()])),
            Step::Confirm { who, contender } => {
                let args = [TURTLEBOT.into(), name(*contender).into()];
                if let Ok(answer) = fleet.call(&person(*who), "confirm", &args) {
                    assert_ne!(who, contender, "nobody confirms itself");
                    let told: Confirmation = serde_json::from_slice(&answer).unwrap();
                    let (_, by) = judge.asks.get_mut(&told.pending.contender).unwrap();
                    by.insert(*who);
                }
            }
            Step::Publish(who) => {
                let epoch = judge.newest;
                drop(fleet.set(&person(*who), TURTLEBOT, epoch, fleet.height, 1));
            }
            Step::Revoke(who) => {
                fleet.revoke(&person(*who));
                judge.revoked.insert(*who);
                fleet.members.1.lock().unwrap().retain(|known| known.id() != name(*who));
                judge.asks.remove(&name(*who));
            }
            Step::Forbid(who) => {
                let forbids =
                    who.iter().map(|who| format!("forbid (principal == User::\"{}\", action, resource);", name(*who)));
                let text = format!("permit (principal, action, resource);{}", forbids.collect::<String>());
                fleet.ok(&owner(), "policy", &["put", "p", &text]);
                judge.forbidden = who.iter().copied().collect();
            }
            Step::Stop => {
                fleet.ok(&owner(), "stop", &["Turtlebot4"]);
                judge.stopped = true;
            }
            Step::Resume => {
                fleet.ok(&owner(), "resume", &["Turtlebot4"]);
                judge.stopped = false;
            }
            Step::Wait(seconds) => {
                fleet.time += seconds * SECOND;
                fleet.tick();
            }
            Step::Restart => fleet.forget(),
        }
        judge.look(&fleet, confirms, since);
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 96, ..ProptestConfig::default() })]

    #[test]
    fn whatever_is_passed_on_has_one_holder_new_epochs_and_links_that_may_hold_it(steps in steps()) {
        run(&steps, r#"{"sharing":{"delegable":true}}"#, false);
        run(&steps, r#"{"sharing":{"delegable":true,"on_conflict":"queue"}}"#, false);
    }

    #[test]
    fn nobody_holds_a_service_that_too_few_others_have_agreed_to(steps in steps()) {
        run(&steps, r#"{"sharing":{"confirm":2,"confirm_within_ms":8000}}"#, true);
        run(&steps, r#"{"sharing":{"confirm":2,"confirm_within_ms":8000,"on_conflict":"queue"}}"#, true);
    }
}
