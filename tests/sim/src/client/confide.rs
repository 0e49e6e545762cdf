//! The wishes of those around the confidential service: its owner, who changes the readers; the readers; and those who drive, for
//! whom every message is sealed.

use super::{Call, Client};
use crate::clock::SECOND;
use crate::confidential::{Chance, PAIRS, ROBOT, SERVICE, Terms, pair, secret};
use crate::history::Asks;
use crate::world::{Event, World};
use bytes::Bytes;
use ledger_base::rejection::Code;
use ledger_confidential::{Fresh, Sealer};
use ledger_contract::{Keyed, Readers};

/// The admin who owns the robot.
const OWNER: &str = "Org2/admin";
/// The bridge of the robot.
pub(crate) const BRIDGE: &str = "Org2/Rover";
/// Those who drive, and read what the other one says.
const DRIVERS: [&str; 2] = ["Org1/Salma", "Org2/Owen"];
/// Those who only read. Nobody trusts the last one.
const READERS: [&str; 3] = ["Org1/Farhad", "Org1/Nina", "Org3/Trudy"];
/// A message that somebody sends in the clear by mistake; it says no secret.
const CLEAR: &[u8] = &[0, 1, 0, 0, 7, 0, 0, 0];

/// The knowledge of a client about the confidential service.
#[derive(Clone, Debug, Default)]
pub(crate) struct Circle {
    /// It is here for this service.
    pub(super) belongs: bool,
    /// Which of its pairs it uses.
    nth: usize,
    /// It believes that it is a reader.
    entered: bool,
    /// The readers as it read them last; none if it must ask again.
    known: Option<Readers>,
    /// Its newest content key, and the one before.
    sealer: Option<Sealer>,
    old: Option<Sealer>,
}

impl Circle {
    /// Its process dies. The pair is on the disk.
    pub(super) fn crash(&mut self) {
        (self.known, self.sealer, self.old) = (None, None, None);
    }

    /// The readers may be others than it knows.
    fn outdated(&mut self) {
        self.known = None;
        self.old = self.sealer.take().or(self.old.take());
    }

    fn shared(&mut self, fresh: Fresh, response: &[u8]) {
        if let Ok(Keyed { key, .. }) = serde_json::from_slice(response) {
            self.old = self.sealer.replace(fresh.shared_at(key)).or(self.old.take());
        }
    }
}

impl Client {
    /// Its reading of a verdict on a call about the confidential service. Answers if the grant is lost.
    pub(super) fn hear_of_the_circle(&mut self, code: Code, call: &Call, response: &[u8]) {
        match (code, call) {
            (Code::Ok, Call::Describe(_)) => self.ready = true,
            (Code::Ok, Call::Enter { .. }) => self.circle.entered = true,
            (Code::Ok | Code::NotFound, Call::Leave) => self.circle.entered = false,
            (Code::Ok, Call::Share { fresh, .. }) => self.circle.shared(Fresh::clone(fresh), response),
            (Code::ReadersChanged | Code::BadArgument, Call::Share { .. }) => self.circle.outdated(),
            (Code::Ok, Call::Seal { epoch, seq, .. }) => drop(self.grants.insert(SERVICE.into(), (*epoch, seq + 1))),
            (Code::ReadersChanged | Code::BadArgument, Call::Seal { .. }) => self.circle.outdated(),
            (_, Call::Share { .. } | Call::Seal { .. }) => drop(self.grants.remove(SERVICE)),
            _ => {}
        }
    }

    /// Its reading of who reads.
    pub(super) fn read_of_the_circle(&mut self, response: &[u8]) {
        self.circle.known = serde_json::from_slice(response).ok();
    }
}

impl World {
    /// Hires those around the confidential service, where there is one.
    pub(super) fn employ_a_circle(&mut self) {
        if !self.plan.confidential {
            return;
        }
        for person in [OWNER, BRIDGE].into_iter().chain(DRIVERS).chain(READERS) {
            let gateway = self.random.confidential.between(1, self.plan.voters + self.plan.learners);
            let circle = Circle { belongs: true, ..Circle::default() };
            let number = self.clients.len();
            self.clients.push(Client { circle, ..Client::new(person, gateway) });
            let delay = self.random.confidential.below(3 * SECOND);
            self.schedule(delay, Event::Client { client: number, attempt: 0 });
        }
    }

    /// The wish of somebody around the confidential service, if there is one now.
    pub(super) fn confide(&mut self, number: usize) -> Option<Call> {
        if !self.plan.confidential {
            return None;
        }
        let client = &self.clients[number];
        let person = client.person.clone();
        Some(match &*person {
            OWNER if !client.ready => Call::Describe(Terms::PLAIN),
            OWNER => self.rule_the_circle(number),
            _ if DRIVERS.contains(&&*person) && self.random.confidential.percent(80) => self.drive_in_secret(number),
            _ => self.read_in_secret(number),
        })
    }

    /// The owner takes readers out, and describes its robot anew.
    fn rule_the_circle(&mut self, number: usize) -> Call {
        let readers = DRIVERS.into_iter().chain(READERS).chain([BRIDGE]);
        let readers: Vec<String> = readers.map(str::to_owned).collect();
        let random = &mut self.random.confidential;
        let lease_ms_max = 20_000 + random.below(2);
        match random.below(100) {
            0..=39 => Call::TakeOut { reader: random.pick(&readers).cloned().unwrap_or_default() },
            40..=44 => {
                let (confidential, trusts_all) = (random.percent(60), random.percent(60));
                // Then it is as before again, as soon as possible.
                self.clients[number].ready = confidential && trusts_all;
                Call::Describe(Terms { confidential, lease_ms_max, trusts_all })
            }
            45..=49 => Call::Describe(Terms { lease_ms_max, ..Terms::PLAIN }),
            50..=52 => Call::Release { service: SERVICE.to_owned() },
            53..=54 => Call::Resume { robot: "*" },
            _ => self.read_in_secret(number),
        }
    }

    /// Enters, leaves, enters with another pair, or asks who reads.
    fn read_in_secret(&mut self, number: usize) -> Call {
        let entered = self.clients[number].circle.entered;
        let random = &mut self.random.confidential;
        // One that was taken out does not know, and comes back.
        match random.below(100) {
            0..=64 if !entered => {}
            0..=24 => {}
            25..=34 => self.clients[number].circle.nth = random.below(PAIRS as u64) as usize,
            35..=44 if self.clients[number].person != BRIDGE => return Call::Leave,
            45..=46 => return Call::TakeOut { reader: BRIDGE.to_owned() },
            _ => return asks_who_reads(random.percent(50)),
        }
        self.enter(number)
    }

    fn enter(&self, number: usize) -> Call {
        let client = &self.clients[number];
        // The bridge of a robot that is looked at has one pair.
        let nth = if client.person == BRIDGE { 0 } else { client.circle.nth };
        Call::Enter { key: pair(&client.person, nth).public_hex() }
    }

    /// Drives: takes the service, shares a key, seals messages; and errs now and then.
    fn drive_in_secret(&mut self, number: usize) -> Call {
        let client = &self.clients[number];
        let Some((epoch, seq)) = client.grants.get(SERVICE).copied() else { return self.speak(number) };
        let (has_key, knows) = (client.circle.sealer.is_some(), client.circle.known.is_some());
        match self.random.confidential.below(100) {
            0..=3 => Call::Release { service: SERVICE.to_owned() },
            4..=7 => Call::Renew { service: SERVICE.to_owned() },
            // With a key from before.
            8..=12 => self.seal(number, true).unwrap_or_else(|| asks_who_reads(true)),
            13..=14 => Call::Seal { epoch, seq, payload: CLEAR.into() },
            15..=19 if knows => self.share_with(number, true),
            20..=24 if knows && has_key => self.share_with(number, false),
            _ => self.speak(number),
        }
    }

    /// The next step of one who wants to say something on the confidential service.
    pub(super) fn speak(&mut self, number: usize) -> Call {
        let client = &self.clients[number];
        if !client.grants.contains_key(SERVICE) {
            return Call::Acquire { service: SERVICE.to_owned(), lease_ms: None };
        }
        match (&client.circle.sealer, &client.circle.known) {
            (None, None) => asks_who_reads(true),
            (None, Some(_)) => self.share_with(number, false),
            _ => self.seal(number, false).unwrap_or_else(|| asks_who_reads(true)),
        }
    }

    /// Shares a new content key with the readers that the client knows; `errs`: but one.
    fn share_with(&mut self, number: usize, errs: bool) -> Call {
        let client = &self.clients[number];
        let epoch = client.grants.get(SERVICE).map_or(0, |(epoch, _)| *epoch);
        let Some(mut readers) = client.circle.known.clone() else { return asks_who_reads(true) };
        if errs && let Some(first) = readers.readers.first_mut() {
            first.may_read = !first.may_read;
        }
        let chance = &mut Chance(&mut self.random.confidential);
        let (share, fresh) = Sealer::share_with(chance, &self.network, &client.person, &readers).unwrap();
        Call::Share { epoch, share: serde_json::to_string(&share).unwrap(), fresh: Box::new(fresh) }
    }

    /// Seals a message under the newest content key of the client, or the one before.
    fn seal(&mut self, number: usize, old: bool) -> Option<Call> {
        let client = &self.clients[number];
        let (epoch, seq) = client.grants.get(SERVICE).copied().unwrap_or_default();
        let sealer = if old { &client.circle.old } else { &client.circle.sealer };
        let message = secret(self.random.confidential.number());
        let chance = &mut Chance(&mut self.random.confidential);
        let payload: Bytes = sealer.as_ref()?.seal_with(chance, epoch, seq, &message).unwrap();
        self.sealed.insert(payload.clone(), message);
        Some(Call::Seal { epoch, seq, payload })
    }

    /// In the end the owner describes its robot, its bridge enters, and somebody says something in secret.
    pub(crate) fn last_secrets(&self) -> [(&'static str, Vec<Call>); 3] {
        let key = pair(BRIDGE, 0).public_hex();
        let says = Call::Seal { epoch: 0, seq: 0, payload: Bytes::new() };
        let release = || Call::Release { service: SERVICE.to_owned() };
        [
            (OWNER, vec![Call::Describe(Terms::PLAIN), Call::Resume { robot: ROBOT }, release()]),
            (BRIDGE, vec![Call::Enter { key }]),
            ("Org1/Nina", vec![says, release()]),
        ]
    }
}

fn asks_who_reads(linearizable: bool) -> Call {
    Call::Read { asks: Asks::Readers, service: SERVICE.to_owned(), linearizable }
}
