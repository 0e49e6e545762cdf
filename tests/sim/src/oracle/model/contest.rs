//! The contest where several want a service: places, lines, priorities; robots that are stopped. Lists, and one look at
//! everything at the start of every block.

use super::{Grant, Judged, Model, Robot, Service, Verdict};
use crate::people::Person;
use crate::policy::Says;
use ledger_hash::Hash;
use ledger_identity::Role;
use ledger_rejection::Code;
use serde::Deserialize;
use serde_json::{Map, Value};

/// The rules that brought all this.
const SINCE: u32 = 3;
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
    person: usize,
    pub(in crate::oracle) priority: i64,
    since: u64,
    pub(in crate::oracle) until: u64,
    lease_ms: Option<u64>,
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
    pub(super) fn setting(&self, key: &str) -> Option<u64> {
        self.sharing.get(key).and_then(Value::as_u64)
    }

    /// May a holder pass its grant on?
    pub(super) fn is_delegable(&self) -> bool {
        self.sharing.get("delegable").and_then(Value::as_bool).unwrap_or(false)
    }

    fn conflict(&self) -> &str {
        self.sharing.get("on_conflict").and_then(Value::as_str).unwrap_or("deny")
    }

    /// How many hold it at once.
    pub(super) fn places(&self) -> usize {
        match &*self.mode {
            "open" => usize::MAX,
            "limited" => self.setting("publishers").unwrap_or(0) as usize,
            _ => 1,
        }
    }

    pub(super) fn line_max(&self) -> usize {
        let unless = if self.conflict() == "queue" { LINE_MAX } else { 0 };
        self.setting("queue_max").unwrap_or(unless) as usize
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

    /// The first of a line.
    fn first(&self, line: &[Waiter], time: u64) -> Option<usize> {
        let worth = |at: usize| self.worth(&line[at], time).1;
        (0..line.len()).reduce(|best, other| if worth(other) > worth(best) { other } else { best })
    }

    /// The place for one that is the first, and who loses it: nobody if one is free.
    fn place(&self, holders: &[Grant], waiter: &Waiter, time: u64) -> Option<Option<u64>> {
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
    /// Do the rules of now know all this?
    pub(super) fn has_contests(&self) -> bool {
        self.network_of_nodes.active() >= SINCE
    }

    /// The line of a service, in order of arrival.
    pub(in crate::oracle) fn line(&self, service: &str) -> &[Waiter] {
        self.lines.get(service).map_or(&[], Vec::as_slice)
    }

    /// The start of a block: who waited too long leaves, and turns come. `first` is the service that a block begins with,
    /// which matters where policies are so old that only one turn comes with each block.
    pub(super) fn turns(&mut self, first: Option<&str>, time: u64) {
        self.asks_until(time);
        let services: Vec<String> = self.lines.keys().cloned().collect();
        for id in &services {
            let Ok((_, service)) = self.find(id) else { continue };
            let line = self.lines.entry(id.clone()).or_default();
            line.retain(|waiter| waiter.until > time);
            line.truncate(service.line_max());
        }
        let mut one_is_enough = false;
        for id in first.into_iter().chain(services.iter().map(String::as_str)) {
            let Ok((robot, _)) = self.find(id) else { continue };
            while !one_is_enough && self.turn(id, time) {
                one_is_enough = self.uncounted.contains(&robot.owner);
            }
        }
        self.lines.retain(|_, line| !line.is_empty());
    }

    /// One turn, if there is one.
    fn turn(&mut self, id: &str, time: u64) -> bool {
        let Ok((robot, service)) = self.find(id) else { return false };
        let line = self.line(id);
        let Some(first) = service.first(line, time).filter(|_| !self.stopped.contains(&robot.name)) else {
            return false;
        };
        let Some(loser) = service.place(&self.live(id, time), &line[first], time) else { return false };
        let waiter = self.lines.entry(id.to_owned()).or_default().remove(first);
        let people = std::sync::Arc::clone(&self.people);
        let who = &people.all[waiter.person];
        if self.permits(who, &robot, time).is_ok() && who.identity.not_after > time {
            self.end_epoch(id, loser);
            let lease_ms = waiter.lease_ms.unwrap_or(service.lease_ms).min(service.lease_ms_max);
            self.give(who, id, lease_ms, waiter.priority, time);
        }
        true
    }

    pub(super) fn end_epoch(&mut self, id: &str, epoch: Option<u64>) {
        if let (Some(epoch), Some(grants)) = (epoch, self.grants.get_mut(id)) {
            grants.retain(|grant| grant.epoch != epoch);
        }
    }

    /// The wishes of a caller: a lease, or JSON where the rules know it.
    pub(super) fn wishes(&self, text: Option<String>) -> Result<Wishes, Code> {
        match text {
            Some(text) if text.starts_with('{') && self.has_contests() => {
                serde_json::from_str(&text).map_err(|_| Code::BadArgument)
            }
            text => Ok(Wishes { lease_ms: super::number(text)?, ..Wishes::default() }),
        }
    }

    /// Is the robot not stopped?
    pub(super) fn goes(&self, robot: &Robot) -> Result<(), Code> {
        if self.stopped.contains(&robot.name) { Err(Code::Stopped) } else { Ok(()) }
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
        let patience = service.setting("queue_wait_max_ms").unwrap_or(PATIENCE_MS);
        let patience = wishes.wait_ms.map_or(patience, |wait| wait.min(patience));
        let mut line = self.line(id).to_vec();
        let known = line.iter().position(|waiter| waiter.who == who.id());
        let at = known.unwrap_or(line.len());
        if known.is_none() {
            line.push(Waiter { who: who.id(), person, priority, since: time, until: 0, lease_ms: None });
        }
        line[at].person = person;
        line[at].until = (time + patience * 1000).min(who.identity.not_after);
        line[at].lease_ms = wishes.lease_ms.or(line[at].lease_ms);
        let is_first = service.mode == "open" || service.first(&line, time) == Some(at);
        let place = service.place(&self.live(id, time), &line[at], time).filter(|_| is_first);
        let may_wait = service.line_max() > 0 && wishes.wait_ms != Some(0);
        let is_new = known.is_none() && stage == Stage::Asks;
        if is_new && (place.is_some() || may_wait) && self.must_wait((who, person), id, &service, wishes, time) {
            return Ok(Code::Ok.into());
        }
        if let Some(loser) = place {
            self.end_epoch(id, loser);
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
        let before = |other: &Waiter| service.worth(other, time).1;
        let ahead = line.iter().enumerate().filter(|(other, waiter)| {
            before(waiter) > before(&line[at]) || before(waiter) == before(&line[at]) && *other < at
        });
        let place = Some((ahead.count() as u64 + 1, line[at].priority, line[at].until));
        self.lines.insert(id.to_owned(), line);
        self.asks_no_more(id, &who.id());
        Ok(Judged { place, ..Code::Ok.into() })
    }

    /// Takes somebody out of a line; answers if there was anybody.
    pub(super) fn leave(&mut self, id: &str, who: &str) -> bool {
        let Some(line) = self.lines.get_mut(id) else { return false };
        let before = line.len();
        line.retain(|waiter| waiter.who != who);
        line.len() < before
    }

    /// These certificates wait nowhere any more.
    pub(super) fn leave_all(&mut self, is_revoked: impl Fn(&Hash) -> bool) {
        let people = std::sync::Arc::clone(&self.people);
        for line in self.lines.values_mut() {
            line.retain(|waiter| !is_revoked(&people.all[waiter.person].fingerprint()));
        }
        self.asks_without(|person| is_revoked(&people.all[person].fingerprint()));
    }

    pub(super) fn take(&mut self, who: &Person, id: &str, time: u64) -> Verdict {
        self.known()?;
        let (robot, service) = self.find(id)?;
        self.governs(who, &robot, time)?;
        self.goes(&robot)?;
        self.grants.remove(id);
        self.leave(id, &who.id());
        self.asks_no_more(id, &who.id());
        Ok(self.give(who, id, service.lease_ms, TAKEN, time))
    }

    /// Stops or resumes robots.
    pub(super) fn emergency(&mut self, who: &Person, name: &str, stops: bool, time: u64) -> Verdict {
        self.known()?;
        let all: Vec<Robot> = self.robots.values().filter(|robot| name == "*" || robot.name == name).cloned().collect();
        if all.is_empty() && name != "*" {
            return Err(Code::UnknownRobot);
        }
        let (may, refused): (Vec<_>, Vec<_>) =
            all.iter().map(|robot| self.governs(who, robot, time).map(|()| robot)).partition(Result::is_ok);
        if let (true, Some(Err(refused))) = (may.is_empty(), refused.first()) {
            return Err(*refused);
        }
        for robot in may.into_iter().flatten() {
            if !stops {
                self.stopped.remove(&robot.name);
            } else if self.stopped.insert(robot.name.clone()) {
                for service in &robot.services {
                    self.grants.remove(&format!("{}{}", robot.name, service.topic));
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
        service.sharing.retain(|key, _| !settings.clear.contains(key));
        service.sharing.extend(settings.sharing);
        service.mode = settings.mode;
        if !self.has_contests() && (!service.sharing.is_empty() || service.mode == "limited") {
            return Err(Code::BadArgument);
        }
        let name = robot.name.clone();
        let place = robot.services.iter_mut().find(|known| known.topic == service.topic);
        place.into_iter().for_each(|place| *place = service.clone());
        self.robots.insert(robot.name.clone(), robot);
        self.end_unfit(|robot| robot.name == name, time);
        Ok(Code::Ok.into())
    }

    pub(super) fn known(&self) -> Result<(), Code> {
        if self.has_contests() { Ok(()) } else { Err(Code::UnknownFunction) }
    }

    /// May they do to a robot what its owner's admins always may, and others only by a policy?
    pub(super) fn governs(&self, who: &Person, robot: &Robot, time: u64) -> Result<(), Code> {
        if who.identity.role == Role::Admin && who.identity.organisation == robot.owner {
            return Ok(());
        }
        // The default policy permits none of it to anybody who is simulated.
        let said = self.said(who, robot, time);
        if said.contains(&Says::Error) {
            Err(Code::PolicyError)
        } else if said.contains(&Says::Permit) && !said.contains(&Says::Forbid) {
            Ok(())
        } else {
            Err(Code::DeniedByPolicy)
        }
    }

    /// May the holder keep what it has?
    pub(super) fn keeps(&self, who: &Person, grant: &Grant, robot: &Robot, time: u64) -> bool {
        let may = if grant.is_taken() {
            self.governs(who, robot, time)
        } else {
            self.permits_all(who, &grant.chain, robot, time)
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
