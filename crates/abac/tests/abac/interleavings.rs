//! Random interleavings of everything that decides who has a service, in blocks of one call and of several. The [`Model`] judges
//! them, and so does what must hold whatever the model says.

mod play;
mod steps;

use crate::fleet::{Fleet, bytes, owner, robot};
use crate::model::{DRIVEN, Model, OWNER, PLACES, Settings};
use ledger_abac::{Grant, LineState, Task, TaskTold};
use ledger_storage::result::Event;
use play::{ROBOTS, SERVICES, name, person, play, policy};
use proptest::prelude::*;
use std::collections::{BTreeMap, BTreeSet};
use steps::{Step, settings, step};

/// A network, the model of it, and what was seen of it.
struct Run {
    fleet: Fleet,
    model: Model,
    /// The last number of a message.
    seq: u64,
    /// The newest epoch of each service.
    newest: BTreeMap<String, u64>,
    /// Grants that have ended: service, holder, epoch.
    ended: BTreeSet<(usize, usize, u64)>,
}

impl Run {
    fn new(first: [Settings; 2]) -> Self {
        let mut fleet = Fleet::empty();
        fleet.members.1.lock().unwrap().extend((0..OWNER).map(|who| person(who).clone()));
        let robots = ROBOTS.map(|name| robot(name, "exclusive"));
        fleet.ok(&owner(), "setup", &[&robots[0], &robots[1]]);
        fleet.ok(&owner(), "policy", &["put", "p", &policy(&[])]);
        for at in DRIVEN {
            fleet.ok(&owner(), "configure", &[SERVICES[at], &steps::json(&first[at])]);
        }
        Self { fleet, model: Model::new(first), seq: 0, newest: BTreeMap::new(), ended: BTreeSet::new() }
    }

    /// Leaders order an empty block whenever a deadline has passed.
    fn tick_until(&mut self, until: u64) {
        while let Some(due) = self.fleet.next_deadline().filter(|due| *due <= until) {
            self.fleet.time = self.fleet.time.max(due.saturating_sub(1000));
            self.fleet.tick();
            self.model.begin(self.fleet.time);
        }
        self.fleet.time = self.fleet.time.max(until);
    }

    fn step(&mut self, joins: bool, step: &Step) {
        let joins = joins && !matches!(step, Step::Wait(_) | Step::Restart);
        let until = match step {
            Step::Wait(span) => self.fleet.time + span,
            _ => self.fleet.time,
        };
        let since = self.fleet.events.len();
        if !joins {
            self.tick_until(until);
        }
        let lines: Vec<LineState> = [0, 1].map(|at| self.line(at)).into();
        play(self, joins, step);
        self.epochs_only_grow(since);
        self.agrees_with_the_model(step);
        self.nobody_is_forgotten(since, &lines, joins, step);
        self.nothing_old_passes();
    }

    fn line(&self, at: usize) -> LineState {
        serde_json::from_slice(&self.fleet.simulate(person(OWNER), "line", &bytes(&[SERVICES[at]])).unwrap()).unwrap()
    }

    fn epochs_only_grow(&mut self, since: usize) {
        for event in self.fleet.events[since..].iter().filter(|event| event.name == "granted") {
            let grant: Grant = serde_json::from_slice(&event.payload).unwrap();
            let before = self.newest.insert(grant.service, grant.epoch).unwrap_or(0);
            assert!(grant.epoch > before, "epoch {} after {before}", grant.epoch);
        }
    }

    fn agrees_with_the_model(&mut self, step: &Step) {
        for at in [0, 1, PLACES].into_iter().filter(|at| self.model.exists(*at)) {
            let (state, model) = (self.line(at), &self.model.services[at]);
            let most = model.settings.places;
            assert!(state.holders.len() <= most, "{} holders of {most} after {step:?}", state.holders.len());
            let stopped = at != PLACES && self.model.stopped[at];
            assert!(!stopped || state.holders.is_empty(), "{} is held and stopped", SERVICES[at]);
            let holders: Vec<_> =
                state.holders.iter().map(|grant| (grant.holder.clone(), grant.epoch, grant.task)).collect();
            let wanted: Vec<_> =
                model.holders.iter().map(|holder| (name(holder.who), holder.epoch, holder.task)).collect();
            assert_eq!(holders, wanted, "holders of {} after {step:?}", SERVICES[at]);
            let mut line: Vec<_> = state.line.iter().map(|place| (place.contender.clone(), place.task)).collect();
            let mut wanted: Vec<_> = model.line.iter().map(|waiter| (name(waiter.who), waiter.task)).collect();
            line.sort();
            wanted.sort();
            assert_eq!(line, wanted, "line of {} after {step:?}", SERVICES[at]);
            let mut pending: Vec<_> = state.pending.iter().map(|asking| asking.contender.clone()).collect();
            let until = self.fleet.time;
            let asks = model.asking.iter().filter(|asking| asking.until > until);
            let mut wanted: Vec<_> = asks.map(|asking| name(asking.who)).collect();
            pending.sort();
            wanted.sort();
            assert_eq!(pending, wanted, "who waits to be confirmed for {} after {step:?}", SERVICES[at]);
        }
        let tasks: Vec<Task> =
            serde_json::from_slice(&self.fleet.simulate(person(OWNER), "tasks", &[]).unwrap()).unwrap();
        let found: Vec<_> =
            tasks.iter().map(|task| (task.id, task.submitter.clone(), task.state.known(), task.reached)).collect();
        let kept = (1..=self.model.tasks.len() as u64).filter_map(|id| Some((id, self.model.kept(id).ok()?)));
        let wanted: Vec<_> = kept.map(|(id, task)| (id, name(task.who), Some(task.state), task.reached)).collect();
        assert_eq!(found, wanted, "tasks after {step:?}");
        let held: BTreeSet<_> = [0, 1, PLACES]
            .into_iter()
            .flat_map(|at| self.model.services[at].holders.iter().map(move |holder| (at, holder.who, holder.epoch)))
            .collect();
        self.ended.retain(|grant| !held.contains(grant));
        let granted = self.fleet.events.iter().filter(|event| event.name == "granted").rev().take(8);
        for grant in granted.map(|event| serde_json::from_slice::<Grant>(&event.payload).unwrap()) {
            let at = SERVICES.iter().position(|service| **service == grant.service).unwrap();
            let who = (0..=OWNER).find(|who| name(*who) == grant.holder).unwrap();
            if !held.contains(&(at, who, grant.epoch)) {
                self.ended.insert((at, who, grant.epoch));
            }
        }
        while self.ended.len() > 8 {
            self.ended.pop_first();
        }
    }

    /// A contender that waited waits, has the service, or was told why not.
    fn nobody_is_forgotten(&self, since: usize, before: &[LineState], joins: bool, step: &Step) {
        let told = |name: &str, who: &str, task: Option<u64>, service: &str| {
            let about = |event: &&Event| event.name == name && event.subject == service;
            self.fleet.events[since..].iter().filter(about).any(|event| match task {
                None => String::from_utf8_lossy(&event.payload).contains(&format!("\"{who}\"")),
                Some(id) => name == "task" && serde_json::from_slice::<TaskTold>(&event.payload).unwrap().id == id,
            })
        };
        for (at, before) in before.iter().enumerate() {
            let after = self.line(at);
            for place in &before.line {
                let waits =
                    after.line.iter().any(|other| other.contender == place.contender && other.task == place.task);
                let heard = ["granted", "left", "task"]
                    .iter()
                    .any(|name| told(name, &place.contender, place.task, SERVICES[at]));
                assert!(waits || heard, "{place:?} is forgotten after {step:?} (joins: {joins})");
            }
        }
    }

    /// No grant that has ended lets anybody publish.
    fn nothing_old_passes(&self) {
        for (at, who, epoch) in self.ended.iter().filter(|(at, ..)| *at != PLACES) {
            let (epoch, seq) = (epoch.to_string(), (self.seq + 1).to_string());
            let mut args = bytes(&[SERVICES[*at], &epoch, &seq]);
            args.push(bytes::Bytes::from_static(&crate::fleet::TWIST));
            let passed = self.fleet.simulate(person(*who), "set", &args);
            assert!(passed.is_err(), "{} publishes on {} with epoch {epoch}", name(*who), SERVICES[*at]);
        }
    }
}

fn two() -> impl Strategy<Value = [Settings; 2]> {
    [settings(true), settings(false)]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 256, ..ProptestConfig::default() })]

    #[test]
    fn holders_lines_and_tasks_are_those_of_the_model_at_every_height(
        first in two(),
        steps in prop::collection::vec((prop::bool::weighted(0.3), step()), 1..120),
    ) {
        let mut run = Run::new(first);
        for (joins, step) in &steps {
            run.step(*joins, step);
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 4, max_shrink_iters: 200, ..ProptestConfig::default() })]

    #[test]
    fn thousands_of_calls_leave_nothing_behind_that_the_model_does_not_know(
        first in two(),
        steps in prop::collection::vec((prop::bool::weighted(0.3), step()), 2000..2001),
    ) {
        let mut run = Run::new(first);
        for (joins, step) in &steps {
            run.step(*joins, step);
        }
    }
}
