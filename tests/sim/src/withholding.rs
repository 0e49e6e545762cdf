//! The filter of a leader that withholds control calls: it takes them, and orders other things.

use ledger::transaction::Transaction;
use ledger_raft::{Input, Lane, PeerMessage};
use ledger_replica::Event;

/// Takes the control calls and questions out of an event of a leader. Answers whether nothing is left of it, and whether something was
/// taken out.
pub(crate) fn withhold(event: &mut Event) -> (bool, bool) {
    match event {
        Event::Input(Input::Submit { lane: Lane::Control, .. })
        | Event::Input(Input::Message { message: PeerMessage::Unanswered(_), .. }) => (true, true),
        Event::Input(Input::Submit { lane: Lane::Data, transaction }) if asks(transaction) => (true, true),
        Event::Input(Input::Message { message: PeerMessage::Forward(forwarded), .. }) => {
            let before = forwarded.control.len() + forwarded.data.len();
            forwarded.control.clear();
            forwarded.data.retain(|transaction| !asks(transaction));
            (false, forwarded.control.len() + forwarded.data.len() < before)
        }
        _ => (false, false),
    }
}

/// Is it the question of a robot?
fn asks(transaction: &bytes::Bytes) -> bool {
    Transaction::decode(transaction.clone()).is_ok_and(|transaction| transaction.body().function == "declare")
}
