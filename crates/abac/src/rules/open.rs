//! Any number of holders, and publishers without a grant.

use super::{Decision, Rule};
use crate::records::principal::Principal;
use ledger_contract::{Capabilities, Fencing, Grant, Publishing, Sequence};

/// Everybody whom policies permit.
pub(super) struct Open;

impl Rule for Open {
    fn capabilities(&self) -> Capabilities {
        Capabilities { publishing: Publishing::Policy, fencing: Fencing::PerHolder, sequence: Sequence::PerPublisher }
    }

    fn decide<'g>(&self, _contender: &Principal, _holders: &[&'g Grant]) -> Decision<'g> {
        Decision::Grant { ends: Vec::new() }
    }
}
