//! Readers of confidential services, and the content keys that publishers share with them (docs/policies.md and
//! docs/decisions/0105).

use super::sets::Policies;
use super::{Judged, Model, Robot, Service, Verdict};
use crate::people::Person;
use bytes::Bytes;
use ledger_base::rejection::Code;
use ledger_contract::{Envelope, Share};
use ledger_identity::Role;
use std::collections::{BTreeMap, BTreeSet};

/// A content key is good for so long after a reader came, or went of its own accord.
const GRACE: u64 = 2_000_000;

/// The readers of a service.
#[derive(Clone, Default)]
pub(super) struct Circle {
    /// By name: index among the people, and the public half of the pair.
    entered: BTreeMap<String, (usize, String)>,
    /// Those who went of their own accord, or came back with another pair.
    gone: BTreeSet<(String, String)>,
    /// How many were taken out.
    losses: u64,
    /// How many came and went, and when the last one did.
    moves: (u64, u64),
    /// By publisher.
    shared: BTreeMap<String, Shared>,
}

/// The newest content key of a publisher, with all for which it was made. A run is shorter than the life of a key.
#[derive(Clone)]
struct Shared {
    height: u64,
    losses: u64,
    moves: u64,
    robot: Robot,
    policies: Policies,
}

/// A reader as `readers` lists it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(in crate::oracle) struct Listed {
    pub(in crate::oracle) reader: String,
    pub(in crate::oracle) key: String,
    pub(in crate::oracle) may_read: bool,
}

impl Model {
    /// Those who have entered, by name.
    pub(in crate::oracle) fn readers(&self, service: &str, time: u64) -> Vec<Listed> {
        let entered = self.circles.get(service).into_iter().flat_map(|circle| &circle.entered);
        let listed = |(reader, (person, key)): (&String, &(usize, String))| {
            let may_read = self.may_have_keys(&self.people.all[*person], service, time);
            Listed { reader: reader.clone(), key: key.clone(), may_read }
        };
        entered.map(listed).collect()
    }

    /// Might somebody who is not entered any more open a message of this time? A key from before is good for a while after one
    /// went of its own accord.
    pub(in crate::oracle) fn may_linger(&self, service: &str, reader: &str, key: &str, time: u64) -> bool {
        self.circles.get(service).is_some_and(|circle| {
            let left = circle.gone.contains(&(reader.to_owned(), key.to_owned()));
            left && time < circle.moves.1 + GRACE
        })
    }

    /// May this person have the content keys of a service? The owner's admins and machines always.
    pub(in crate::oracle) fn may_have_keys(&self, who: &Person, service: &str, time: u64) -> bool {
        let owns = self.find(service).is_ok_and(|(robot, _)| stands_for_the_owner(who, &robot));
        who.identity.not_after > time && (owns || self.may_read(who, service, time).is_ok())
    }

    /// The heights of the newest content keys, by publisher.
    pub(in crate::oracle) fn key_places(&self, service: &str) -> Vec<(String, u64)> {
        let shared = self.circles.get(service).into_iter().flat_map(|circle| &circle.shared);
        shared.map(|(publisher, shared)| (publisher.clone(), shared.height)).collect()
    }

    pub(super) fn reader(&mut self, (who, person): (&Person, usize), args: &[Bytes], time: u64) -> Verdict {
        let [service, key] = [0, 1].map(|at| text(args, at));
        let reader = if args.len() > 2 { text(args, 2) } else { who.id() };
        let (robot, _) = self.find(&service)?;
        let is_owners_admin = who.identity.role == Role::Admin && who.identity.organisation == robot.owner;
        if reader != who.id() && !(key == "none" && is_owners_admin) {
            return Err(Code::NotOwner);
        }
        if key == "none" {
            let circle = self.circles.entry(service).or_default();
            let (_, key) = circle.entered.remove(&reader).ok_or(Code::NotFound)?;
            if reader == who.id() {
                circle.goes(reader, key, time)
            } else {
                circle.losses += 1
            }
            return Ok(Code::Ok.into());
        }
        if !stands_for_the_owner(who, &robot) {
            self.may_read(who, &service, time)?;
        }
        let circle = self.circles.entry(service).or_default();
        circle.gone.remove(&(reader.clone(), key.clone()));
        match circle.entered.insert(reader.clone(), (person, key.clone())) {
            Some((_, before)) if before != key => circle.goes(reader, before, time),
            _ => circle.moves = (circle.moves.0 + 1, time),
        }
        Ok(Code::Ok.into())
    }

    pub(super) fn share(&mut self, who: &Person, args: &[Bytes], time: u64) -> Verdict {
        let (id, epoch) = (text(args, 0), super::number(Some(text(args, 1)))?.unwrap_or(0));
        let (robot, service) = self.find(&id)?;
        if !service.is_confidential() {
            return Err(Code::BadArgument);
        }
        let share: Share = serde_json::from_str(&text(args, 2)).map_err(|_| Code::BadArgument)?;
        self.may_publish(who, &id, epoch, time)?;
        let height = self.network_of_nodes.height();
        let circle = self.circles.get(&id).cloned().unwrap_or_default();
        if circle.shared.get(&who.id()).is_some_and(|shared| shared.height >= height) {
            return Err(Code::LimitExceeded);
        }
        let wanted: Vec<Listed> = self.readers(&id, time).into_iter().filter(|listed| listed.may_read).collect();
        let is_owners = |listed: &&Listed| {
            let (person, _) = circle.entered[&listed.reader];
            stands_for_the_owner(&self.people.all[person], &robot)
        };
        let given = share.readers.iter().map(|one| (&one.reader, &one.key));
        if !wanted.iter().any(|listed| is_owners(&listed))
            || !given.eq(wanted.iter().map(|listed| (&listed.reader, &listed.key)))
        {
            return Err(Code::ReadersChanged);
        }
        let shared = Shared {
            height,
            losses: circle.losses,
            moves: circle.moves.0,
            policies: self.policies_of(&robot.owner),
            robot,
        };
        self.circles.entry(id).or_default().shared.insert(who.id(), shared);
        Ok(Judged::from(Code::Ok))
    }

    /// Is a message sealed as its service wants it, under a key that is good?
    pub(super) fn check_key(&self, who: &Person, id: &str, payload: &[u8], time: u64) -> Result<(), Code> {
        let (robot, service) = self.find(id)?;
        let envelope = Envelope::parse(payload);
        let Some(envelope) = envelope.filter(|_| service.is_confidential()) else {
            return if service.is_confidential() || envelope.is_some() { Err(Code::BadArgument) } else { Ok(()) };
        };
        let circle = self.circles.get(id).ok_or(Code::ReadersChanged)?;
        let shared = circle.shared.get(&who.id()).filter(|shared| shared.height == envelope.key);
        let shared = shared.ok_or(Code::ReadersChanged)?;
        let same = shared.losses == circle.losses
            && shared.robot == robot
            && shared.policies == self.policies_of(&robot.owner);
        let (moves, moved_at) = circle.moves;
        let in_time = shared.moves == moves || (time < moved_at + GRACE && self.newest_revocation.1 < shared.height);
        if same && in_time { Ok(()) } else { Err(Code::ReadersChanged) }
    }

    /// With a revoked certificate nobody reads any more, and nobody lingers.
    pub(super) fn read_no_more(&mut self, is_revoked: impl Fn(usize) -> bool) {
        if self.revoked.len() > self.newest_revocation.0 {
            self.newest_revocation = (self.revoked.len(), self.network_of_nodes.height());
            self.circles.values_mut().for_each(|circle| circle.gone.clear());
        }
        for circle in self.circles.values_mut() {
            let before = circle.entered.len();
            circle.entered.retain(|_, (person, _)| !is_revoked(*person));
            circle.losses += (before - circle.entered.len()) as u64;
        }
    }
}

impl Circle {
    /// A reader goes of its own accord, or comes back with another pair.
    fn goes(&mut self, reader: String, key: String, time: u64) {
        self.gone.insert((reader, key));
        self.moves = (self.moves.0 + 1, time);
    }
}

impl Service {
    /// Are its messages for its readers alone?
    pub(super) fn is_confidential(&self) -> bool {
        self.sharing.get("confidential").and_then(serde_json::Value::as_bool).unwrap_or(false)
    }
}

/// An admin, a node or a robot of the owner.
fn stands_for_the_owner(who: &Person, robot: &Robot) -> bool {
    who.identity.organisation == robot.owner && who.identity.role != Role::Member
}

fn text(args: &[Bytes], at: usize) -> String {
    args.get(at).map(|bytes| String::from_utf8_lossy(bytes).into_owned()).unwrap_or_default()
}
