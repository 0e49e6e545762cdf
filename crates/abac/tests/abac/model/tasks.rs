//! Tasks: they wait in line like contenders, and their submitters hold the service while they run.

use super::{Answer, Got, Model, OWNER, PLACES, Waiter};
use ledger_abac::TaskState;
use ledger_base::rejection::Code;

/// How many tasks of a service that have ended are kept.
const ENDED_KEPT: usize = 16;

pub(crate) type State = TaskState;

/// Why a grant ended, as far as a task minds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Why {
    GivenBack,
    Interrupted,
    Failed,
}

/// The task that somebody submits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Wanted {
    pub(crate) points: u64,
    pub(crate) less: i64,
    /// From now on.
    pub(crate) not_before: Option<u64>,
    /// From now on.
    pub(crate) deadline: Option<u64>,
    pub(crate) requeue: bool,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Task {
    id: u64,
    pub(crate) at: usize,
    pub(crate) who: usize,
    pub(crate) state: State,
    pub(crate) reached: u64,
    total: u64,
    priority: i64,
    requeue: bool,
    begun: bool,
    /// When it joins the line.
    joins: Option<u64>,
    deadline: Option<u64>,
    ended: Option<u64>,
}

impl Task {
    pub(super) fn end(&mut self, state: State, now: u64) {
        (self.state, self.joins, self.ended) = (state, None, Some(now));
    }

    fn told(&self) -> Got {
        Got::Task(self.id, self.state)
    }
}

impl Model {
    pub(super) fn task(&mut self, id: u64) -> &mut Task {
        &mut self.tasks[id as usize - 1]
    }

    /// A task that is still kept.
    pub(crate) fn kept(&self, id: u64) -> Result<Task, Code> {
        let task = self.tasks.get((id as usize).wrapping_sub(1)).cloned().ok_or(Code::NotFound)?;
        let newer = |other: &&Task| other.at == task.at && (other.ended, other.id) > (task.ended, task.id);
        let is_old = task.ended.is_some() && self.tasks.iter().filter(newer).count() >= ENDED_KEPT;
        if is_old { Err(Code::NotFound) } else { Ok(task) }
    }

    pub(crate) fn submit(&mut self, at: usize, who: usize, wanted: &Wanted, now: u64) -> Answer {
        self.find(at)?;
        let starts = now + wanted.not_before.unwrap_or(0);
        if at == PLACES || wanted.deadline.is_some_and(|deadline| now + deadline <= starts) {
            return Err(Code::BadArgument);
        }
        self.permits(who)?;
        self.goes(at)?;
        let settings = self.services[at].settings;
        if settings.confirm.is_some() {
            return Err(Code::BadArgument);
        }
        let (id, later) = (self.tasks.len() as u64 + 1, starts > now);
        let task = Task {
            id,
            at,
            who,
            state: if later { State::Scheduled } else { State::Waiting },
            reached: 0,
            total: wanted.points,
            priority: settings.priority(who, wanted.less),
            requeue: wanted.requeue,
            begun: false,
            joins: later.then_some(starts),
            deadline: wanted.deadline.map(|deadline| now + deadline),
            ended: None,
        };
        if !later {
            self.enter_task(&task, now)?;
        }
        self.tasks.push(task);
        if !later && self.services[at].line.iter().all(|waiter| waiter.task != Some(id)) {
            self.runs(at, id);
        }
        Ok(self.task(id).told())
    }

    /// A new task takes its place: that of a holder, or the last one in line.
    fn enter_task(&mut self, task: &Task, now: u64) -> Result<(), Code> {
        let (at, who, settings) = (task.at, task.who, self.services[task.at].settings);
        let index = self.services[at].line.len();
        self.services[at].line.push(Waiter { task: Some(task.id), ..waiter(task, settings.patience, now) });
        let place = self.services[at].place(index, now).filter(|_| self.holder(at, who).is_none());
        if let Some(victim) = place {
            self.services[at].line.pop();
            self.end(at, Why::Interrupted, now, |holder| Some(holder.epoch) == victim);
            self.give(at, who, task.priority, now);
        } else if index >= settings.line {
            self.services[at].line.pop();
            return Err(if settings.line == 0 { Code::Held } else { Code::LineFull });
        }
        Ok(())
    }

    /// The newest grant serves a task.
    pub(super) fn runs(&mut self, at: usize, id: u64) {
        self.services[at].holders.last_mut().unwrap().task = Some(id);
        let task = self.task(id);
        (task.state, task.begun) = (State::Running, true);
    }

    /// The grant of a running task has ended.
    pub(super) fn interrupt(&mut self, id: u64, why: Why, now: u64) {
        let task = self.task(id);
        match why {
            _ if task.state != State::Running => {}
            Why::GivenBack => task.end(State::Cancelled, now),
            Why::Interrupted if task.requeue => (task.state, task.joins) = (State::Waiting, Some(now)),
            Why::Interrupted => task.end(State::Preempted, now),
            Why::Failed => task.end(State::Failed, now),
        }
    }

    /// The rule has no place for a task.
    pub(super) fn beyond_the_rule(&mut self, id: u64, now: u64) {
        let task = self.task(id);
        task.end(if task.begun { State::Preempted } else { State::Failed }, now);
    }

    fn conclude(&mut self, id: u64, state: State, now: u64) -> Answer {
        let task = self.task(id);
        task.end(state, now);
        let (at, told) = (task.at, task.told());
        self.services[at].line.retain(|waiter| waiter.task != Some(id));
        self.end(at, Why::Failed, now, |holder| holder.task == Some(id));
        Ok(told)
    }

    /// Tasks whose time has come join the line, those whose deadline has passed expire.
    pub(super) fn tasks_join(&mut self, at: usize, now: u64) {
        let open = self.tasks.iter().filter(|task| task.at == at && task.ended.is_none());
        let next = |task: &Task| Some((task.joins.into_iter().chain(task.deadline).min()?, task.id));
        let mut due: Vec<(u64, u64)> = open.filter_map(next).filter(|(time, _)| *time <= now).collect();
        due.sort_unstable();
        for (_, id) in due {
            let task = self.task(id).clone();
            let settings = self.services[at].settings;
            if task.deadline.is_some_and(|deadline| deadline <= now) {
                self.conclude(id, State::Expired, now).unwrap();
            } else if settings.confirm.is_some() {
                self.conclude(id, State::Failed, now).unwrap();
            } else {
                (self.task(id).state, self.task(id).joins) = (State::Waiting, None);
                self.services[at].line.push(waiter(&task, settings.patience, now));
            }
        }
    }

    /// A certificate was revoked.
    pub(super) fn tasks_of(&mut self, who: usize, now: u64) {
        let theirs = self.tasks.iter_mut().filter(|task| task.who == who && task.ended.is_none());
        theirs.for_each(|task| task.end(State::Failed, now));
    }

    /// The running task that somebody reports about: its submitter, or the robot.
    fn reported(&self, by: Option<usize>, id: u64) -> Result<Task, Code> {
        let task = self.kept(id)?;
        if by.is_some_and(|by| by != task.who) {
            return Err(Code::NotOwner);
        }
        if task.state == State::Running { Ok(task) } else { Err(Code::BadArgument) }
    }

    pub(crate) fn progress(&mut self, by: Option<usize>, id: u64, reached: u64, now: u64) -> Answer {
        let Task { at, who, reached: before, total, .. } = self.reported(by, id)?;
        if reached < before || reached > total {
            return Err(Code::BadArgument);
        }
        self.task(id).reached = reached;
        if reached == total {
            return self.conclude(id, State::Done, now);
        }
        self.used(at, who, now);
        Ok(self.task(id).told())
    }

    pub(crate) fn fail(&mut self, by: Option<usize>, id: u64, now: u64) -> Answer {
        self.reported(by, id)?;
        self.conclude(id, State::Failed, now)
    }

    pub(crate) fn cancel(&mut self, who: usize, id: u64, now: u64) -> Answer {
        let task = self.kept(id)?;
        if who != task.who && who != OWNER {
            return Err(Code::NotOwner);
        }
        if task.ended.is_some() { Err(Code::BadArgument) } else { self.conclude(id, State::Cancelled, now) }
    }
}

fn waiter(task: &Task, patience: u64, now: u64) -> Waiter {
    Waiter { who: task.who, task: Some(task.id), priority: task.priority, since: now, until: now + patience }
}
