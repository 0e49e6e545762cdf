//! Others agree that somebody competes.

use super::{Answer, Got, Model, OWNER};
use ledger_rejection::Code;

/// One who waits for others to agree.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Asking {
    pub(crate) who: usize,
    pub(crate) until: u64,
    pub(super) confirmed: Vec<usize>,
    /// How much lower a priority it wants, and how long it waits.
    wishes: (i64, Option<u64>),
}

impl Model {
    /// Must others agree before this one competes? It asks them if it did not before.
    pub(super) fn must_be_confirmed(&mut self, at: usize, who: usize, wishes: (i64, Option<u64>), now: u64) -> bool {
        let service = &mut self.services[at];
        let Some(wanted) = service.settings.confirm else { return false };
        if let Some(known) = service.asking.iter().find(|asking| asking.who == who && asking.until > now) {
            return known.confirmed.len() < wanted;
        }
        service.asking.retain(|asking| asking.who != who);
        let until = now + service.settings.confirm_within;
        service.asking.push(Asking { who, until, confirmed: vec![], wishes });
        true
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
        let before = self.clone();
        let asking = &mut self.services[at].asking[asking];
        asking.confirmed.retain(|confirmed| *confirmed != by);
        asking.confirmed.push(by);
        let (count, wishes) = (asking.confirmed.len(), asking.wishes);
        if count < self.services[at].settings.confirm.unwrap_or(0) {
            return Ok(Got::Done);
        }
        match self.compete(at, who, wishes, false, now) {
            Err(Code::LineFull) => {
                *self = before;
                Err(Code::LineFull)
            }
            // It may try again.
            _ => Ok(Got::Done),
        }
    }
}
