//! The end of a drive: what a node tells of, and what the voters have signed. A hand-over is none.

use std::sync::Arc;

use bytes::Bytes;
use ledger::CallRef;
use ledger_contract::{Fencing, Publishing};
use ledger_identity::Identity;

use super::{Delivered, Gate, Holding, Now};
use crate::{
    ABAC,
    service::{Released, Revoked},
    standing::Members,
};

/// A driver of the robot.
#[derive(Debug)]
pub(super) struct Driver {
    /// The signer of the last command.
    identity: Arc<Identity>,
    /// The holder of the grant under which the robot moves: the signer, or whoever took over since.
    holder: String,
    /// The epoch of that grant.
    epoch: u64,
    /// When the last command came, by the steady clock (microseconds).
    pub(super) sent: u64,
    /// When its lease runs out without another sign of life, by the steady clock (microseconds).
    pub(super) until: u64,
}

impl Driver {
    /// The signer of a command of an epoch, which came at one time and lasts until another.
    pub(super) fn new(identity: Arc<Identity>, epoch: u64, (sent, until): (u64, u64)) -> Self {
        Self { holder: identity.id(), identity, epoch, sent, until }
    }
}

impl Gate {
    /// The driver holds the robot still, or has handed it over, or the robot must stop. A renewal since the last standing counts, too.
    pub(super) fn check_driver(&mut self, members: &Members, asked: u64) -> Option<&'static str> {
        let by_policy = self.rules.as_ref().is_some_and(|rules| rules.capabilities.publishing == Publishing::Policy);
        let driver = self.driver.as_mut()?;
        let holding = self.holders.get(&driver.holder).filter(|holding| holding.epoch == driver.epoch);
        let follows = |holding: &Holding| holding.follows == Some(driver.epoch) && holding.left_us > 0;
        let over = match (holding, self.holders.iter().find(|(_, holding)| follows(holding))) {
            _ if self.halted => Some("stopped"),
            _ if members.has_revoked(&driver.identity) => Some("revoked"),
            (Some(holding), _) => {
                driver.until = driver.until.max(asked.saturating_add(holding.left_us));
                None
            }
            (None, Some((holder, next))) => {
                (driver.holder, driver.epoch) = (holder.clone(), next.epoch);
                driver.until = asked.saturating_add(next.left_us);
                None
            }
            // Where a policy is enough, nothing ends but by the lease.
            (None, None) if driver.epoch == 0 && by_policy => None,
            (None, None) => Some("released"),
        };
        if over.is_some() {
            self.driver = None;
        }
        over
    }

    /// Takes the end of a grant as a node says it. True if the robot must stop: unless a newer grant is known, or the next one holds it
    /// already, as the node says. It proves nothing: the next standing may bring the holder back, or show nobody who goes on.
    pub fn released(&mut self, released: &Released, block_time: u64, now: Now) -> bool {
        if released.service != self.id {
            return false;
        }
        if self.holders.get(&released.holder).is_some_and(|known| known.epoch <= released.epoch) {
            self.holders.remove(&released.holder);
            self.told = now.steady;
        }
        // Where holders stand side by side, who moved the robot may be any of them.
        let side_by_side = self.rules.as_ref().is_none_or(|rules| rules.capabilities.fencing == Fencing::PerHolder);
        let is_newest = released.epoch >= self.epoch || side_by_side;
        // The robot that was stopped was told so.
        let stops = is_newest && !released.goes_on && !self.halted;
        if is_newest {
            self.told = now.steady;
        }
        if stops {
            self.driver = None;
            // A block of tomorrow closes nothing until then.
            let ended = block_time.min(self.clock.now(now));
            self.not_before.hear(ended);
            self.ended = self.ended.max(ended);
        }
        self.check_epochs(self.epoch);
        stops
    }

    /// Takes the stop of the robot as a node says it, early or in its block. True if the robot must stop, if it takes commands here
    /// and was not told yet. It proves nothing: a standing that settles its signed call decides; without such a call, the next one.
    pub fn halt(&mut self, signed: &Bytes, now: Now) -> bool {
        let is_command = self.rules.as_ref().is_none_or(|rules| rules.publisher.is_none());
        let was_halted = self.halted;
        if is_command {
            if let Some(call) = self.stop_of(signed) {
                self.open_stops.note(call);
            }
            self.halted = true;
            self.told = now.steady;
            self.stopped(now);
        }
        is_command && !was_halted
    }

    /// The stops whose verdicts are to be asked for, and without which no standing ends them.
    pub fn open_stops(&self) -> impl Iterator<Item = CallRef> {
        self.open_stops.calls()
    }

    /// Does a stop without a verdict keep the robot stopped?
    pub fn has_open_stops(&self) -> bool {
        !self.open_stops.is_empty()
    }

    /// The name of a signed stop. Its signature is not checked: a node that can make one up can also withhold answers.
    fn stop_of(&self, signed: &Bytes) -> Option<CallRef> {
        let signed = self.decode(Delivered { block_time: 0, transaction: signed, certificate: &Bytes::new() }).ok()?;
        let body = signed.body();
        (body.chaincode == ABAC && body.function == "stop").then(|| signed.call_ref())
    }

    /// Takes the revocation of a certificate as a node says it. True if the robot must stop, because the revoked one moved it
    /// last. It proves nothing: the next standing decides.
    pub fn revoked(&mut self, revoked: &Revoked, now: Now) -> bool {
        let key = self.identities.revoke(revoked);
        self.told = now.steady;
        let moved_it = self.driver.as_ref().is_some_and(|driver| Some(driver.identity.revocation_key()) == key);
        if moved_it {
            self.driver = None;
        }
        moved_it
    }

    /// The robot is being stopped: nothing from before this moment passes any more.
    pub fn stopped(&mut self, now: Now) {
        self.driver = None;
        self.signed_since.reach(self.clock.signed_block_time(now), now);
        self.not_before.reach(self.clock.block_time(now), now);
    }
}
