//! The start of a block: what is over ends, and turns come.

use super::tasks::{State, Why};
use super::{Model, PLACES};

impl Model {
    /// A block begins.
    pub(crate) fn begin(&mut self, now: u64) {
        for at in 0..self.services.len() {
            self.end(at, Why::Failed, now, |holder| holder.expires <= now);
        }
        for at in 0..self.services.len() {
            self.services[at].asking.retain(|asking| asking.until > now);
            if at == PLACES && !self.exists(at) {
                self.services[at].line.clear();
                continue;
            }
            self.tasks_join(at, now);
            self.send_away(at, now);
            while self.goes(at).is_ok() && self.turn(at, now) {}
        }
    }

    /// Those who waited too long leave, and those for whom the line has no room.
    fn send_away(&mut self, at: usize, now: u64) {
        let most = self.services[at].settings.line;
        let mut stay = vec![];
        for waiter in std::mem::take(&mut self.services[at].line) {
            let late = waiter.until <= now;
            // Where nobody waits, a task has its one turn.
            let fits = stay.len() < most || most == 0 && waiter.task.is_some();
            match waiter.task {
                _ if !late && fits => stay.push(waiter),
                Some(task) if late => self.task(task).end(State::Expired, now),
                Some(task) => self.beyond_the_rule(task, now),
                None => {}
            }
        }
        self.services[at].line = stay;
    }

    /// One turn, if there is one.
    fn turn(&mut self, at: usize, now: u64) -> bool {
        let service = &self.services[at];
        let Some(best) = service.best(now) else { return false };
        let worth = service.worth(&service.line[best], now).0;
        let free = service.holders.len() < service.settings.places;
        let victim = service.weakest(worth, now).map(|index| service.holders[index].epoch);
        if !free && victim.is_none() && service.settings.line > 0 {
            return false;
        }
        let waiter = self.services[at].line.remove(best);
        if !free && victim.is_none() {
            waiter.task.into_iter().for_each(|task| self.beyond_the_rule(task, now));
        } else if self.permits(waiter.who).is_err() {
            waiter.task.into_iter().for_each(|task| self.task(task).end(State::Failed, now));
        } else {
            if !free {
                self.end(at, Why::Interrupted, now, |holder| Some(holder.epoch) == victim);
            }
            self.give(at, waiter.who, waiter.priority, now);
            waiter.task.into_iter().for_each(|task| self.runs(at, task));
        }
        true
    }
}
