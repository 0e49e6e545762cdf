//! One holder at a time, first come, first served.

use super::{Decision, Rule};
use crate::records::principal::Principal;
use ledger_contract::{Capabilities, Fencing, Grant, Publishing, Sequence};

/// The holder of the service keeps it from the others.
pub(super) struct Exclusive;

impl Rule for Exclusive {
    fn capabilities(&self) -> Capabilities {
        Capabilities { publishing: Publishing::Grant, fencing: Fencing::Newest, sequence: Sequence::PerEpoch }
    }

    fn decide<'g>(&self, _contender: &Principal, holders: &[&'g Grant]) -> Decision<'g> {
        holders.first().map_or_else(|| Decision::Grant { ends: Vec::new() }, |holder| Decision::Wait(holder))
    }
}
