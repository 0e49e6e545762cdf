//! Confirmation: a contender asks, others agree, and then it competes like everybody.

use super::contest::{Stage, Wishes};
use super::{Model, Service, Verdict};
use crate::people::Person;
use ledger_base::rejection::Code;
use std::collections::BTreeMap;

/// How long confirmations are waited for (milliseconds), unless the owner says otherwise.
const WITHIN_MS: u64 = 60_000;

/// Those who wait to be confirmed, by service and name.
pub(super) type Askings = BTreeMap<(String, String), Asking>;

/// One who waits to be confirmed.
#[derive(Clone)]
pub(super) struct Asking {
    /// Index among the people: the certificate with which it asked.
    person: usize,
    /// Block time, microseconds.
    until: u64,
    wishes: Wishes,
    /// Indexes among the people of those who have confirmed it.
    confirmed: Vec<usize>,
}

impl Model {
    /// Must others confirm this contender first? One who comes for the first time asks them.
    pub(super) fn must_wait(
        &mut self,
        (who, person): (&Person, usize),
        id: &str,
        service: &Service,
        wishes: &Wishes,
        time: u64,
    ) -> bool {
        let Some(wanted) = service.setting("confirm") else { return false };
        let place = (id.to_owned(), who.id());
        if let Some(known) = self.asking.get(&place).filter(|known| known.person == person && known.until > time) {
            return self.counted(known, time) < wanted;
        }
        let within = service.setting("confirm_within_ms").unwrap_or(WITHIN_MS);
        let until = (time + within * 1000).min(who.identity.not_after);
        self.asking.insert(place, Asking { person, until, wishes: wishes.clone(), confirmed: Vec::new() });
        true
    }

    pub(super) fn confirm(&mut self, who: &Person, person: usize, id: &str, contender: &str, time: u64) -> Verdict {
        let (robot, service) = self.find(id)?;
        let place = (id.to_owned(), contender.to_owned());
        let asking = self.asking.get(&place).filter(|asking| asking.until > time).cloned();
        let mut asking = asking.ok_or(Code::NotFound)?;
        if contender == who.id() {
            return Err(Code::BadArgument);
        }
        self.governs(who, &robot, time)?;
        let people = std::sync::Arc::clone(&self.people);
        asking.confirmed.retain(|confirmed| people.all[*confirmed].id() != who.id());
        asking.confirmed.push(person);
        self.asking.insert(place, asking.clone());
        if self.counted(&asking, time) < service.setting("confirm").unwrap_or(0) {
            return Ok(Code::Ok.into());
        }
        let contender = (&people.all[asking.person], asking.person);
        match self.compete(contender, id, &asking.wishes, Stage::Confirmed, time) {
            // Then there is no place for it to wait, and nothing has happened.
            Err(Code::LineFull) => Err(Code::LineFull),
            // It may try again until the confirmations end.
            _ => Ok(Code::Ok.into()),
        }
    }

    /// How many confirmations count now.
    fn counted(&self, asking: &Asking, time: u64) -> u64 {
        let valid = |person: &&usize| self.people.all[**person].identity.not_after > time;
        asking.confirmed.iter().filter(valid).count() as u64
    }

    /// Somebody asks no more to be confirmed; answers if it did.
    pub(super) fn asks_no_more(&mut self, id: &str, who: &str) -> bool {
        self.asking.remove(&(id.to_owned(), who.to_owned())).is_some()
    }

    /// One whom too few have confirmed in time asks no more.
    pub(super) fn asks_until(&mut self, time: u64) {
        self.asking.retain(|_, asking| asking.until > time);
    }

    /// These people neither ask nor confirm any more.
    pub(super) fn asks_without(&mut self, is_gone: impl Fn(usize) -> bool) {
        self.asking.retain(|_, asking| !is_gone(asking.person));
        for asking in self.asking.values_mut() {
            asking.confirmed.retain(|confirmed| !is_gone(*confirmed));
        }
    }
}
