//! Others agree that somebody competes.

use super::{Answer, Got, Model, OWNER};
use ledger_base::rejection::Code;

/// One who waits for others to agree.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Asking {
    pub(crate) who: usize,
    pub(crate) until: u64,
    pub(super) confirmed: Vec<usize>,
    /// The priority that it wants, and how long it waits.
    wishes: (i64, Option<u64>),
}

impl Model {
    /// Must others agree before this one competes? It asks them if it did not before.
    pub(super) fn must_be_confirmed(&mut self, at: usize, who: usize, wishes: (i64, Option<u64>), now: u64) -> bool {
        let service = &self.services[at];
        let Some(wanted) = service.settings.confirm else { return false };
        if let Some(known) = service.asking.iter().find(|asking| asking.who == who && asking.until > now) {
            return self.agreed(known) < wanted;
        }
        let service = &mut self.services[at];
        service.asking.retain(|asking| asking.who != who);
        let until = now + service.settings.confirm_within;
        service.asking.push(Asking { who, until, confirmed: vec![], wishes });
        true
    }

    /// How many have confirmed it who still may.
    fn agreed(&self, asking: &Asking) -> usize {
        asking.confirmed.iter().filter(|who| **who == OWNER || self.permits(**who).is_ok()).count()
    }

    pub(crate) fn confirm(&mut self, at: usize, by: usize, who: usize, now: u64) -> Answer {
        self.find(at)?;
        let asking = self.services[at].asking.iter().position(|asking| asking.who == who && asking.until > now);
        let asking = asking.ok_or(Code::NotFound)?;
        if by == who {
            return Err(Code::BadArgument);
        }
        if by != OWNER {
            self.permits(by)?;
        }
        let asking = &mut self.services[at].asking[asking];
        asking.confirmed.retain(|confirmed| *confirmed != by);
        asking.confirmed.push(by);
        let (asking, settings) = (asking.clone(), self.services[at].settings);
        if self.agreed(&asking) >= settings.confirm.unwrap_or(0) {
            let ((asked, wait), own) = (asking.wishes, settings.priority(who, 0));
            // If it is refused, it may try again.
            let _ = self.compete(at, who, (own - own.min(asked), wait), false, now);
        }
        Ok(Got::Done)
    }
}
