//! `publish`, `echo`, `history`, `hz`, `bw`: the messages of a service.

mod echo;
mod history;
mod place;
mod publish;
mod rate;
mod secret;
mod senders;

pub(crate) use echo::Echo;
pub(crate) use history::History;
pub(crate) use place::Place;
pub(crate) use publish::{COMMAND_TTL, Publish};
pub(crate) use rate::{Bw, Hz};
pub(crate) use secret::{KEYED, Opening, enter};
pub(crate) use senders::Senders;

use crate::session::ABAC;
use bytes::Bytes;
use ledger::transaction::Body;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::MessageEvent;

/// Arguments of `set` before the messages: service, epoch, sequence number.
const ARGS_BEFORE_PAYLOADS: usize = 3;

/// The messages that a transaction has published on a service, in order, if the node says of it what its sender has signed:
/// network, service, epoch and numbers.
///
/// # Errors
/// [`Code::Malformed`] if it says something else: it shows a message in the place of another.
pub(crate) fn payloads<'b>(
    body: &'b Body,
    network: &Hash,
    service: &str,
    told: &MessageEvent,
) -> Result<&'b [Bytes], Rejection> {
    // A chaincode of the user's own may publish on behalf of its caller; then its arguments are not ours to read.
    if body.chaincode != ABAC || body.function != "set" {
        return Ok(&[]);
    }
    let text = |index: usize| body.args.get(index).and_then(|arg| std::str::from_utf8(arg).ok()).unwrap_or_default();
    let payloads = body.args.get(ARGS_BEFORE_PAYLOADS..).unwrap_or_default();
    let signed = (text(0), text(1).parse().ok(), text(2).parse().ok(), payloads.len() as u64);
    // A robot with one service is named alone.
    let robot = service.split('/').next().unwrap_or_default();
    let is_named = signed.0 == service || signed.0 == robot;
    let is_told = (signed.1, signed.2, signed.3) == (Some(told.epoch), Some(told.first_seq), told.count);
    if *body.network == network.0 && is_named && is_told {
        return Ok(payloads);
    }
    let MessageEvent { epoch, first_seq, count } = told;
    Err(Rejection::new(Code::Malformed, "the node's description of a message differs from what its sender signed")
        .found(format!("signed for {} with epoch {}, sequence {}, {} messages", text(0), text(1), text(2), signed.3))
        .wanted(format!("{service} with epoch {epoch}, sequence {first_seq}, {count} messages, of network {network}"))
        .next("query another node, and check the log of this one"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn set(network: &Hash, args: &[&str]) -> Body {
        let args = args.iter().map(|arg| Bytes::copy_from_slice(arg.as_bytes())).collect();
        let network = Bytes::copy_from_slice(network.as_ref());
        Body { network, chaincode: ABAC.to_owned(), function: "set".to_owned(), args, ..Body::default() }
    }

    #[test]
    fn a_message_is_believed_only_as_its_sender_has_signed_it() {
        let (ours, other) = (Hash::of(&[b"ours"]), Hash::of(&[b"other"]));
        let told = MessageEvent { epoch: 3, first_seq: 7, count: 2 };
        let read = |network: &Hash, args: &[&str]| {
            let body = set(network, args);
            payloads(&body, &ours, "T/cmd_vel", &told).map(<[Bytes]>::len).map_err(|refused| refused.code)
        };
        assert_eq!(read(&ours, &["T/cmd_vel", "3", "7", "a", "b"]), Ok(2));
        assert_eq!(read(&ours, &["T", "3", "7", "a", "b"]), Ok(2), "a robot with one service");
        for args in [
            &["Husky/cmd_vel", "3", "7", "a", "b"][..],
            &["T/cmd_vel", "2", "7", "a", "b"],
            &["T/cmd_vel", "3", "8", "a", "b"],
            &["T/cmd_vel", "3", "7", "a"],
            &[],
        ] {
            assert_eq!(read(&ours, args), Err(Code::Malformed), "{args:?}");
        }
        assert_eq!(read(&other, &["T/cmd_vel", "3", "7", "a", "b"]), Err(Code::Malformed));
        let own = Body { chaincode: "mine".to_owned(), ..set(&ours, &["x"]) };
        assert_eq!(payloads(&own, &ours, "T/cmd_vel", &told).map(<[Bytes]>::len), Ok(0));
    }
}
