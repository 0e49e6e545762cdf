//! Tasks: points for a robot. A task waits in line like a contender, and its submitter holds the service while it runs.

use super::contest::Waiter;
use super::ends::Why;
use super::grants::check_lease;
use super::services::{Robot, Service};
use super::{Judged, Model, Verdict};
use crate::people::Person;
use ledger_base::rejection::Code;
use ledger_identity::Role;
use serde::Deserialize;

/// Most tasks that have not ended: of a certificate, and of a service.
const OPEN_MAX: usize = 64;
const OPEN_OF_A_SERVICE_MAX: usize = 1024;
/// How many tasks of a service that have ended are kept.
const ENDED_KEPT: usize = 16;

/// How far a task is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(in crate::oracle) enum State {
    Scheduled,
    Waiting,
    Running,
    Done,
    Failed,
    Cancelled,
    Preempted,
    Expired,
}

/// A task.
#[derive(Clone, Debug)]
pub(in crate::oracle) struct Task {
    id: u64,
    pub(in crate::oracle) service: String,
    /// Index among the people: the certificate with which it was submitted.
    person: usize,
    pub(in crate::oracle) submitter: String,
    pub(in crate::oracle) state: State,
    pub(in crate::oracle) reached: u64,
    pub(in crate::oracle) total: u64,
    priority: i64,
    lease_ms: Option<u64>,
    pub(super) requeue: bool,
    /// Did it ever run?
    begun: bool,
    deadline: Option<u64>,
    /// When it joins the line (block time, microseconds), if it is not there yet.
    pub(super) joins: Option<u64>,
    /// Block time, microseconds.
    ended: Option<u64>,
}

#[derive(Deserialize)]
struct Spec {
    points: Vec<serde_json::Value>,
    priority: Option<i64>,
    not_before: Option<u64>,
    deadline: Option<u64>,
    lease_ms: Option<u64>,
    #[serde(default)]
    requeue: bool,
}

impl Task {
    pub(super) fn end(&mut self, state: State, time: u64) {
        (self.state, self.joins, self.ended) = (state, None, Some(time));
    }

    fn told(&self) -> Judged {
        Judged { task: Some((self.id, self.state, self.reached)), ..Code::Ok.into() }
    }
}

impl Person {
    /// Is it the robot of that owner and name?
    pub(super) fn is_robot(&self, owner: &str, name: &str) -> bool {
        let own = (&*self.identity.organisation, &*self.identity.name);
        self.identity.role == Role::Robot && own == (owner, name)
    }
}

impl Model {
    /// Every task, the one with number 1 first.
    pub(in crate::oracle) fn tasks(&self) -> &[Task] {
        &self.tasks
    }

    pub(super) fn task_mut(&mut self, id: u64) -> Option<&mut Task> {
        self.tasks.get_mut((id as usize).checked_sub(1)?)
    }

    fn told_of(&self, id: u64) -> Judged {
        let task = (id as usize).checked_sub(1).and_then(|at| self.tasks.get(at));
        task.map_or(Code::NotFound.into(), Task::told)
    }

    /// A task that the ledger remembers.
    fn known_task(&self, id: Option<u64>) -> Result<Task, Code> {
        let id = id.unwrap_or(0);
        let task = (id as usize).checked_sub(1).and_then(|at| self.tasks.get(at)).ok_or(Code::NotFound)?;
        let later = |other: &&Task| other.service == task.service && (other.ended, other.id) > (task.ended, task.id);
        if task.ended.is_some() && self.tasks.iter().filter(later).count() >= ENDED_KEPT {
            return Err(Code::NotFound);
        }
        Ok(task.clone())
    }

    pub(super) fn submit(&mut self, (who, person): (&Person, usize), id: &str, json: &str, time: u64) -> Verdict {
        let (robot, service) = self.find(id)?;
        if service.reads {
            return Err(Code::BadArgument);
        }
        let spec: Spec = serde_json::from_str(json).map_err(|_| Code::BadArgument)?;
        let starts = spec.not_before.unwrap_or(0).max(time);
        let is_late = spec.deadline.is_some_and(|deadline| deadline <= starts);
        let outlives = spec.not_before.is_some_and(|starts| starts >= who.identity.not_after);
        if spec.points.is_empty() || is_late || outlives {
            return Err(Code::BadArgument);
        }
        check_lease(&service, spec.lease_ms)?;
        self.permits(who, &robot, &service, time)?;
        self.goes(&robot, &service)?;
        if service.setting("confirm").is_some() {
            return Err(Code::BadArgument);
        }
        let open = || self.tasks.iter().filter(|task| task.ended.is_none());
        let of_service = open().filter(|task| task.service == id).count();
        if open().filter(|task| task.person == person).count() >= OPEN_MAX || of_service >= OPEN_OF_A_SERVICE_MAX {
            return Err(Code::LimitExceeded);
        }
        let task = Task {
            id: self.tasks.len() as u64 + 1,
            service: id.to_owned(),
            person,
            submitter: who.id(),
            state: if starts > time { State::Scheduled } else { State::Waiting },
            reached: 0,
            total: spec.points.len() as u64,
            priority: service.priority(who, &robot, spec.priority),
            lease_ms: spec.lease_ms,
            requeue: spec.requeue,
            begun: false,
            deadline: spec.deadline,
            joins: (starts > time).then_some(starts),
            ended: None,
        };
        self.tasks.push(task.clone());
        if task.joins.is_some() {
            return Ok(task.told());
        }
        let told = self.enter_task(who, &service, &task, time)?;
        Ok(Judged { task: self.told_of(task.id).task, ..told })
    }

    /// A task that is not scheduled runs, waits, or is refused.
    fn enter_task(&mut self, who: &Person, service: &Service, task: &Task, time: u64) -> Verdict {
        let id = &task.service;
        let waiter = self.waiter(task, service, time);
        let mut line = self.line(id).to_vec();
        line.push(waiter.clone());
        let at = line.len() - 1;
        let live = self.live(id, time);
        let holds = live.iter().any(|grant| grant.holder == who.id());
        let is_first = service.is_open() || service.first(&line, &live, time) == Some(at);
        if let Some(loser) = service.place(&live, &waiter, time).filter(|_| is_first && !holds) {
            self.end_epoch(id, loser, Why::Interrupted, time);
            return Ok(self.run(who, task.id, time));
        }
        if service.line_max() == 0 {
            return Err(Code::Held);
        }
        if at >= service.line_max() {
            return Err(Code::LineFull);
        }
        let place = Some(service.told(&line, at, time));
        self.lines.insert(id.clone(), line);
        Ok(Judged { place, ..Code::Ok.into() })
    }

    /// The place of a task that joins the line now.
    fn waiter(&self, task: &Task, service: &Service, time: u64) -> Waiter {
        let not_after = self.people.all[task.person].identity.not_after;
        Waiter {
            who: task.submitter.clone(),
            person: task.person,
            priority: task.priority,
            since: time,
            until: (time + service.patience_ms() * 1000).min(not_after),
            lease_ms: task.lease_ms,
            task: Some(task.id),
        }
    }

    /// The turn of a task has come.
    pub(super) fn run(&mut self, who: &Person, id: u64, time: u64) -> Judged {
        let Some(task) = self.task_mut(id) else { return Code::NotFound.into() };
        (task.state, task.joins, task.begun) = (State::Running, None, true);
        let (service, lease_ms, priority) = (task.service.clone(), task.lease_ms, task.priority);
        let Ok((_, found)) = self.find(&service) else { return Code::UnknownService.into() };
        let lease_ms = lease_ms.unwrap_or(found.lease_ms).min(found.lease_ms_max);
        let judged = self.give(who, &service, lease_ms, priority, time);
        let given = self.grants.get_mut(&service).and_then(|grants| grants.last_mut());
        given.into_iter().for_each(|grant| grant.task = Some(id));
        judged
    }

    /// Ends a task, with its grant or its place in line.
    fn conclude(&mut self, id: u64, state: State, time: u64) {
        let Some(task) = self.task_mut(id) else { return };
        task.end(state, time);
        let service = task.service.clone();
        self.lines.entry(service.clone()).or_default().retain(|waiter| waiter.task != Some(id));
        self.end_of(&service, Why::Failed, time, |grant| grant.task == Some(id));
    }

    /// The place of a task is gone, and it got no grant for it.
    pub(super) fn lost_its_place(&mut self, id: u64, state: State, time: u64) {
        if let Some(task) = self.task_mut(id) {
            task.end(state, time);
        }
    }

    /// The rule has no place for a task. One that ran before was interrupted; another one has failed.
    pub(super) fn lost_to_the_rule(&mut self, id: u64, time: u64) {
        let begun = self.task_mut(id).is_some_and(|task| task.begun);
        self.lost_its_place(id, if begun { State::Preempted } else { State::Failed }, time);
    }

    /// Tasks of a service whose time has come join its line; those whose deadline has passed expire.
    pub(super) fn tasks_join(&mut self, id: &str, service: &Service, time: u64) {
        let next = |task: &Task| task.joins.into_iter().chain(task.deadline).min();
        let mut due: Vec<(u64, u64)> = Vec::new();
        for task in self.tasks.iter().filter(|task| task.service == id && task.ended.is_none()) {
            due.extend(next(task).filter(|at| *at <= time).map(|at| (at, task.id)));
        }
        due.sort_unstable();
        for (_, number) in due {
            let Some(task) = self.task_mut(number) else { continue };
            if task.deadline.is_some_and(|deadline| deadline <= time) {
                self.conclude(number, State::Expired, time);
            } else if service.setting("confirm").is_some() {
                self.conclude(number, State::Failed, time);
            } else {
                (task.state, task.joins) = (State::Waiting, None);
                let task = task.clone();
                let waiter = self.waiter(&task, service, time);
                self.lines.entry(id.to_owned()).or_default().push(waiter);
            }
        }
    }

    /// These certificates have no tasks any more.
    pub(super) fn tasks_without(&mut self, is_gone: impl Fn(usize) -> bool, time: u64) {
        let gone = self.tasks.iter_mut().filter(|task| task.ended.is_none() && is_gone(task.person));
        gone.for_each(|task| task.end(State::Failed, time));
    }

    /// The task about which its submitter or the robot reports, with its grant.
    fn reported(&self, who: &Person, id: Option<u64>, time: u64) -> Result<(Task, super::Grant), Code> {
        let task = self.known_task(id)?;
        let robot: Option<&Robot> = task.service.split('/').next().and_then(|name| self.robots.get(name));
        let is_robot = robot.is_some_and(|robot| who.is_robot(&robot.owner, &robot.name));
        if who.id() != task.submitter && !is_robot {
            return Err(Code::NotOwner);
        }
        let served = self.live(&task.service, time).into_iter().find(|grant| grant.task == Some(task.id));
        Ok((task, served.ok_or(Code::BadArgument)?))
    }

    pub(super) fn progress(&mut self, who: &Person, id: Option<u64>, reached: Option<u64>, time: u64) -> Verdict {
        let (task, grant) = self.reported(who, id, time)?;
        let reached = reached.unwrap_or(0);
        if reached < task.reached || reached > task.total {
            return Err(Code::BadArgument);
        }
        if let Some(task) = self.task_mut(task.id) {
            task.reached = reached;
        }
        if reached == task.total {
            self.conclude(task.id, State::Done, time);
        } else {
            self.used(&task.service, &grant, time);
        }
        Ok(self.told_of(task.id))
    }

    pub(super) fn fail(&mut self, who: &Person, id: Option<u64>, time: u64) -> Verdict {
        let (task, _) = self.reported(who, id, time)?;
        self.conclude(task.id, State::Failed, time);
        Ok(self.told_of(task.id))
    }

    pub(super) fn cancel(&mut self, who: &Person, id: Option<u64>, time: u64) -> Verdict {
        let task = self.known_task(id)?;
        let name = task.service.split('/').next().unwrap_or_default();
        let owner = self.robots.get(name).map(|robot| robot.owner.clone());
        let is_owner = who.identity.role == Role::Admin && Some(&who.identity.organisation) == owner.as_ref();
        if who.id() != task.submitter && !is_owner {
            return Err(Code::NotOwner);
        }
        if task.ended.is_some() {
            return Err(Code::BadArgument);
        }
        self.conclude(task.id, State::Cancelled, time);
        Ok(self.told_of(task.id))
    }
}
