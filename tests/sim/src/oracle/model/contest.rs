//! The contest where several want a service: places, lines, priorities; robots that are stopped. Lists, and one look at
//! everything at the start of every block.

use super::ends::Why;
use super::tasks::State;
use super::{Grant, Judged, Model, Robot, Service, Verdict};
use crate::people::Person;
use ledger_base::hash::Hash;
use ledger_base::rejection::Code;
use serde::Deserialize;
use serde_json::{Map, Value};

/// The priority of a grant that was taken.
const TAKEN: i64 = i64::MAX;
/// How many wait at most, and how long (milliseconds), unless the owner says otherwise.
const LINE_MAX: u64 = 64;
const PATIENCE_MS: u64 = 600_000;

/// A contender in line.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(in crate::oracle) struct Waiter {
    pub(in crate::oracle) who: String,
    /// Index among the people: the certificate with which it asked last.
    pub(super) person: usize,
    pub(super) priority: i64,
    pub(super) since: u64,
    pub(super) until: u64,
    pub(super) lease_ms: Option<u64>,
    /// The task that waits there, if it is one.
    pub(in crate::oracle) task: Option<u64>,
}

/// Does a contender come by itself, or because the last one has confirmed it?
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Stage {
    Asks,
    Confirmed,
}

/// The wishes of `acquire` besides the service.
#[derive(Clone, Default, Deserialize)]
pub(super) struct Wishes {
    pub(super) lease_ms: Option<u64>,
    wait_ms: Option<u64>,
    priority: Option<i64>,
}

impl Wishes {
    /// The same, for one that does not wait.
    pub(super) fn at_once(&self) -> Self {
        Self { wait_ms: Some(0), ..self.clone() }
    }
}

#[derive(Deserialize)]
struct Settings {
    mode: String,
    sharing: Map<String, Value>,
    clear: Vec<String>,
}

impl Service {
    /// May a holder pass its grant on?
    pub(super) fn is_delegable(&self) -> bool {
        self.sharing.get("delegable").and_then(Value::as_bool).unwrap_or(false)
    }

    fn conflict(&self) -> &str {
        self.sharing.get("on_conflict").and_then(Value::as_str).unwrap_or("deny")
    }

    pub(super) fn line_max(&self) -> usize {
        let unless = if self.conflict() == "queue" { LINE_MAX } else { 0 };
        self.setting("queue_max").unwrap_or(unless) as usize
    }

    /// How long one waits at most, milliseconds.
    pub(super) fn patience_ms(&self) -> u64 {
        self.setting("queue_wait_max_ms").unwrap_or(PATIENCE_MS)
    }

    /// The priority of a person, who may want a lower one.
    pub(super) fn priority(&self, who: &Person, robot: &Robot, wanted: Option<i64>) -> i64 {
        let source = self.sharing.get("priority").and_then(Value::as_str).unwrap_or("fixed:0");
        let own = match source.split_once(':') {
            Some(("fixed", number)) => number.parse().unwrap_or(0),
            Some((_, name)) if robot.trusted.contains(&who.identity.organisation) => {
                who.identity.attributes.get(name).and_then(|value| value.parse().ok()).unwrap_or(0)
            }
            _ => 0,
        };
        wanted.map_or(own, |wanted| own.min(wanted))
    }

    /// How much waiting is worth: whole steps, and exactly.
    fn worth(&self, waiter: &Waiter, time: u64) -> (i64, i128) {
        let waited = time - waiter.since;
        let Some(aging) = self.setting("aging_ms").map(|ms| ms * 1000) else {
            return (waiter.priority, i128::from(waiter.priority));
        };
        let exact = i128::from(waiter.priority) * i128::from(aging) + i128::from(waited);
        (waiter.priority + (waited / aging) as i64, exact)
    }

    /// The first of a line. A holder of the service is passed over until that ends.
    pub(super) fn first(&self, line: &[Waiter], live: &[Grant], time: u64) -> Option<usize> {
        let holds = |waiter: &Waiter| live.iter().any(|grant| grant.holder == waiter.who);
        let worth = |at: usize| self.worth(&line[at], time).1;
        let waits = (0..line.len()).filter(|at| !holds(&line[*at]));
        waits.reduce(|best, other| if worth(other) > worth(best) { other } else { best })
    }

    /// A place in line as its contender hears of it: position, priority, and until when.
    pub(super) fn told(&self, line: &[Waiter], at: usize, time: u64) -> (u64, i64, u64) {
        let order = self.order(line, time);
        let position = order.iter().position(|other| *other == at).unwrap_or(0) as u64 + 1;
        (position, line[at].priority, line[at].until)
    }

    /// The line in the order of its turns.
    pub(in crate::oracle) fn order(&self, line: &[Waiter], time: u64) -> Vec<usize> {
        let mut order: Vec<usize> = (0..line.len()).collect();
        order.sort_by_key(|at| std::cmp::Reverse(self.worth(&line[*at], time).1));
        order
    }

    /// The place for one that is the first, and who loses it: nobody if one is free.
    pub(super) fn place(&self, holders: &[Grant], waiter: &Waiter, time: u64) -> Option<Option<u64>> {
        if holders.len() < self.places() {
            return Some(None);
        }
        if self.conflict() != "preempt" {
            return None;
        }
        let held = self.setting("min_hold_ms").unwrap_or(0) * 1000;
        let worth = self.worth(waiter, time).0;
        let weaker = holders.iter().filter(|grant| grant.priority < worth && grant.since + held <= time);
        // Of the weakest the newest.
        let victim = weaker.min_by_key(|grant| (grant.priority, u64::MAX - grant.epoch))?;
        Some(Some(victim.epoch))
    }
}

impl Model {
    /// The line of a service, in order of arrival.
    pub(in crate::oracle) fn line(&self, service: &str) -> &[Waiter] {
        self.lines.get(service).map_or(&[], Vec::as_slice)
    }

    /// The start of a block: who waited too long leaves, and turns come.
    pub(super) fn turns(&mut self, time: u64) {
        self.asks_until(time);
        let ids: Vec<String> = self.robots.values().flat_map(Robot::ids).collect();
        for id in &ids {
            let Ok((_, service)) = self.find(id) else {
                // Nobody needs a place there any more.
                self.lines.remove(id);
                continue;
            };
            self.tasks_join(id, &service, time);
            self.send_away(id, &service, time);
        }
        for id in &ids {
            while self.turn(id, time) {}
        }
        self.lines.retain(|_, line| !line.is_empty());
    }

    /// Those who waited too long leave the line, and those for whom it has no room any more.
    fn send_away(&mut self, id: &str, service: &Service, time: u64) {
        let most = service.line_max();
        let (mut stay, mut late, mut beyond) = (Vec::new(), Vec::new(), Vec::new());
        for waiter in self.lines.remove(id).unwrap_or_default() {
            // Where nobody waits, a task whose time has come still has its one turn.
            let has_room = stay.len() < most || most == 0 && waiter.task.is_some();
            match waiter.task {
                task if waiter.until <= time => late.extend(task),
                task if !has_room => beyond.extend(task),
                _ => stay.push(waiter),
            }
        }
        self.lines.insert(id.to_owned(), stay);
        late.into_iter().for_each(|task| self.lost_its_place(task, State::Expired, time));
        beyond.into_iter().for_each(|task| self.lost_to_the_rule(task, time));
    }

    /// One turn, if there is one.
    fn turn(&mut self, id: &str, time: u64) -> bool {
        let Ok((robot, service)) = self.find(id) else { return false };
        let (line, live) = (self.line(id), self.live(id, time));
        let first = service.first(line, &live, time).filter(|_| self.goes(&robot, &service).is_ok());
        let Some(first) = first else { return false };
        let place = service.place(&live, &line[first], time);
        if place.is_none() && service.line_max() > 0 {
            return false;
        }
        let waiter = self.lines.entry(id.to_owned()).or_default().remove(first);
        let Some(loser) = place else {
            waiter.task.into_iter().for_each(|task| self.lost_to_the_rule(task, time));
            return true;
        };
        let people = std::sync::Arc::clone(&self.people);
        let who = &people.all[waiter.person];
        if self.permits(who, &robot, &service, time).is_err() || who.identity.not_after <= time {
            waiter.task.into_iter().for_each(|task| self.lost_its_place(task, State::Failed, time));
            return true;
        }
        self.end_epoch(id, loser, Why::Interrupted, time);
        if let Some(task) = waiter.task {
            self.run(who, task, time);
        } else {
            let lease_ms = waiter.lease_ms.unwrap_or(service.lease_ms).min(service.lease_ms_max);
            self.give(who, id, lease_ms, waiter.priority, time);
        }
        true
    }

    /// The wishes of a caller: a lease, or JSON where the rules know it.
    pub(super) fn wishes(&self, text: Option<String>) -> Result<Wishes, Code> {
        match text {
            Some(text) if text.starts_with('{') => serde_json::from_str(&text).map_err(|_| Code::BadArgument),
            text => Ok(Wishes { lease_ms: super::number(text)?, ..Wishes::default() }),
        }
    }

    /// Is the robot not stopped, or is it for reading?
    pub(super) fn goes(&self, robot: &Robot, service: &Service) -> Result<(), Code> {
        if self.stopped.contains(&robot.name) && !service.reads { Err(Code::Stopped) } else { Ok(()) }
    }

    /// Somebody who holds nothing wants a service: a grant, a place in line, or a refusal.
    pub(super) fn enter(
        &mut self,
        (who, person): (&Person, usize),
        id: &str,
        wishes: &Wishes,
        stage: Stage,
        time: u64,
    ) -> Verdict {
        let (robot, service) = self.find(id)?;
        let priority = service.priority(who, &robot, wishes.priority);
        let patience = service.patience_ms();
        let patience = wishes.wait_ms.map_or(patience, |wait| wait.min(patience));
        let mut line = self.line(id).to_vec();
        let known = line.iter().position(|waiter| waiter.who == who.id() && waiter.task.is_none());
        let at = known.unwrap_or(line.len());
        if known.is_none() {
            line.push(Waiter { who: who.id(), person, priority, since: time, until: 0, lease_ms: None, task: None });
        }
        line[at].person = person;
        line[at].until = (time + patience * 1000).min(who.identity.not_after);
        line[at].lease_ms = wishes.lease_ms.or(line[at].lease_ms);
        let live = self.live(id, time);
        let is_first = service.is_open() || service.first(&line, &live, time) == Some(at);
        let place = service.place(&live, &line[at], time).filter(|_| is_first);
        let may_wait = service.line_max() > 0 && wishes.wait_ms != Some(0);
        let is_new = known.is_none() && stage == Stage::Asks;
        if is_new
            && (place.is_some() || may_wait)
            && self.must_wait((who, person), (&robot, &service), id, wishes, time)
        {
            return Ok(Code::Ok.into());
        }
        if let Some(loser) = place {
            self.end_epoch(id, loser, Why::Interrupted, time);
            self.leave(id, &who.id());
            self.asks_no_more(id, &who.id());
            return Ok(self.give(who, id, wishes.lease_ms.unwrap_or(service.lease_ms), priority, time));
        }
        if !may_wait {
            return Err(Code::Held);
        }
        if known.is_none() && at >= service.line_max() {
            return Err(Code::LineFull);
        }
        let place = Some(service.told(&line, at, time));
        self.lines.insert(id.to_owned(), line);
        self.asks_no_more(id, &who.id());
        Ok(Judged { place, ..Code::Ok.into() })
    }

    /// Takes somebody out of a line, but not its tasks; answers if there was anybody.
    pub(super) fn leave(&mut self, id: &str, who: &str) -> bool {
        let Some(line) = self.lines.get_mut(id) else { return false };
        let before = line.len();
        line.retain(|waiter| waiter.who != who || waiter.task.is_some());
        line.len() < before
    }

    /// These certificates wait nowhere any more.
    pub(super) fn leave_all(&mut self, is_revoked: impl Fn(&Hash) -> bool, time: u64) {
        let people = std::sync::Arc::clone(&self.people);
        for line in self.lines.values_mut() {
            line.retain(|waiter| !is_revoked(&people.all[waiter.person].fingerprint()));
        }
        self.asks_without(|person| is_revoked(&people.all[person].fingerprint()));
        self.tasks_without(|person| is_revoked(&people.all[person].fingerprint()), time);
    }

    pub(super) fn take(&mut self, who: &Person, id: &str, time: u64) -> Verdict {
        let (robot, service) = self.find(id)?;
        self.governs(who, &robot, time)?;
        self.goes(&robot, &service)?;
        self.end_of(id, Why::Interrupted, time, |_| true);
        self.leave(id, &who.id());
        self.asks_no_more(id, &who.id());
        Ok(self.give(who, id, service.lease_ms, TAKEN, time))
    }

    /// Stops or resumes robots.
    pub(super) fn emergency(&mut self, who: &Person, name: &str, stops: bool, time: u64) -> Verdict {
        let all: Vec<Robot> = self.robots.values().filter(|robot| name == "*" || robot.name == name).cloned().collect();
        if all.is_empty() && name != "*" {
            return Err(Code::UnknownRobot);
        }
        let may = |robot: &Robot| {
            if stops { self.may_stop(who, robot, time) } else { self.governs(who, robot, time) }
        };
        let (may, refused): (Vec<_>, Vec<_>) =
            all.iter().map(|robot| may(robot).map(|()| robot)).partition(Result::is_ok);
        if let (true, Some(Err(refused))) = (may.is_empty(), refused.first()) {
            return Err(*refused);
        }
        for robot in may.into_iter().flatten() {
            if !stops {
                self.stopped.remove(&robot.name);
            } else if self.stopped.insert(robot.name.clone()) {
                for service in &robot.services {
                    self.end_of(&format!("{}{}", robot.name, service.topic), Why::Interrupted, time, |_| true);
                }
            }
        }
        Ok(Code::Ok.into())
    }

    pub(super) fn configure(&mut self, who: &Person, id: &str, settings: &str, time: u64) -> Verdict {
        super::only_admins(who)?;
        let settings: Settings = serde_json::from_str(settings).map_err(|_| Code::BadArgument)?;
        let (mut robot, mut service) = self.find(id)?;
        if robot.owner != who.identity.organisation {
            return Err(Code::NotOwner);
        }
        if service.reads {
            return Err(Code::BadArgument);
        }
        service.sharing.retain(|key, _| !settings.clear.contains(key));
        service.sharing.extend(settings.sharing);
        service.mode = settings.mode;
        let name = robot.name.clone();
        let place = robot.services.iter_mut().find(|known| known.topic == service.topic);
        place.into_iter().for_each(|place| *place = service.clone());
        self.robots.insert(robot.name.clone(), robot);
        self.end_unfit(|robot| robot.name == name, time);
        Ok(Code::Ok.into())
    }

    /// May the holder keep what it has?
    pub(super) fn keeps(&self, who: &Person, grant: &Grant, (robot, service): (&Robot, &Service), time: u64) -> bool {
        let may = if grant.is_taken() {
            self.governs(who, robot, time)
        } else {
            self.permits_all(who, &grant.chain, (robot, service), time)
        };
        may.is_ok()
    }
}

impl Grant {
    /// Was it taken whatever the rule says?
    pub(super) fn is_taken(&self) -> bool {
        self.priority == TAKEN
    }
}
