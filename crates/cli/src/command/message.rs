//! `publish`, `echo`: the messages of a service.

mod echo;
mod place;
mod publish;
mod senders;

pub(crate) use echo::Echo;
pub(crate) use place::Place;
pub(crate) use publish::{COMMAND_TTL, Publish};
pub(crate) use senders::Senders;

use crate::session::ABAC;
use bytes::Bytes;
use ledger::transaction::Body;

/// Arguments of `set` before the messages: service, epoch, sequence number.
const ARGS_BEFORE_PAYLOADS: usize = 3;

/// The messages that a transaction has published, in order.
pub(crate) fn payloads(body: &Body) -> impl Iterator<Item = &Bytes> {
    // A chaincode of the user's own may publish on behalf of its caller; then its arguments are not ours to read.
    let is_set = body.chaincode == ABAC && body.function == "set";
    body.args.iter().skip(ARGS_BEFORE_PAYLOADS).filter(move |_| is_set)
}
