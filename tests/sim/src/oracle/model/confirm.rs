//! Confirmation: a contender asks, others agree, and then it competes like everybody.

use super::contest::{Stage, Wishes};
use super::{Model, Robot, Service, Verdict};
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
        (robot, service): (&Robot, &Service),
        id: &str,
        wishes: &Wishes,
        time: u64,
    ) -> bool {
        let Some(wanted) = service.setting("confirm") else { return false };
        let place = (id.to_owned(), who.id());
        if let Some(known) = self.asking.get(&place).filter(|known| known.person == person && known.until > time) {
            return self.counted(known, robot, time) < wanted;
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
        if self.counted(&asking, &robot, time) < service.setting("confirm").unwrap_or(0) {
            return Ok(Code::Ok.into());
        }
        let contender = (&people.all[asking.person], asking.person);
        // It may try again until the confirmations end, also if there is no place for it to wait now.
        let _perhaps_refused = self.compete(contender, id, &asking.wishes, Stage::Confirmed, time);
        Ok(Code::Ok.into())
    }

    /// The number of confirmations that count now: by valid certificates that policies still permit to confirm.
    fn counted(&self, asking: &Asking, robot: &Robot, time: u64) -> u64 {
        let counts = |person: &&usize| {
            let who = &self.people.all[**person];
            who.identity.not_after > time && self.governs(who, robot, time).is_ok()
        };
        asking.confirmed.iter().filter(counts).count() as u64
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

#[cfg(test)]
mod tests {
    use super::Model;
    use crate::client::{Call, Terms, sign};
    use crate::clock::{EPOCH, SECOND};
    use crate::lists::Lists;
    use crate::people::People;
    use crate::plan::Plan;
    use crate::policy::Policy;
    use ledger_base::hash::Hash;
    use ledger_base::rejection::Code;
    use std::sync::Arc;

    const SERVICE: &str = "Husky/cmd_vel";

    #[test]
    fn a_confirmation_counts_only_while_policies_permit_it() {
        let people = Arc::new(People::new());
        let mut model = Model::new(&people, Hash::ZERO, &Plan::new(0), &Lists::default());
        let (mut nonce, service) = (0, || SERVICE.to_owned());
        let mut call = |who: &str, call: Call| {
            nonce += 1;
            let who = &people.all[people.index(who, 0).unwrap()];
            let transaction = sign(who, Hash::ZERO, nonce, EPOCH + SECOND, call.transaction(), true);
            let judged = model.execute(Some(&transaction), EPOCH);
            assert_eq!(judged.code, Code::Ok, "{call:?}");
            judged.grant
        };
        let acquire = || Call::Acquire { service: service(), lease_ms: None };
        let confirm = || Call::Confirm { service: service(), contender: "Org1/Salma" };
        let terms = Terms { mode: "exclusive", sharing: r#"{"confirm":2}"# };
        call("Org2/admin", Call::Setup { open: true });
        call("Org2/admin", Call::Configure { service: service(), terms });
        call("Org2/admin", Call::Put(Policy::Trusted));
        assert_eq!(call("Org1/Salma", acquire()), None, "nobody has confirmed it");
        call("Org1/admin", confirm());
        call("Org2/admin", Call::Put(Policy::Attribute));
        call("Org2/admin", confirm());
        assert_eq!(call("Org1/Salma", acquire()), None, "one of two counts no more");
        call("Org2/admin", Call::Put(Policy::Trusted));
        assert!(call("Org1/Salma", acquire()).is_some(), "both count again");
    }
}
