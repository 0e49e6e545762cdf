//! The answers to those around the confidential service, and who read what.

use super::Coverage;
use crate::client::Call;
use ledger_base::rejection::Code;

/// Those that must happen.
pub(super) const CONFIDENTIAL: [&str; 15] = [
    "reader entered",
    "reader refused by policies",
    "reader left",
    "reader taken out",
    "taken out by one who may not",
    "content key shared",
    "content key for others refused",
    "message sealed",
    "message refused: the readers changed",
    "message refused: not sealed",
    "message opened by a reader",
    "message kept from one who was taken out",
    "message kept from one who came later",
    "message read by one who had left",
    "sealed message passed a gate",
];

impl Coverage {
    /// Counts what happened around the confidential service.
    pub fn confides(&mut self, what: &'static str) {
        *self.confidential.entry(what).or_default() += 1;
    }

    /// Counts an answer.
    pub(crate) fn answers_in_secret(&mut self, call: &Call, code: Code) {
        if let Some(what) = name(call, code) {
            self.confides(what);
        }
    }
}

fn name(call: &Call, code: Code) -> Option<&'static str> {
    Some(match (call, code) {
        (Call::Enter { .. }, Code::Ok) => "reader entered",
        (Call::Enter { .. }, Code::DeniedByPolicy | Code::MissingAttribute) => "reader refused by policies",
        (Call::Leave, Code::Ok) => "reader left",
        (Call::TakeOut { .. }, Code::Ok) => "reader taken out",
        (Call::TakeOut { .. }, Code::NotOwner) => "taken out by one who may not",
        (Call::Share { .. }, Code::Ok) => "content key shared",
        (Call::Share { .. }, Code::ReadersChanged) => "content key for others refused",
        (Call::Seal { .. }, Code::Ok) => "message sealed",
        (Call::Seal { .. }, Code::ReadersChanged) => "message refused: the readers changed",
        (Call::Seal { .. }, Code::BadArgument) => "message refused: not sealed",
        _ => return None,
    })
}
