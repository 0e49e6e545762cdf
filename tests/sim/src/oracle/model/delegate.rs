//! Grants that are passed on, for a while or for good, and taken back.

use super::ends::Why;
use super::{Grant, Judged, Model, Person, Robot, Service, Verdict};
use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_base::rejection::Code;
use serde::Deserialize;
use std::sync::Arc;

/// Most who pass one grant on, one after the other.
const GIVERS_MAX: usize = 4;
/// Bounds of the time for which a grant is passed on, milliseconds.
const FOR_MS: std::ops::RangeInclusive<u64> = 100..=86_400_000;

/// The part of a grant that comes from those who had the service before.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Chain {
    /// Those who passed it on, the first one first.
    givers: Vec<Giver>,
    may_delegate: bool,
    /// When it ends in any case (block time, microseconds).
    pub(super) ends_by: Option<u64>,
    /// Did somebody else have it before, without a break?
    pub(super) goes_on: bool,
}

/// One who passed a grant on, with the grant that it had.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Giver {
    certificate: Hash,
    lease_ms: u64,
    priority: i64,
    may_delegate: bool,
    ends_by: Option<u64>,
}

/// The terms of a grant that is given.
pub(super) struct Award {
    pub(super) lease_ms: u64,
    pub(super) priority: i64,
    pub(super) since: u64,
    pub(super) chain: Chain,
}

#[derive(Default, Deserialize)]
struct Options {
    for_ms: Option<u64>,
    #[serde(default)]
    may_delegate: bool,
}

impl Grant {
    /// Of the holder, and of those who passed it on.
    pub(super) fn certificates(&self) -> impl Iterator<Item = &Hash> {
        [&self.certificate].into_iter().chain(self.chain.givers.iter().map(|giver| &giver.certificate))
    }

    /// When a lease that begins now ends.
    pub(super) fn until(&self, people: &crate::people::People, time: u64) -> u64 {
        let people = self.certificates().filter_map(|certificate| people.by_fingerprint(certificate));
        let givers = self.chain.givers.iter().filter_map(|giver| giver.ends_by);
        let bounds = people.map(|person| person.identity.not_after).chain(givers).chain(self.chain.ends_by);
        bounds.fold(time + self.lease_ms * 1000, u64::min)
    }
}

impl Model {
    pub(super) fn pass_on(&mut self, who: &Person, args: &[Bytes], for_good: bool, time: u64) -> Verdict {
        let [id, to] = [text(args, 0), text(args, 1)];
        let options = options(args, 2)?;
        if options.for_ms.is_some_and(|ms| !FOR_MS.contains(&ms)) {
            return Err(Code::BadArgument);
        }
        let (robot, service) = self.find(&id)?;
        let own = self.own(who, &id, time).ok_or(Code::NotHolder)?;
        may_be_passed(&service, &own, for_good)?;
        let passed_it = own.chain.givers.iter().any(|giver| self.name(&giver.certificate) == to);
        let has_one = self.live(&id, time).iter().any(|grant| grant.holder == to);
        if own.holder == to || passed_it || has_one {
            return Err(Code::BadArgument);
        }
        let people = Arc::clone(&self.people);
        let receiver = self.newest_of(&to, time).and_then(|at| people.all.get(at)).ok_or(Code::NotFound)?;
        let ends_by = options.for_ms.map(|ms| time + ms * 1000);
        let mut chain = Chain { ends_by, goes_on: true, ..own.chain.clone() };
        if for_good {
            chain.ends_by = own.chain.ends_by;
        } else {
            chain.may_delegate = options.may_delegate;
            let Grant { certificate, lease_ms, priority, .. } = own;
            let Chain { may_delegate, ends_by, .. } = own.chain;
            chain.givers.push(Giver { certificate, lease_ms, priority, may_delegate, ends_by });
        }
        self.permits_all(receiver, &chain, (&robot, &service), time)?;
        let priority = service.priority(receiver, &robot, None);
        let award = Award { lease_ms: own.lease_ms, priority, since: own.since, chain };
        Ok(self.follow(receiver, &id, own.epoch, award, time))
    }

    pub(super) fn recall(&mut self, who: &Person, args: &[Bytes], time: u64) -> Verdict {
        let id = text(args, 0);
        let (robot, service) = self.find(&id)?;
        let live = self.live(&id, time);
        let place =
            |grant: &Grant| grant.chain.givers.iter().position(|giver| self.name(&giver.certificate) == who.id());
        let found = live.iter().find_map(|grant| Some((grant, place(grant)?)));
        let (grant, place) = found.ok_or(Code::NotHolder)?;
        if live.iter().any(|grant| grant.holder == who.id()) {
            return Err(Code::BadArgument);
        }
        let giver = grant.chain.givers.get(place).cloned().ok_or(Code::NotHolder)?;
        let givers = grant.chain.givers.iter().take(place).cloned().collect();
        let chain = Chain { givers, may_delegate: giver.may_delegate, ends_by: giver.ends_by, goes_on: true };
        self.permits_all(who, &chain, (&robot, &service), time)?;
        let award = Award { lease_ms: giver.lease_ms, priority: giver.priority, since: grant.since, chain };
        Ok(self.follow(who, &id, grant.epoch, award, time))
    }

    /// A grant follows another one, and its holder waits no longer.
    fn follow(&mut self, who: &Person, id: &str, epoch: u64, award: Award, time: u64) -> Judged {
        self.end_epoch(id, Some(epoch), Why::GivenBack, time);
        self.leave(id, &who.id());
        self.asks_no_more(id, &who.id());
        self.give_on(who, id, award, time)
    }

    /// Do the policies let one hold a service, and those who passed it on as well?
    pub(super) fn permits_all(
        &self,
        who: &Person,
        chain: &Chain,
        (robot, service): (&Robot, &Service),
        time: u64,
    ) -> Result<(), Code> {
        self.permits(who, robot, service, time)?;
        let givers = chain.givers.iter().filter_map(|giver| self.people.by_fingerprint(&giver.certificate));
        givers.into_iter().try_for_each(|giver| self.permits(giver, robot, service, time))
    }

    /// Several services at once, or none of them.
    pub(super) fn acquire_all(&mut self, caller: (&Person, usize), args: &[Bytes], time: u64) -> Verdict {
        let wishes = self.wishes(Some(text(args, 0)))?;
        let services: Vec<String> = (1..args.len()).map(|at| text(args, at)).collect();
        for (at, id) in services.iter().enumerate() {
            let (_, service) = self.find(id)?;
            if services.iter().take(at).any(|before| before == id) {
                return Err(Code::BadArgument);
            }
            super::grants::check_lease(&service, wishes.lease_ms)?;
        }
        for id in &services {
            let judged = self.compete(caller, id, &wishes.at_once(), super::contest::Stage::Asks, time)?;
            // One that others must confirm first is none of those who get all.
            judged.grant.ok_or(Code::Held)?;
        }
        Ok(Code::Ok.into())
    }

    fn name(&self, certificate: &Hash) -> String {
        self.people.by_fingerprint(certificate).map(Person::id).unwrap_or_default()
    }
}

/// Do the owner, and those who gave the grant, allow it to be passed on?
fn may_be_passed(service: &Service, own: &Grant, for_good: bool) -> Result<(), Code> {
    let givers = own.chain.givers.len();
    let allowed = own.chain.may_delegate && (givers < GIVERS_MAX || for_good);
    if service.is_delegable() && !own.is_taken() && own.task.is_none() && (givers == 0 || allowed) {
        Ok(())
    } else {
        Err(Code::NotDelegable)
    }
}

fn options(args: &[Bytes], at: usize) -> Result<Options, Code> {
    let parse = |text: &Bytes| serde_json::from_slice(text).map_err(|_| Code::BadArgument);
    args.get(at).map_or(Ok(Options::default()), parse)
}

pub(super) fn text(args: &[Bytes], at: usize) -> String {
    args.get(at).map(|bytes| String::from_utf8_lossy(bytes).into_owned()).unwrap_or_default()
}
