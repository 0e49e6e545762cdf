//! A holder passes its grant on, and takes it back.

use super::tasks::Why;
use super::{Answer, Got, Holder, Model};
use ledger_base::rejection::Code;

const GIVERS_MAX: usize = 4;

/// One who passed a grant on, with what it had.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Giver {
    pub(super) who: usize,
    priority: i64,
    may_delegate: bool,
    pub(super) ends_by: Option<u64>,
}

impl Model {
    /// `lasts` says for how long, if it is not for good.
    pub(crate) fn pass_on(
        &mut self,
        at: usize,
        (who, to): (usize, usize),
        lends: Option<(Option<u64>, bool)>,
        now: u64,
    ) -> Answer {
        self.find(at)?;
        let own = self.holder(at, who).cloned().ok_or(Code::NotHolder)?;
        let allowed = own.givers.is_empty() || own.may_delegate && (lends.is_none() || own.givers.len() < GIVERS_MAX);
        if !self.services[at].settings.delegable || own.taken || own.task.is_some() || !allowed {
            return Err(Code::NotDelegable);
        }
        if who == to || own.givers.iter().any(|giver| giver.who == to) || self.holder(at, to).is_some() {
            return Err(Code::BadArgument);
        }
        let mut next = own.clone();
        if let Some((lasts, may_delegate)) = lends {
            let Holder { priority, ends_by, .. } = own;
            next.givers.push(Giver { who, priority, may_delegate: own.may_delegate, ends_by });
            next.may_delegate = may_delegate;
            next.ends_by = lasts.map(|lasts| now + lasts);
        }
        (next.who, next.priority) = (to, self.services[at].settings.priority(to, 0));
        self.may_keep(&next)?;
        Ok(self.follow(at, own.epoch, next, now))
    }

    pub(crate) fn recall(&mut self, at: usize, who: usize, now: u64) -> Answer {
        self.find(at)?;
        let place = |holder: &Holder| holder.givers.iter().position(|giver| giver.who == who);
        let found = self.services[at].holders.iter().find_map(|holder| Some((holder.clone(), place(holder)?)));
        let (holder, place) = found.ok_or(Code::NotHolder)?;
        if self.holder(at, who).is_some() {
            return Err(Code::BadArgument);
        }
        let Giver { priority, may_delegate, ends_by, .. } = holder.givers[place].clone();
        let givers = holder.givers[..place].to_vec();
        let next = Holder { who, priority, may_delegate, ends_by, givers, ..holder.clone() };
        self.may_keep(&next)?;
        Ok(self.follow(at, holder.epoch, next, now))
    }

    /// A grant comes in the place of another one, with a new epoch.
    fn follow(&mut self, at: usize, before: u64, next: Holder, now: u64) -> Got {
        self.end(at, Why::GivenBack, now, |holder| holder.epoch == before);
        self.leave(at, next.who);
        let epoch = self.give(at, next.who, next.priority, now);
        let given = self.services[at].holders.last_mut().unwrap();
        *given = Holder { epoch, expires: next.until(now), ..next };
        Got::Granted(epoch)
    }
}
