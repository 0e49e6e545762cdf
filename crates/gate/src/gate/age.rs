//! How old a message is, and whether it is from before a stop.
//!
//! A signer names the newest block that it knew, and for how long it had known that block. The gate knows since when it has known the
//! block and the next one itself. Both read clocks that cannot be set, so no wrong clock of any machine makes a message older or
//! younger. A block cannot be named before it is made.
//!
//! A robot at rest asks nothing. The blocks of a node that was cut off may come late then, and no question shows by how much. Until a
//! question is older than the block that a command names, certified block time limits its age.
//!
//! Where a message names no block, or one that may be from before this gate was opened, wall clocks and block time decide instead.

use ledger::transaction::{NOT_AFTER_AHEAD_MAX, Transaction};

use super::{COMMAND_TTL, Gate, Now, Refused, heads::Found};

impl Gate {
    /// The age of a message of a block of that time, microseconds.
    ///
    /// # Errors
    /// It is too old, or from before a stop; it names a block that the gate does not know.
    pub(super) fn check_time(
        &self,
        signed: &Transaction,
        block_time: u64,
        max_age_us: u64,
        now: Now,
    ) -> Result<u64, Refused> {
        check_signed_for(signed, block_time)?;
        let named = signed.body().known_block.as_ref();
        let (age, is_before_stop) = match named.map_or(Found::Older, |named| self.heads.find(named, now.steady)) {
            Found::Known { age_max, .. }
                if self.is_too_old_by_block_time(signed, block_time, (age_max, max_age_us), now) =>
            {
                return Err(Refused::TooOld);
            }
            Found::Known { signed, age, .. } => (age, signed < self.signed_since.steady() || block_time < self.ended),
            Found::Unknown => return Err(Refused::UnknownBlock),
            Found::Older => self.by_clocks(signed, block_time, now)?,
        };
        if age > max_age_us {
            return Err(Refused::TooOld);
        }
        if is_before_stop { Err(Refused::BeforeStop) } else { Ok(age) }
    }

    /// Is a command too old by certified block time? That counts only where no question shows that the command is younger than
    /// [`COMMAND_TTL`] and the service's limit, and only beyond both. So clocks that differ by less reject nothing new.
    fn is_too_old_by_block_time(
        &self,
        signed: &Transaction,
        block_time: u64,
        (age_max, max_age_us): (u64, u64),
        now: Now,
    ) -> bool {
        let limit = max_age_us.max(ttl_us());
        let age = self.clock.signed_block_time(now).saturating_sub(signed_at(signed, block_time));
        self.is_command() && age_max > limit && age > limit
    }

    /// Age, and whether it is from before a stop, by clocks.
    fn by_clocks(&self, signed: &Transaction, block_time: u64, now: Now) -> Result<(u64, bool), Refused> {
        let not_after = signed.body().not_after;
        if not_after < self.clock.now(now) {
            return Err(Refused::Expired);
        }
        let signed_before = not_after < self.signed_since.at(now).saturating_add(ttl_us());
        let is_before_stop = signed_before || block_time < self.not_before.at(now);
        Ok((self.clock.now(now).saturating_sub(signed_at(signed, block_time)), is_before_stop))
    }
}

/// May a block of this time have the transaction?
pub(super) fn check_signed_for(signed: &Transaction, block_time: u64) -> Result<(), Refused> {
    let not_after = signed.body().not_after;
    let fits = (block_time..=block_time.saturating_add(NOT_AFTER_AHEAD_MAX)).contains(&not_after);
    if fits { Ok(()) } else { Err(Refused::Expired) }
}

/// When the message was signed, by the clock of its signer. Bridges sign for [`COMMAND_TTL`]; one that is signed for longer is as old as
/// its block.
fn signed_at(signed: &Transaction, block_time: u64) -> u64 {
    signed.body().not_after.saturating_sub(ttl_us()).min(block_time)
}

/// [`COMMAND_TTL`] in microseconds.
fn ttl_us() -> u64 {
    u64::try_from(COMMAND_TTL.as_micros()).unwrap_or(u64::MAX)
}
