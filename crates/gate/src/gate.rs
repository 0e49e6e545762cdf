//! The gate of a robot: what a node delivers is checked again, by rules that need no trust in that node.
//!
//! A node that lies can hold messages back. It cannot make one up: the user's signature, and the network's authorities
//! vouch for it. It cannot bring one again or out of order, because of sequence numbers. It cannot bring one late:
//! its signer names the newest block that it knew, and the gate has known that block for so long ([`age`]).
//!
//! A message passes if it is `abac set` of this very service, for this network, signed by a certificate of the network
//! that was not revoked. Where the service's rule asks for them, it comes under a grant of its signer and in the newest
//! epoch. Its sequence number is above the last; it is not older than allowed; and it is from after the start of the
//! gate and its last stop. It keeps to the limits of its signer's grant: a message too many is dropped, and one that asks for more
//! speed is brought down to the limit.
//!
//! Rule, grants, authorities and revocations are learnt from a [`Standing`] only, which voters have signed. A command passes
//! for `stale_after` after the question that a standing answers. So a node that withholds the end of a grant wins no more than
//! that. An end of which a node tells stops the robot at once. Whether it was true, the answer to a later question decides. So it
//! does where the node says that the next one goes on: the robot is not stopped until then.
//!
//! No command of a stopped robot passes, whatever grants stand. That, too, a standing decides. A signed stop lasts until a
//! standing settles it by its id, and no other standing ends it. It is settled once it has a verdict, a resume has cancelled it, or
//! block time has passed its `not_after`.
//!
//! Sequence numbers are not kept on disk: instead nothing passes that a bridge signed before the gate was opened.
//!
//! The gate does no IO and reads no clock: all of it is arguments.

mod age;
mod call;
mod clock;
mod ends;
mod heads;
mod holding;
mod identities;
mod limits;
mod open_stops;
mod payloads;
mod refused;
mod sequences;

#[cfg(test)]
mod tests;

use std::{collections::BTreeMap, sync::Arc, time::Duration};

use bytes::Bytes;
use ledger::transaction::Transaction;
use ledger_base::hash::Hash;
use ledger_base::mutation::{Mutation, active};
use ledger_confidential::Keyring;
use ledger_contract::{Capabilities, Fencing, Grant, Publishing};
use ledger_identity::Identity;

use self::{
    age::check_signed_for,
    call::Call,
    clock::{Bound, Clock},
    ends::Driver,
    heads::Heads,
    holding::Holding,
    identities::Identities,
    limits::{Bounds, Rates},
    open_stops::OpenStops,
    sequences::Sequences,
};
pub use self::{clock::Now, refused::Refused};
use crate::speed::{Layout, Speeds};
use crate::{sample::Sample, service::Service, standing::Standing};

/// How long a command may be on its way to its block. Short, because what a node holds back until then could still
/// be brought to a robot.
pub const COMMAND_TTL: Duration = Duration::from_secs(2);
/// Most holders of one service.
const HOLDERS_MAX: usize = 1024;

/// The constants of an open gate.
#[derive(Clone, Debug)]
pub struct Settings {
    /// The network.
    pub network: Hash,
    /// Largest sample, in bytes with its encapsulation header.
    pub sample_bytes_max: usize,
    /// Age beyond which a message is dropped, if that is shorter than the service's.
    pub max_age: Option<Duration>,
    /// How long a standing counts from the question that it answers.
    pub stale_after: Duration,
    /// Silence of a driver after which the robot is to be stopped; none for never.
    pub command_timeout: Option<Duration>,
}

/// A transaction as a node delivers it.
#[derive(Clone, Copy, Debug)]
pub struct Delivered<'a> {
    /// Block time, as the node says (microseconds).
    pub block_time: u64,
    /// The encoded transaction.
    pub transaction: &'a Bytes,
    /// The creator's certificate, if the node shows it.
    pub certificate: &'a Bytes,
}

/// The samples of a message that passed.
#[derive(Debug, PartialEq, Eq)]
pub struct Passed {
    /// The id of its transaction.
    pub transaction: Hash,
    /// Its signer.
    pub creator: Arc<Identity>,
    /// To be published in this order.
    pub samples: Vec<Sample>,
    /// How many of them asked for more speed than the grant allows, and ask for less now.
    pub clamped: usize,
    /// Microseconds since it was signed, as the gate measures them. None if it was kept for those who come late.
    pub age_us: Option<u64>,
}

/// The gate of one service.
#[derive(Debug)]
pub struct Gate {
    settings: Settings,
    /// Id of the service.
    id: String,
    /// None while it is not known how the service stands: nothing passes.
    rules: Option<Rules>,
    /// The block of the newest standing.
    height: u64,
    /// When the question was asked that it answers, by the steady clock (microseconds).
    asked: Option<u64>,
    /// When the node last told of an end, by the steady clock (microseconds). An answer to an earlier question may be from before it.
    told: u64,
    identities: Identities,
    sequences: Sequences,
    rates: Rates,
    clock: Clock,
    /// The blocks that the node has reported.
    heads: Heads,
    /// Is the robot stopped, so that no command passes?
    halted: bool,
    /// Stops without a verdict.
    open_stops: OpenStops,
    /// The newest epoch.
    epoch: u64,
    /// The holders of the service.
    holders: BTreeMap<String, Holding>,
    /// When the gate was opened, by the steady clock (microseconds).
    opened: u64,
    /// When the gate was opened, or its last stop by itself: what bridges signed before does not pass, whatever block time the
    /// node gives it.
    signed_since: Bound,
    /// Nothing from before this block time passes.
    not_before: Bound,
    /// Block time of the last end that stopped the robot. Nothing from an earlier block passes.
    ended: u64,
    /// The last driver of the robot since its last stop.
    driver: Option<Driver>,
    /// The content keys of a confidential service, if this gate reads one.
    keyring: Option<Keyring>,
    /// The contradiction that was found here.
    fault: Option<String>,
}

/// The rule of the service's description for publishers.
#[derive(Debug)]
struct Rules {
    capabilities: Capabilities,
    /// The only organisation that publishes; none = any.
    publisher: Option<String>,
    max_age_us: u64,
    /// The layout of its messages, if they ask for a speed.
    layout: Option<Layout>,
    /// The lease where there is no grant, in microseconds.
    lease_us: u64,
    /// Are its messages encrypted?
    confidential: bool,
    /// The largest speeds of the robot itself.
    speeds: Speeds,
}

impl Gate {
    /// A gate through which nothing passes until [`Gate::learn`] tells of the service.
    pub fn new(settings: Settings, service: &str, now: Now) -> Self {
        let mut signed_since = Bound::default();
        signed_since.reach(0, now);
        Self {
            identities: Identities::default(),
            settings,
            id: service.to_owned(),
            rules: None,
            height: 0,
            asked: None,
            told: 0,
            sequences: Sequences::default(),
            rates: Rates::default(),
            clock: Clock::default(),
            heads: Heads::default(),
            halted: false,
            open_stops: OpenStops::default(),
            epoch: 0,
            holders: BTreeMap::new(),
            opened: now.steady,
            signed_since,
            not_before: Bound::default(),
            ended: 0,
            driver: None,
            keyring: None,
            fault: None,
        }
    }

    /// Takes how the robot stands, with this service of it. `asked` is when that was asked, by the steady clock in microseconds.
    /// Answers why the robot must stop, if whoever moved it may not do so any more.
    pub fn learn(&mut self, service: &Service, standing: &Standing, asked: u64, now: Now) -> Option<&'static str> {
        if self.fault.is_some() || standing.height < self.height || asked < self.told {
            return None; // more is known
        }
        let Standing { grants, stopped, settled, members, height, time, .. } = standing;
        self.clock.heard_signed(*time, now);
        self.heads.answered(*height, asked, service.is_command(), now.steady);
        if self.asked.is_none() {
            // By the network's time, which users sign by: it may be ahead of this machine's.
            let open_for = now.steady.saturating_sub(self.opened);
            self.signed_since.hear(time.saturating_sub(open_for));
        }
        (self.height, self.asked) = (*height, self.asked.max(Some(asked)));
        self.rules = Some(self.rules_of(service));
        self.open_stops.settle(settled, *time);
        if active(Mutation::ForgetAnOpenStop) {
            self.open_stops = OpenStops::default();
        }
        self.halted = (*stopped || !self.open_stops.is_empty()) && service.is_command();
        self.identities.replace(members);
        let grants = grants.iter().filter(|grant| grant.service == self.id);
        let before = self.epoch;
        self.epoch = grants.clone().map(|grant| grant.epoch).max().unwrap_or(0).max(service.epoch);
        self.holders =
            grants.take(HOLDERS_MAX).map(|grant| (grant.holder.clone(), Holding::of(grant, *time))).collect();
        self.check_epochs(before);
        self.check_driver(members, asked)
    }

    fn rules_of(&self, service: &Service) -> Rules {
        let age_us = service.max_age_ms.saturating_mul(1000);
        let own_us = self.settings.max_age.map_or(u64::MAX, |age| u64::try_from(age.as_micros()).unwrap_or(u64::MAX));
        Rules {
            capabilities: service.capabilities,
            publisher: (!service.is_command()).then(|| service.organisation.clone()),
            max_age_us: age_us.min(own_us),
            layout: Layout::of(&service.type_name),
            lease_us: service.lease_ms.saturating_mul(1000),
            confidential: service.confidential,
            speeds: service.speeds,
        }
    }

    /// The contradiction that this gate found in itself. Nothing passes any more then: the robot is to be stopped, and after
    /// that the process is to end. To end it at once, as other broken invariants do, would leave the robot moving.
    pub fn fault(&self) -> Option<&str> {
        self.fault.as_deref()
    }

    /// States that something holds; else the gate is closed for ever.
    fn must_hold(&mut self, holds: bool, found: impl FnOnce() -> String) -> bool {
        if !holds {
            self.fault.get_or_insert_with(found);
            self.rules = None;
        }
        holds
    }

    /// Epochs only grow, and no holder has one that was not given.
    fn check_epochs(&mut self, before: u64) {
        let (epoch, newest) = (self.epoch, self.holders.values().map(|holding| holding.epoch).max().unwrap_or(0));
        self.must_hold(epoch >= before && newest <= epoch, || {
            format!("epoch {epoch} of the service after {before}, the newest grant has {newest}")
        });
    }

    /// The service may have changed: nothing passes until there is a new standing.
    pub fn close(&mut self) {
        self.rules = None;
    }

    /// Does it wait for a standing?
    pub fn is_closed(&self) -> bool {
        self.rules.is_none()
    }

    /// Adds blocks that the node reports, up to this height: the first [`ledger::transaction::KNOWN_HASH_BYTES`] bytes of
    /// their hashes, one after the other. To be called before the events of these blocks are judged.
    pub fn heads(&mut self, height: u64, hashes: &[u8], now: Now) {
        self.heads.reported(height, hashes, self.is_command(), now.steady);
    }

    /// Is the service known, and one of commands to the robot?
    fn is_command(&self) -> bool {
        self.rules.as_ref().is_some_and(|rules| rules.publisher.is_none())
    }

    /// Is a question to be asked, because the node was silent for a while? Until it is answered, messages count as older than they are.
    pub fn was_silent(&self) -> bool {
        self.heads.was_silent()
    }

    /// Takes note of a sign of life with its block time.
    pub fn heard(&mut self, block_time: u64, now: Now) {
        self.clock.heard(block_time, now);
    }

    /// Takes note of a certificate that the node shows: it may belong to the creator of a later message.
    pub fn show(&mut self, certificate: &Bytes) {
        self.identities.show(certificate);
    }

    /// Lets a message pass, or says which rule it breaks.
    ///
    /// # Errors
    /// The first rule that is broken, the cheap ones first.
    pub fn pass(&mut self, delivered: Delivered<'_>, now: Now) -> Result<Passed, Refused> {
        self.judge(delivered, false, now)
    }

    /// Lets a message of a feed pass that was published before somebody listened here: however old it is, and also if it has passed
    /// before. All other rules hold, so it is its publisher's, and older than none of theirs that has passed. It need not be their
    /// last one: a node may withhold that. No command passes so.
    ///
    /// # Errors
    /// As [`Gate::pass`].
    pub fn pass_latched(&mut self, delivered: Delivered<'_>, now: Now) -> Result<Passed, Refused> {
        self.judge(delivered, true, now)
    }

    fn judge(&mut self, delivered: Delivered<'_>, is_latched: bool, now: Now) -> Result<Passed, Refused> {
        let rules = self.rules.as_ref().ok_or(Refused::NoService)?;
        let Rules {
            capabilities: Capabilities { publishing, fencing, sequence },
            max_age_us,
            lease_us,
            layout,
            confidential,
            ..
        } = *rules;
        if is_latched && rules.publisher.is_none() {
            return Err(Refused::TooOld);
        }
        let must_be_fresh = rules.publisher.is_none() && !active(Mutation::IgnoreStaleness);
        if must_be_fresh && self.fresh_until().is_none_or(|until| until < now.steady) {
            return Err(Refused::Stale);
        }
        if self.halted {
            return Err(Refused::Stopped);
        }
        let transaction = self.decode(delivered)?;
        let call = Call::read(&transaction, &self.id)?;
        let mut samples = if confidential { Vec::new() } else { self.read_samples(call.payloads)? };
        if !self.clock.heard(delivered.block_time, now) {
            return Err(Refused::FromFuture);
        }
        let age_us = if is_latched {
            check_signed_for(&transaction, delivered.block_time)?;
            None
        } else {
            Some(self.check_time(&transaction, delivered.block_time, max_age_us, now)?)
        };
        if call.epoch > self.epoch {
            return Err(Refused::UnknownEpoch);
        }
        let fences = fencing != Fencing::PerHolder && !active(Mutation::IgnoreEpochs);
        if fences && call.epoch < self.epoch {
            return Err(Refused::StaleEpoch);
        }
        let creator = self.identities.creator(&transaction, delivered.certificate, delivered.block_time)?;
        let publisher = self.rules.as_ref().and_then(|rules| rules.publisher.as_ref());
        let is_command = publisher.is_none();
        if publisher.is_some_and(|owner| *owner != creator.organisation) {
            return Err(Refused::NotOwner);
        }
        let name = creator.id();
        let is_of = |holding: &&Holding| holding.epoch == call.epoch || active(Mutation::IgnoreEpochs);
        let holding = self.holders.get(&name).filter(is_of);
        if holding.is_none() && (publishing != Publishing::Policy || call.epoch > 0) {
            return Err(Refused::NotHolder);
        }
        let lease_us = holding.map_or(lease_us, |holding| holding.lease_us);
        let (before, last) = (self.sequences.reached(&name), Some((call.epoch, call.last_seq)));
        // Who comes late may have missed the very last one.
        let may_follow = if is_latched {
            last >= before
        } else {
            self.sequences.may_follow(&name, sequence, call.epoch, call.first_seq)
        };
        if !may_follow {
            return Err(Refused::StaleSequence);
        }
        if confidential {
            samples = self.open_samples(&name, &call)?;
        }
        let clamped = self.keep_to_limits(&name, (layout, &mut samples), age_us.unwrap_or_default(), now)?;
        let left = transaction.body().not_after.saturating_sub(self.clock.now(now)).max(max_age_us);
        if !self.sequences.note(&name, (call.epoch, call.last_seq), left, now.steady) {
            return Err(Refused::TooManyPublishers);
        }
        let reached = self.sequences.reached(&name);
        let held = self.holders.get(&name).map(|holding| holding.epoch);
        let newest = self.epoch;
        let is_theirs = held == Some(call.epoch)
            || active(Mutation::IgnoreEpochs)
            || (publishing == Publishing::Policy && call.epoch == 0);
        let is_newest = !fences || call.epoch == newest;
        let grows = reached > before || reached.map(|(_, seq)| seq) > before.map(|(_, seq)| seq);
        let grows = grows || (is_latched && reached == before);
        if !self.must_hold(is_theirs && is_newest && grows, || {
            format!(
                "a message of {name} in epoch {}, who holds {held:?} of {newest}, reached {reached:?} after {before:?}",
                call.epoch
            )
        }) {
            return Err(Refused::NoService);
        }
        if is_command {
            let until = now.steady.saturating_add(lease_us);
            self.driver = Some(Driver::new(Arc::clone(&creator), call.epoch, (now.steady, until)));
        }
        Ok(Passed { transaction: transaction.id(), creator, samples, clamped, age_us })
    }

    /// Keeps the samples of a publisher to the limits of its grant, if it has one: also where it publishes without naming it.
    /// Commands must ask for speeds that are numbers, with or without a grant. Answers with the number of samples that are slower now.
    fn keep_to_limits(
        &mut self,
        publisher: &str,
        (layout, samples): (Option<Layout>, &mut [Sample]),
        age_us: u64,
        now: Now,
    ) -> Result<usize, Refused> {
        let own = self.rules.as_ref().map(|rules| rules.speeds).unwrap_or_default();
        let Some(bounds) = self.holders.get(publisher).map(|holding| holding.bounds.within(own)) else {
            let layout = layout.filter(|_| self.is_command());
            return Bounds::default().within(own).slow_down(layout, samples);
        };
        let layout = layout.filter(|_| self.is_command() || bounds.limit_speed());
        if bounds.max_age_us.is_some_and(|most| age_us > most) {
            return Err(Refused::TooOld);
        }
        let clamped = bounds.slow_down(layout, samples)?;
        self.rates.take(publisher, bounds.rate_mhz, samples.len(), now.steady)?;
        Ok(clamped)
    }

    /// The bug of [`Mutation::BelieveAGrant`].
    pub(crate) fn believe(&mut self, grant: &Grant) {
        if grant.service == self.id {
            self.epoch = self.epoch.max(grant.epoch);
            self.holders.insert(grant.holder.clone(), Holding::of(grant, grant.acquired_at));
        }
    }

    /// Does anybody hold the service?
    pub fn is_held(&self) -> bool {
        !self.holders.is_empty()
    }

    /// Has anybody moved the robot since its last stop?
    pub fn is_moving(&self) -> bool {
        self.driver.is_some()
    }

    /// The time at which the robot must stop unless its driver gives a sign of life, by the steady clock
    /// (microseconds). Its lease has run out then, also if the ledger, cut off from its leader, does not come to say
    /// so.
    pub fn deadline(&self) -> Option<u64> {
        self.driver.as_ref().map(|driver| driver.until)
    }

    /// The time at which the robot must stop unless its driver sends something, by the steady clock (microseconds). None if its
    /// driver may be silent, or nobody moves it.
    pub fn silent_at(&self) -> Option<u64> {
        let timeout = u64::try_from(self.settings.command_timeout?.as_micros()).unwrap_or(u64::MAX);
        Some(self.driver.as_ref()?.sent.saturating_add(timeout))
    }

    /// The robot rests, or is being stopped because its driver is silent. The next command moves it again.
    pub fn paused(&mut self) {
        self.driver = None;
    }

    /// The time from which on no command passes without a newer standing, by the steady clock (microseconds). None before the
    /// first one.
    pub fn fresh_until(&self) -> Option<u64> {
        let stale_us = u64::try_from(self.settings.stale_after.as_micros()).unwrap_or(u64::MAX);
        Some(self.asked?.saturating_add(stale_us))
    }

    fn decode(&self, delivered: Delivered<'_>) -> Result<Transaction, Refused> {
        let transaction = Transaction::decode(delivered.transaction.clone()).map_err(|_| Refused::Malformed)?;
        if transaction.body().network == self.settings.network.0[..] {
            Ok(transaction)
        } else {
            Err(Refused::WrongNetwork)
        }
    }
}
