//! A model of the rules, written apart from them: lists, and one look at everything at the start of every block.
//!
//! It knows nothing of keys, indexes or times at which to look again. So it notices every turn that the product misses.

use crate::fleet::SECOND;

/// The settings that the model knows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Settings {
    pub(crate) places: usize,
    pub(crate) conflict: Conflict,
    /// 0: no line.
    pub(crate) line: usize,
    pub(crate) patience: u64,
    pub(crate) aging: Option<u64>,
    pub(crate) min_hold: u64,
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
    since: u64,
    expires: u64,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Waiter {
    pub(crate) who: usize,
    priority: i64,
    since: u64,
    until: u64,
}

/// The answer to `acquire`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Answer {
    Granted(u64),
    Queued,
    Held,
    LineFull,
    Stopped,
    Denied,
}

/// One service.
#[derive(Clone, Debug)]
pub(crate) struct Model {
    pub(crate) settings: Settings,
    /// Oldest grant first.
    pub(crate) holders: Vec<Holder>,
    /// In order of arrival.
    pub(crate) line: Vec<Waiter>,
    pub(crate) stopped: bool,
    /// Those whom a policy forbids.
    pub(crate) forbidden: Vec<usize>,
    epoch: u64,
}

const LEASE: u64 = 10 * SECOND;

impl Model {
    pub(crate) fn new(settings: Settings) -> Self {
        Self { settings, holders: vec![], line: vec![], stopped: false, forbidden: vec![], epoch: 0 }
    }

    /// The start of a block.
    pub(crate) fn begin(&mut self, now: u64) {
        self.holders.retain(|holder| holder.expires > now);
        self.line.retain(|waiter| waiter.until > now);
        self.line.truncate(self.settings.line);
        while !self.stopped && self.turn(now) {}
    }

    /// How much a waiter is worth: whole steps, and the exact order in line.
    fn worth(&self, waiter: &Waiter, now: u64) -> (i64, i128) {
        let waited = now - waiter.since;
        match self.settings.aging {
            None => (waiter.priority, i128::from(waiter.priority)),
            Some(aging) => (
                waiter.priority + (waited / aging) as i64,
                i128::from(waiter.priority) * i128::from(aging) + i128::from(waited),
            ),
        }
    }

    /// The next in line: the highest worth, then the earliest.
    fn best(&self, now: u64) -> Option<usize> {
        let mut best: Option<usize> = None;
        for index in 0..self.line.len() {
            let beats = |other: usize| self.worth(&self.line[index], now).1 > self.worth(&self.line[other], now).1;
            if best.is_none_or(beats) {
                best = Some(index);
            }
        }
        best
    }

    /// The holder that one of this worth may push out.
    fn weakest(&self, worth: i64, now: u64) -> Option<usize> {
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

    /// One turn, if there is one.
    fn turn(&mut self, now: u64) -> bool {
        let Some(best) = self.best(now) else { return false };
        let worth = self.worth(&self.line[best], now).0;
        let victim = self.weakest(worth, now);
        if self.holders.len() >= self.settings.places && victim.is_none() {
            return false;
        }
        let waiter = self.line.remove(best);
        if !self.forbidden.contains(&waiter.who) {
            if self.holders.len() >= self.settings.places {
                self.holders.remove(victim.unwrap());
            }
            self.give(waiter.who, waiter.priority, now);
        }
        true
    }

    fn give(&mut self, who: usize, priority: i64, now: u64) -> u64 {
        self.epoch += 1;
        self.holders.push(Holder { who, epoch: self.epoch, priority, since: now, expires: now + LEASE });
        self.epoch
    }

    pub(crate) fn acquire(&mut self, who: usize, priority: i64, wait: Option<u64>, now: u64) -> Answer {
        if self.forbidden.contains(&who) {
            return Answer::Denied;
        }
        if self.stopped {
            return Answer::Stopped;
        }
        if let Some(own) = self.holders.iter_mut().find(|holder| holder.who == who) {
            own.expires = now + LEASE;
            return Answer::Granted(own.epoch);
        }
        let waits = self.line.iter().position(|waiter| waiter.who == who);
        let was = waits.map(|index| self.line[index].clone());
        let patience = wait.map_or(self.settings.patience, |wait| wait.min(self.settings.patience));
        let mut asks = was.clone().unwrap_or(Waiter { who, priority, since: now, until: 0 });
        asks.until = now + patience;
        // It stands in line for a moment: at the end, or in the place that it has.
        let before = self.line.clone();
        match waits {
            Some(index) => self.line[index] = asks.clone(),
            None => self.line.push(asks.clone()),
        }
        let is_first = self.best(now).is_some_and(|best| self.line[best].who == who);
        let worth = self.worth(&asks, now).0;
        let victim = self.weakest(worth, now);
        let free = self.holders.len() < self.settings.places;
        if is_first && (free || victim.is_some()) {
            self.line.retain(|waiter| waiter.who != who);
            if !free {
                self.holders.remove(victim.unwrap());
            }
            // One that comes anew counts with the priority it asks with now.
            return Answer::Granted(self.give(who, priority, now));
        }
        if self.settings.line == 0 || wait == Some(0) {
            self.line = before;
            return Answer::Held;
        }
        if was.is_none() && before.len() >= self.settings.line {
            self.line = before;
            return Answer::LineFull;
        }
        Answer::Queued
    }

    /// Gives back what is held, or leaves the line. Answers if there was anything.
    pub(crate) fn release(&mut self, who: usize) -> bool {
        let (holders, line) = (self.holders.len(), self.line.len());
        if self.holders.iter().any(|holder| holder.who == who) {
            self.holders.retain(|holder| holder.who != who);
        } else {
            self.line.retain(|waiter| waiter.who != who);
        }
        (holders, line) != (self.holders.len(), self.line.len())
    }

    pub(crate) fn publish(&mut self, who: usize, now: u64) {
        if let Some(own) = self.holders.iter_mut().find(|holder| holder.who == who)
            && now + LEASE - own.expires > LEASE / 4
        {
            own.expires = now + LEASE;
        }
    }

    pub(crate) fn revoke(&mut self, who: usize) {
        self.holders.retain(|holder| holder.who != who);
        self.line.retain(|waiter| waiter.who != who);
    }

    pub(crate) fn take(&mut self, who: usize, now: u64) -> Answer {
        if self.stopped {
            return Answer::Stopped;
        }
        self.holders.clear();
        self.line.retain(|waiter| waiter.who != who);
        Answer::Granted(self.give(who, i64::MAX, now))
    }

    pub(crate) fn stop(&mut self) {
        if !self.stopped {
            self.holders.clear();
        }
        self.stopped = true;
    }

    pub(crate) fn set(&mut self, settings: Settings) {
        self.settings = settings;
        self.holders.truncate(settings.places);
    }

    pub(crate) fn forbid(&mut self, forbidden: Vec<usize>) {
        self.holders.retain(|holder| holder.priority == i64::MAX || !forbidden.contains(&holder.who));
        self.forbidden = forbidden;
    }
}
