//! A model of who has what, written apart from the product: lists, and one look at everything at the start of every block.
//!
//! It knows nothing of keys, indexes or times at which to look again. So it notices every turn that the product misses.

mod begin;
mod confirm;
mod contest;
mod pass_on;
mod tasks;

use crate::fleet::SECOND;
use confirm::Asking;
use ledger_base::rejection::Code;
use tasks::Task;
pub(crate) use tasks::{State, Wanted};

/// The services, by number: two that are driven, and the places of those who read the first one.
pub(crate) const DRIVEN: [usize; 2] = [0, 1];
pub(crate) const PLACES: usize = 2;
/// An admin of the owner, after five people.
pub(crate) const OWNER: usize = 5;
/// The priorities of the five.
pub(crate) const PRIORITIES: [i64; OWNER] = [0, 1, 1, 2, 3];
/// The lease of every grant.
const LEASE: u64 = 10 * SECOND;

/// The settings that the model knows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Settings {
    /// How many hold it at once; [`usize::MAX`] if everybody may.
    pub(crate) places: usize,
    /// How many read it at once, if its owner says so.
    pub(crate) readers: Option<usize>,
    pub(crate) conflict: Conflict,
    /// 0: no line.
    pub(crate) line: usize,
    pub(crate) patience: u64,
    pub(crate) aging: Option<u64>,
    pub(crate) min_hold: u64,
    pub(crate) confirm: Option<usize>,
    pub(crate) confirm_within: u64,
    pub(crate) delegable: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Conflict {
    Deny,
    Queue,
    Preempt,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Holder {
    pub(crate) who: usize,
    pub(crate) epoch: u64,
    priority: i64,
    /// Since when the service is held without a break.
    since: u64,
    expires: u64,
    /// It was taken whatever its rule says.
    taken: bool,
    /// The number of the task that it serves.
    pub(crate) task: Option<u64>,
    /// Those who passed it on, the first one first.
    givers: Vec<pass_on::Giver>,
    may_delegate: bool,
    ends_by: Option<u64>,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Waiter {
    pub(crate) who: usize,
    /// The number of the task that waits there.
    pub(crate) task: Option<u64>,
    priority: i64,
    since: u64,
    until: u64,
}

/// The answer to a call that was not refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Got {
    /// A grant with this epoch.
    Granted(u64),
    /// A place in line.
    Queued,
    /// Others must agree first.
    Pending,
    /// A task with this number.
    Task(u64, State),
    /// Something that needs no words.
    Done,
}

pub(crate) type Answer = Result<Got, Code>;

/// Something that can be had.
#[derive(Clone, Debug)]
pub(crate) struct Service {
    pub(crate) settings: Settings,
    /// Oldest grant first.
    pub(crate) holders: Vec<Holder>,
    /// In order of arrival.
    pub(crate) line: Vec<Waiter>,
    pub(crate) asking: Vec<Asking>,
    epoch: u64,
}

/// Everything.
#[derive(Clone, Debug)]
pub(crate) struct Model {
    pub(crate) services: Vec<Service>,
    /// Of each robot; a service that is driven has its robot's number.
    pub(crate) stopped: [bool; 2],
    /// Those whom a policy forbids everything.
    pub(crate) forbidden: Vec<usize>,
    pub(crate) tasks: Vec<Task>,
}

impl Model {
    pub(crate) fn new(settings: [Settings; 2]) -> Self {
        let service = |settings| Service { settings, holders: vec![], line: vec![], asking: vec![], epoch: 0 };
        let places = service(settings[0]);
        let services = settings.map(service).into_iter().chain([places]).collect();
        let mut model = Self { services, stopped: [false; 2], forbidden: vec![], tasks: vec![] };
        model.services[PLACES].settings = settings[0].for_readers();
        model
    }

    /// Is there such a thing now?
    pub(crate) fn exists(&self, at: usize) -> bool {
        at != PLACES || self.services[0].settings.readers.is_some()
    }

    fn find(&self, at: usize) -> Result<(), Code> {
        if self.exists(at) { Ok(()) } else { Err(Code::UnknownService) }
    }

    /// A reader is not stopped.
    fn goes(&self, at: usize) -> Result<(), Code> {
        if at != PLACES && self.stopped[at] { Err(Code::Stopped) } else { Ok(()) }
    }

    fn permits(&self, who: usize) -> Result<(), Code> {
        if self.forbidden.contains(&who) { Err(Code::DeniedByPolicy) } else { Ok(()) }
    }

    pub(crate) fn holder(&self, at: usize, who: usize) -> Option<&Holder> {
        self.services[at].holders.iter().find(|holder| holder.who == who)
    }

    fn give(&mut self, at: usize, who: usize, priority: i64, now: u64) -> u64 {
        let service = &mut self.services[at];
        service.epoch += 1;
        service.holders.push(Holder {
            who,
            epoch: service.epoch,
            priority,
            since: now,
            expires: now + LEASE,
            taken: false,
            task: None,
            givers: vec![],
            may_delegate: false,
            ends_by: None,
        });
        service.epoch
    }

    /// Ends grants, and the tasks that they serve.
    fn end(&mut self, at: usize, why: tasks::Why, now: u64, ends: impl Fn(&Holder) -> bool) {
        let holders = std::mem::take(&mut self.services[at].holders);
        let (ended, stay): (Vec<_>, Vec<_>) = holders.into_iter().partition(ends);
        self.services[at].holders = stay;
        for task in ended.into_iter().filter_map(|holder| holder.task) {
            self.interrupt(task, why, now);
        }
    }

    /// Somebody wants nothing of a service any more, for itself.
    fn leave(&mut self, at: usize, who: usize) -> bool {
        let service = &mut self.services[at];
        let before = service.line.len() + service.asking.len();
        service.line.retain(|waiter| waiter.who != who || waiter.task.is_some());
        service.asking.retain(|asking| asking.who != who);
        service.line.len() + service.asking.len() < before
    }

    pub(crate) fn renew(&mut self, at: usize, who: usize, now: u64) -> Answer {
        self.find(at)?;
        let own = self.holder(at, who).cloned().ok_or(Code::NotHolder)?;
        self.may_keep(&own)?;
        Ok(self.extend(at, who, now))
    }

    fn may_keep(&self, holder: &Holder) -> Result<(), Code> {
        if holder.taken {
            return Ok(());
        }
        self.permits(holder.who)?;
        holder.givers.iter().try_for_each(|giver| self.permits(giver.who))
    }

    fn extend(&mut self, at: usize, who: usize, now: u64) -> Got {
        let own = self.services[at].holders.iter_mut().find(|holder| holder.who == who).unwrap();
        own.expires = own.until(now);
        Got::Granted(own.epoch)
    }

    /// Use extends a lease of which more than a quarter is used up.
    fn used(&mut self, at: usize, who: usize, now: u64) {
        let Some(own) = self.services[at].holders.iter_mut().find(|holder| holder.who == who) else { return };
        if own.until(now).saturating_sub(own.expires) > LEASE / 4 {
            own.expires = own.until(now);
        }
    }

    pub(crate) fn publish(&mut self, at: usize, who: usize, now: u64) -> bool {
        let holds = self.holder(at, who).is_some();
        self.used(at, who, now);
        holds
    }

    /// Gives back what is held, or leaves the line.
    pub(crate) fn release(&mut self, at: usize, who: usize, now: u64) -> Answer {
        self.find(at)?;
        if self.holder(at, who).is_some() {
            self.end(at, tasks::Why::GivenBack, now, |holder| holder.who == who);
            return Ok(Got::Done);
        }
        if self.leave(at, who) {
            return Ok(Got::Done);
        }
        if who != OWNER {
            return Err(Code::NotHolder);
        }
        self.end(at, tasks::Why::Failed, now, |_| true);
        Ok(Got::Done)
    }

    pub(crate) fn revoke(&mut self, who: usize, now: u64) {
        for at in 0..self.services.len() {
            let is_theirs = |holder: &Holder| holder.who == who || holder.givers.iter().any(|giver| giver.who == who);
            self.end(at, tasks::Why::Failed, now, is_theirs);
            let service = &mut self.services[at];
            service.line.retain(|waiter| waiter.who != who);
            service.asking.retain(|asking| asking.who != who);
            service.asking.iter_mut().for_each(|asking| asking.confirmed.retain(|confirmed| *confirmed != who));
        }
        self.tasks_of(who, now);
    }

    /// The owner has a service, whatever its rule says.
    pub(crate) fn take(&mut self, at: usize, now: u64) -> Answer {
        self.find(at)?;
        self.goes(at)?;
        self.end(at, tasks::Why::Interrupted, now, |_| true);
        self.leave(at, OWNER);
        let epoch = self.give(at, OWNER, i64::MAX, now);
        self.services[at].holders[0].taken = true;
        Ok(Got::Granted(epoch))
    }

    pub(crate) fn stop(&mut self, robot: usize, now: u64) {
        if !std::mem::replace(&mut self.stopped[robot], true) {
            self.end(robot, tasks::Why::Interrupted, now, |_| true);
        }
    }

    pub(crate) fn set(&mut self, at: usize, settings: Settings, now: u64) {
        self.services[at].settings = settings;
        let mut changed = vec![at];
        if at == 0 {
            self.services[PLACES].settings = settings.for_readers();
            changed.push(PLACES);
        }
        for at in changed {
            // The oldest stay.
            let most = if self.exists(at) { self.services[at].settings.places } else { 0 };
            let stay: Vec<u64> = self.services[at].holders.iter().take(most).map(|holder| holder.epoch).collect();
            self.end(at, tasks::Why::Failed, now, |holder| !stay.contains(&holder.epoch));
        }
    }

    pub(crate) fn forbid(&mut self, forbidden: Vec<usize>, now: u64) {
        self.forbidden = forbidden;
        for at in 0..self.services.len() {
            let denied = |holder: &&Holder| self.may_keep(holder).is_err();
            let denied: Vec<u64> = self.services[at].holders.iter().filter(denied).map(|holder| holder.epoch).collect();
            self.end(at, tasks::Why::Failed, now, |holder| denied.contains(&holder.epoch));
        }
    }
}

impl Settings {
    /// The same, for the places of readers.
    fn for_readers(self) -> Self {
        Self { places: self.readers.unwrap_or(0), readers: None, ..self }
    }

    /// The priority of somebody who asks for a lower one, or does not.
    pub(crate) fn priority(&self, who: usize, less: i64) -> i64 {
        let own = if self.conflict == Conflict::Deny { 0 } else { PRIORITIES.get(who).copied().unwrap_or(0) };
        own - less
    }
}

impl Holder {
    /// When a lease that begins now ends.
    fn until(&self, now: u64) -> u64 {
        let bounds = self.givers.iter().filter_map(|giver| giver.ends_by).chain(self.ends_by);
        bounds.fold(now + LEASE, u64::min)
    }
}
