//! Grants, as far as the gate asks for them.

use ledger_contract::Grant;

use super::limits::Bounds;

/// The record of a grant.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Holding {
    pub(super) epoch: u64,
    /// How long it lasts without being used or renewed, in microseconds.
    pub(super) lease_us: u64,
    /// How long it lasted still, without that, when it became known, in microseconds.
    pub(super) left_us: u64,
    /// The epoch that it follows without a stop between.
    pub(super) follows: Option<u64>,
    pub(super) bounds: Bounds,
}

impl Holding {
    /// With the lease as of a block time.
    pub(super) fn of(grant: &Grant, time: u64) -> Self {
        let lease_us = grant.lease_ms.saturating_mul(1000);
        let left_us = grant.expires.saturating_sub(time);
        let bounds = Bounds::from(&grant.limits);
        Self { epoch: grant.epoch, lease_us, left_us, follows: grant.follows, bounds }
    }
}
