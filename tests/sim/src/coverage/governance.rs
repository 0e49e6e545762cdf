//! The answers to admins about sets of policies, proposals and revocation lists, from the chain or from a gateway.

use super::Coverage;
use crate::client::Call;
use ledger_base::rejection::Code;

/// Those that must be given.
pub(super) const GOVERNANCE: [&str; 22] = [
    "set applied",
    "set restored",
    "set refused as stale",
    "set refused: others must agree",
    "set refused: nobody may publish",
    "older set not kept",
    "set proposed",
    "set proposed that is in force",
    "too many sets proposed",
    "proposal approved",
    "proposal approved too late",
    "proposal withdrawn",
    "proposal enacted",
    "proposal of another organisation",
    "proposal enacted too early",
    "proposal enacted too late",
    "single policy refused: others must agree",
    "rule of the network proposed",
    "rule of the network in force",
    "list taken",
    "list refused as old",
    "list refused as not signed",
];

impl Coverage {
    /// Counts an answer to an admin.
    pub(crate) fn governs(&mut self, call: &Call, code: Code) {
        if let Some(what) = name(call, code) {
            *self.governance.entry(what).or_default() += 1;
        }
    }
}

fn name(call: &Call, code: Code) -> Option<&'static str> {
    Some(match (call, code) {
        (Call::Apply(draft), Code::Ok) if draft.restores.is_some() => "set restored",
        (Call::Apply(_), Code::Ok) => "set applied",
        (Call::Apply(_) | Call::Propose(_), Code::PoliciesChanged) => "set refused as stale",
        (Call::Apply(_), Code::NeedsApproval) => "set refused: others must agree",
        (Call::Apply(_) | Call::Propose(_), Code::NobodyMayPublish) => "set refused: nobody may publish",
        (Call::Apply(_) | Call::Propose(_), Code::NotFound) => "older set not kept",
        (Call::Propose(_), Code::Ok) => "set proposed",
        (Call::Propose(_), Code::AlreadyExists) => "set proposed that is in force",
        (Call::Propose(_), Code::LimitExceeded) => "too many sets proposed",
        (Call::Approve { .. }, Code::Ok) => "proposal approved",
        (Call::Approve { .. }, Code::PoliciesChanged) => "proposal approved too late",
        (Call::Withdraw { .. }, Code::Ok) => "proposal withdrawn",
        (Call::Enact { .. }, Code::Ok) => "proposal enacted",
        (Call::Enact { .. }, Code::NotOwner) => "proposal of another organisation",
        (Call::Enact { .. }, Code::NeedsApproval) => "proposal enacted too early",
        (Call::Enact { .. }, Code::PoliciesChanged) => "proposal enacted too late",
        (Call::Put(_) | Call::Remove(_), Code::NeedsApproval) => "single policy refused: others must agree",
        (Call::ProposeRule { .. }, Code::Ok) => "rule of the network proposed",
        (Call::Publish { .. }, Code::Ok) => "list taken",
        (Call::Publish { .. }, Code::OldList) => "list refused as old",
        (Call::Publish { .. }, Code::Untrusted) => "list refused as not signed",
        _ => return None,
    })
}
