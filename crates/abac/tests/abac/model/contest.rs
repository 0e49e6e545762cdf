//! The order of those who want a service.

use super::tasks::Why;
use super::{Answer, Conflict, Got, Model, Service, Waiter};
use ledger_base::rejection::Code;

impl Service {
    /// How much a waiter is worth: whole steps, and the exact order in line.
    pub(super) fn worth(&self, waiter: &Waiter, now: u64) -> (i64, i128) {
        let waited = now - waiter.since;
        match self.settings.aging {
            None => (waiter.priority, i128::from(waiter.priority)),
            Some(aging) => (
                waiter.priority + (waited / aging) as i64,
                i128::from(waiter.priority) * i128::from(aging) + i128::from(waited),
            ),
        }
    }

    /// The next in line: the highest worth, then the earliest. A holder of the service is passed over.
    pub(super) fn best(&self, now: u64) -> Option<usize> {
        let mut best: Option<usize> = None;
        for index in 0..self.line.len() {
            let holds = self.holders.iter().any(|holder| holder.who == self.line[index].who);
            let beats = |other: usize| self.worth(&self.line[index], now).1 > self.worth(&self.line[other], now).1;
            if !holds && best.is_none_or(beats) {
                best = Some(index);
            }
        }
        best
    }

    /// The holder that one of this worth may push out.
    pub(super) fn weakest(&self, worth: i64, now: u64) -> Option<usize> {
        if self.settings.conflict != Conflict::Preempt {
            return None;
        }
        let mut weakest: Option<usize> = None;
        for (index, holder) in self.holders.iter().enumerate() {
            let safe = now < holder.since + self.settings.min_hold;
            if !safe
                && holder.priority < worth
                && weakest.is_none_or(|other| holder.priority <= self.holders[other].priority)
            {
                weakest = Some(index);
            }
        }
        weakest
    }

    /// The place for one that stands at this index of the line: free, or that of a holder with this epoch.
    pub(super) fn place(&self, index: usize, now: u64) -> Option<Option<u64>> {
        if self.settings.places == usize::MAX {
            return Some(None);
        }
        if self.best(now) != Some(index) {
            return None;
        }
        if self.holders.len() < self.settings.places {
            return Some(None);
        }
        let worth = self.worth(&self.line[index], now).0;
        self.weakest(worth, now).map(|victim| Some(self.holders[victim].epoch))
    }
}

impl Model {
    pub(crate) fn acquire(&mut self, at: usize, who: usize, less: i64, wait: Option<u64>, now: u64) -> Answer {
        self.find(at)?;
        self.compete(at, who, (less, wait), true, now)
    }

    /// Somebody wants a service. One that comes by itself may have to be confirmed first.
    pub(super) fn compete(
        &mut self,
        at: usize,
        who: usize,
        (less, wait): (i64, Option<u64>),
        asks: bool,
        now: u64,
    ) -> Answer {
        match self.holder(at, who).cloned() {
            Some(own) => own.givers.iter().map(|giver| giver.who).chain([who]).try_for_each(|who| self.permits(who))?,
            None => self.permits(who)?,
        }
        self.goes(at)?;
        if self.holder(at, who).is_some() {
            return Ok(self.extend(at, who, now));
        }
        let settings = self.services[at].settings;
        let priority = settings.priority(who, less);
        let patience = wait.map_or(settings.patience, |wait| wait.min(settings.patience));
        // It stands in line for a moment: at the end, or in the place that it has.
        let before = self.services[at].line.clone();
        let known = before.iter().position(|waiter| waiter.who == who && waiter.task.is_none());
        let index = known.unwrap_or(before.len());
        if known.is_none() {
            self.services[at].line.push(Waiter { who, task: None, priority, since: now, until: 0 });
        }
        self.services[at].line[index].until = now + patience;
        let place = self.services[at].place(index, now);
        let waits = settings.line > 0 && wait != Some(0);
        let is_new = known.is_none() && asks;
        if is_new && (place.is_some() || waits) && self.must_be_confirmed(at, who, (priority, wait), now) {
            self.services[at].line = before;
            return Ok(Got::Pending);
        }
        if let Some(victim) = place {
            self.services[at].line.remove(index);
            self.leave(at, who);
            self.end(at, Why::Interrupted, now, |holder| Some(holder.epoch) == victim);
            return Ok(Got::Granted(self.give(at, who, priority, now)));
        }
        let full = known.is_none() && before.len() >= settings.line;
        if !waits || full {
            self.services[at].line = before;
            return Err(if waits { Code::LineFull } else { Code::Held });
        }
        self.services[at].asking.retain(|asking| asking.who != who);
        Ok(Got::Queued)
    }

    /// Several at once, or none of them.
    pub(crate) fn acquire_all(&mut self, who: usize, services: &[usize], less: i64, now: u64) -> Answer {
        for (index, at) in services.iter().enumerate() {
            self.find(*at)?;
            if services[..index].contains(at) {
                return Err(Code::BadArgument);
            }
        }
        let before = self.clone();
        for at in services {
            let got = self.compete(*at, who, (less, Some(0)), true, now);
            if !matches!(got, Ok(Got::Granted(_))) {
                *self = before;
                // One that others must confirm first does not get all at once.
                return Err(got.err().unwrap_or(Code::Held));
            }
        }
        Ok(Got::Done)
    }
}
