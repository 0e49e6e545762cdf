//! Taking, keeping, using and giving back.

use super::confirm::Askings;
use super::contest::{Stage, Waiter, Wishes};
use super::delegate::{Award, Chain};
use super::ends::Why;
use super::tasks::Task;
use super::{Grant, Judged, Model, Robot, Service, Verdict};
use crate::people::Person;
use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_base::rejection::Code;
use ledger_identity::Role;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Shortest lease that may be asked for, milliseconds.
const LEASE_MS_MIN: u64 = 100;

/// The changes that a refused call may have made before it was refused.
pub(super) struct Before {
    grants: BTreeMap<String, Vec<Grant>>,
    epochs: BTreeMap<String, u64>,
    robots: BTreeMap<String, Robot>,
    lines: BTreeMap<String, Vec<Waiter>>,
    asking: Askings,
    tasks: Vec<Task>,
}

impl Model {
    pub(super) fn clone_small(&self) -> Before {
        let (grants, epochs, robots) = (self.grants.clone(), self.epochs.clone(), self.robots.clone());
        let (lines, asking, tasks) = (self.lines.clone(), self.asking.clone(), self.tasks.clone());
        Before { grants, epochs, robots, lines, asking, tasks }
    }

    pub(super) fn restore(&mut self, before: Before) {
        self.grants = before.grants;
        self.epochs = before.epochs;
        self.robots = before.robots;
        self.lines = before.lines;
        self.asking = before.asking;
        self.tasks = before.tasks;
    }

    /// The grants of a service that count at a time, oldest first.
    pub(in crate::oracle) fn live(&self, service: &str, time: u64) -> Vec<Grant> {
        let grants = self.grants.get(service).map(Vec::as_slice).unwrap_or_default();
        grants.iter().filter(|grant| grant.expires > time).cloned().collect()
    }

    /// The newest epoch of a service.
    pub(in crate::oracle) fn epoch(&self, service: &str) -> u64 {
        self.epochs.get(service).copied().unwrap_or(0)
    }

    /// The grants of a service that lie in the state, and the newest epoch.
    pub(in crate::oracle) fn stored(&self, service: &str) -> &[Grant] {
        self.grants.get(service).map_or(&[], Vec::as_slice)
    }

    pub(super) fn acquire(
        &mut self,
        (who, person): (&Person, usize),
        id: &str,
        wishes: Option<String>,
        time: u64,
    ) -> Verdict {
        let (_, service) = self.find(id)?;
        let wishes = self.wishes(wishes)?;
        check_lease(&service, wishes.lease_ms)?;
        self.compete((who, person), id, &wishes, Stage::Asks, time)
    }

    /// Somebody wants a service, with usable wishes.
    pub(super) fn compete(
        &mut self,
        (who, person): (&Person, usize),
        id: &str,
        wishes: &Wishes,
        stage: Stage,
        time: u64,
    ) -> Verdict {
        let (robot, service) = self.find(id)?;
        let own = self.live(id, time).into_iter().find(|grant| grant.holder == who.id());
        let chain = own.as_ref().map(|own| own.chain.clone()).unwrap_or_default();
        self.permits_all(who, &chain, (&robot, &service), time)?;
        self.goes(&robot, &service)?;
        match own {
            Some(own) if own.certificate == who.fingerprint() => {
                Ok(self.extend(who, id, &service, wishes.lease_ms, time))
            }
            Some(own) => {
                self.end_of(id, Why::GivenBack, time, |grant| grant.epoch == own.epoch);
                self.asks_no_more(id, &who.id());
                self.leave(id, &who.id());
                let since = if own.chain.goes_on { own.since } else { time };
                let lease_ms = wishes.lease_ms.unwrap_or(service.lease_ms);
                Ok(self.give_on(who, id, Award { lease_ms, priority: own.priority, since, chain }, time))
            }
            None => self.enter((who, person), id, wishes, stage, time),
        }
    }

    /// Gives a grant.
    pub(super) fn give(&mut self, who: &Person, id: &str, lease_ms: u64, priority: i64, time: u64) -> Judged {
        self.give_on(who, id, Award { lease_ms, priority, since: time, chain: Chain::default() }, time)
    }

    /// Gives a grant that may come from somebody who had the service before.
    pub(super) fn give_on(&mut self, who: &Person, id: &str, award: Award, time: u64) -> Judged {
        let Award { lease_ms, priority, since, chain } = award;
        let epoch = self.epoch(id) + 1;
        self.epochs.insert(id.to_owned(), epoch);
        let (holder, certificate) = (who.id(), who.fingerprint());
        let mut grant = Grant { holder, certificate, epoch, expires: 0, lease_ms, priority, since, chain, task: None };
        grant.expires = grant.until(&self.people, time);
        let expires = grant.expires;
        let grants = self.grants.entry(id.to_owned()).or_default();
        grants.push(grant);
        Judged { grant: Some((epoch, expires)), ..Code::Ok.into() }
    }

    pub(super) fn renew(&mut self, who: &Person, id: &str, lease_ms: Option<u64>, time: u64) -> Verdict {
        let (robot, service) = self.find(id)?;
        let own = self.own(who, id, time).ok_or(Code::NotHolder)?;
        if !self.keeps(who, &own, (&robot, &service), time) {
            self.permits_all(who, &own.chain, (&robot, &service), time)?;
        }
        check_lease(&service, lease_ms)?;
        Ok(self.extend(who, id, &service, lease_ms, time))
    }

    pub(super) fn release(&mut self, who: &Person, id: &str, time: u64) -> Verdict {
        let (robot, _) = self.find(id)?;
        if let Some(own) = self.own(who, id, time) {
            self.end_of(id, Why::GivenBack, time, |grant| grant.epoch == own.epoch);
        } else if self.leave(id, &who.id()) || self.asks_no_more(id, &who.id()) {
            return Ok(Code::Ok.into());
        } else if who.identity.role == Role::Admin && who.identity.organisation == robot.owner {
            self.end_of(id, Why::Failed, time, |_| true);
        } else {
            return Err(Code::NotHolder);
        }
        Ok(Code::Ok.into())
    }

    pub(super) fn set(
        &mut self,
        who: &Person,
        id: &str,
        (epoch, seq): (u64, u64),
        payload: Option<&Bytes>,
        time: u64,
    ) -> Verdict {
        let used = self.may_publish(who, id, epoch, time)?;
        let (_, service) = self.find(id)?;
        self.check_key(who, id, payload.map_or(&[][..], |payload| &payload[..]), time)?;
        // Publishers that stand side by side number their messages apart.
        let apart = service.mode != "exclusive";
        let place = (id.to_owned(), if apart { who.id() } else { String::new() });
        if let Some((last_epoch, last)) = self.last.get(&place)
            && (apart || *last_epoch == epoch)
            && seq <= *last
        {
            return Err(Code::StaleSequence);
        }
        used.into_iter().for_each(|own| self.used(id, &own, time));
        self.last.insert(place, (epoch, seq));
        Ok(Code::Ok.into())
    }

    /// May they publish? Answers with the grant that lets them, if it is one that does.
    pub(super) fn may_publish(&self, who: &Person, id: &str, epoch: u64, time: u64) -> Result<Option<Grant>, Code> {
        let (robot, service) = self.find(id)?;
        if service.reads {
            return Err(Code::UnknownService);
        }
        if service.is_open() && epoch == 0 {
            self.permits(who, &robot, &service, time)?;
            self.goes(&robot, &service)?;
            return Ok(None);
        }
        match self.own(who, id, time) {
            Some(own) if own.epoch == epoch => Ok(Some(own)),
            _ if self.stopped.contains(&robot.name) => Err(Code::Stopped),
            Some(_) => Err(Code::StaleEpoch),
            None if epoch > 0 && epoch < self.epoch(id) => Err(Code::StaleEpoch),
            None => Err(self.permits(who, &robot, &service, time).err().unwrap_or(Code::NotHolder)),
        }
    }

    /// Use keeps a grant alive, but is written down only when it is worth it, and only while policies permit.
    pub(super) fn used(&mut self, id: &str, own: &Grant, time: u64) {
        let (Ok((robot, service)), people) = (self.find(id), Arc::clone(&self.people)) else { return };
        let Some(who) = people.by_fingerprint(&own.certificate) else { return };
        let expires = own.until(&people, time);
        let worth = expires.saturating_sub(own.expires) > own.lease_ms * 250;
        if worth && self.keeps(who, own, (&robot, &service), time) {
            self.change(id, &own.holder, |grant| grant.expires = expires);
        }
    }

    /// Ends what policies, or the rules of these robots, do not allow any more.
    pub(super) fn end_unfit(&mut self, concerned: impl Fn(&Robot) -> bool, time: u64) {
        let people = Arc::clone(&self.people);
        let robots: Vec<Robot> = self.robots.values().filter(|robot| concerned(robot)).cloned().collect();
        for robot in &robots {
            for id in robot.ids() {
                let places = self.find(&id).ok();
                let mut stay = 0;
                let mut ends = Vec::new();
                for grant in self.live(&id, time) {
                    let fits = places.as_ref().is_some_and(|(robot, service)| {
                        let who = people.by_fingerprint(&grant.certificate);
                        stay < service.places()
                            && who.is_some_and(|who| self.keeps(who, &grant, (robot, service), time))
                    });
                    if fits { stay += 1 } else { ends.push(grant.epoch) }
                }
                self.end_of(&id, Why::Failed, time, |grant| ends.contains(&grant.epoch));
            }
        }
    }

    fn extend(&mut self, who: &Person, id: &str, service: &Service, lease_ms: Option<u64>, time: u64) -> Judged {
        let (mut told, people) = (None, Arc::clone(&self.people));
        self.change(id, &who.id(), |grant| {
            grant.lease_ms = lease_ms.unwrap_or(grant.lease_ms).min(service.lease_ms_max);
            grant.expires = grant.until(&people, time);
            told = Some((grant.epoch, grant.expires));
        });
        Judged { grant: told, ..Code::Ok.into() }
    }

    /// The grant that somebody has with this very certificate.
    pub(super) fn own(&self, who: &Person, id: &str, time: u64) -> Option<Grant> {
        let certificate: Hash = who.fingerprint();
        self.live(id, time).into_iter().find(|grant| grant.holder == who.id() && grant.certificate == certificate)
    }

    fn change(&mut self, id: &str, holder: &str, change: impl FnOnce(&mut Grant)) {
        let grants = self.grants.get_mut(id).into_iter().flatten();
        if let Some(grant) = grants.into_iter().find(|grant| grant.holder == holder) {
            change(grant);
        }
    }
}

pub(super) fn check_lease(service: &Service, lease_ms: Option<u64>) -> Result<(), Code> {
    let fits = lease_ms.is_none_or(|lease| (LEASE_MS_MIN..=service.lease_ms_max).contains(&lease));
    if fits { Ok(()) } else { Err(Code::BadArgument) }
}
