//! `set`: publishing messages on a service.
//!
//! The messages themselves stay in the transaction; the state keeps only where the last one is. A held grant is
//! checked by comparing numbers, without asking any policy.

use crate::arguments::Arguments;
use crate::authorize::{self, Decider};
use crate::conflict;
use crate::contract::NAME;
use crate::grant;
use crate::service::Target;
use crate::store;
use bytes::Bytes;
use ledger::{Context, Foretold};
use ledger_contract::{MessageEvent, Published};
use ledger_rejection::{Code, Rejection};
use ledger_storage::result::Event;
use serde::{Deserialize, Serialize};

/// Most messages of one `set`.
pub const MESSAGES_PER_CALL_MAX: usize = 1024;
/// Bytes of the CDR encapsulation header before every message: two of representation, two of options.
const CDR_HEADER_BYTES: usize = 4;

/// Where the last message of a service is: key `last/…`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
struct Last {
    /// The epoch it was published under; 0 without a grant.
    epoch: u64,
    /// Its sequence number.
    seq: u64,
    /// The block it is in.
    height: u64,
    /// Who published it.
    publisher: String,
    /// How many messages its transaction holds; their sequence numbers end with `seq`.
    count: u64,
}

const USAGE: &str = "set SERVICE EPOCH FIRST_SEQ PAYLOAD...";

/// `set SERVICE EPOCH FIRST_SEQ PAYLOAD...`
pub(crate) fn set(ctx: &mut Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new(USAGE, args, 4, 3 + MESSAGES_PER_CALL_MAX)?;
    let (epoch, first_seq) = (args.number(1, "EPOCH")?, args.number(2, "FIRST_SEQ")?);
    let count = check_payloads(args)?;
    let last_seq = first_seq
        .checked_add(count - 1)
        .filter(|last| *last < u64::MAX)
        .ok_or_else(|| args.bad(2, "FIRST_SEQ", first_seq.to_string(), "room for all messages below 2^64 - 1"))?;
    let submitter = ctx.submitter()?;
    let target = decider.target(ctx, args.text(0, "SERVICE")?)?;
    let own = authorize::may_publish(ctx, decider, submitter, &target, Some(epoch))?;

    let publisher = submitter.id();
    let next_seq = next_sequence(ctx, &target, epoch, &publisher)?;
    if first_seq < next_seq {
        return Err(Rejection::new(Code::StaleSequence, format!("{} has moved on", target.id))
            .found(format!("sequence number {first_seq}"))
            .wanted(format!("at least {next_seq}"))
            .next("number messages upwards; after a restart, acquire again and go on from next_seq"));
    }
    if let Some(own) = &own {
        grant::used(ctx, decider, &target, own)?;
    }
    let key = last_message_key(&target, &publisher);
    let last = Last { epoch, seq: last_seq, height: ctx.height(), publisher, count };
    store::write(ctx, &key, &last)?;
    ctx.emit("message", &target.id, store::json(&MessageEvent { epoch, first_seq, count })?);
    store::json(&Published { epoch, next_seq: last_seq + 1 })
}

/// What a `set` that succeeds answers and emits, if it names the service in full. For good: nodes keep results without it.
pub(crate) fn foretell(args: &[Bytes]) -> Option<Foretold> {
    let args = Arguments::new(USAGE, args, 4, 3 + MESSAGES_PER_CALL_MAX).ok()?;
    let (epoch, first_seq) = (args.number(1, "EPOCH").ok()?, args.number(2, "FIRST_SEQ").ok()?);
    let count = args.rest(3).len() as u64;
    let message = Event {
        chaincode: NAME.into(),
        name: "message".into(),
        subject: args.text(0, "SERVICE").ok()?.into(),
        payload: store::json(&MessageEvent { epoch, first_seq, count }).ok()?,
    };
    let response = store::json(&Published { epoch, next_seq: first_seq.checked_add(count)? }).ok()?;
    Some(Foretold { response, events: vec![message] })
}

/// The smallest sequence number that `set` accepts. An exclusive service counts within an epoch, since every epoch
/// has one publisher; an open one counts for each publisher, whatever the epoch.
pub(crate) fn next_sequence(ctx: &Context<'_>, target: &Target, epoch: u64, publisher: &str) -> Result<u64, Rejection> {
    let last: Option<Last> = store::read(ctx, &last_message_key(target, publisher))?;
    let counts_on = |last: &Last| last.epoch == epoch || !conflict::rule(target.service.mode).publishing_needs_grant();
    Ok(last.filter(counts_on).map_or(0, |last| last.seq + 1))
}

fn last_message_key(target: &Target, publisher: &str) -> Vec<u8> {
    let shared = conflict::rule(target.service.mode).publishing_needs_grant();
    store::last_key(&target.id, (!shared).then_some(publisher))
}

/// Checks that every payload starts as CDR does; returns how many they are.
fn check_payloads(args: Arguments<'_>) -> Result<u64, Rejection> {
    let payloads = args.rest(3);
    for (index, payload) in payloads.iter().enumerate() {
        let wanted = "CDR with its encapsulation header: 00 00 to 00 03 or 00 06 to 00 0b, and two bytes of options";
        match payload.get(..CDR_HEADER_BYTES) {
            Some([0, 0..=3 | 6..=11, ..]) => {}
            Some(header) => return Err(args.bad(3 + index, "PAYLOAD", hex::encode(header), wanted)),
            None => return Err(args.bad(3 + index, "PAYLOAD", format!("{} bytes", payload.len()), wanted)),
        }
    }
    Ok(payloads.len() as u64)
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::{Arguments, Bytes, Event, Foretold, check_payloads, foretell};

    #[test]
    fn what_is_foretold_of_a_call_never_changes() {
        let args = ["Turtlebot4/cmd_vel", "7", "1795228838000000", "a", "b"].map(Bytes::from);
        let message = Event {
            chaincode: "abac".into(),
            name: "message".into(),
            subject: "Turtlebot4/cmd_vel".into(),
            payload: r#"{"epoch":7,"first_seq":1795228838000000,"count":2}"#.into(),
        };
        let response = r#"{"epoch":7,"next_seq":1795228838000002}"#.into();
        assert_eq!(foretell(&args).unwrap(), Foretold { response, events: vec![message] });
        for (index, bad) in [(0, "\0"), (1, "-1"), (2, "18446744073709551615"), (2, "x")] {
            let mut args = args.clone();
            *args.get_mut(index).unwrap() = Bytes::from(bad);
            assert_eq!(foretell(&args), None, "{bad}");
        }
        assert_eq!(foretell(&[]), None);
    }

    #[test]
    fn only_known_encapsulations_pass() {
        for id in 0..=u8::MAX {
            for high in [0, 1] {
                let payload = [Bytes::new(), Bytes::new(), Bytes::new(), Bytes::from(vec![high, id, 0, 0])];
                let outcome = Arguments::new("", &payload, 4, 4).and_then(check_payloads);
                assert_eq!(outcome.is_ok(), high == 0 && (id <= 3 || (6..=11).contains(&id)), "{high} {id}");
            }
        }
    }
}
