//! `set`: publishing messages on a service.
//!
//! The messages themselves stay in the transaction; the state keeps only where the last one is. A held grant is
//! checked by comparing numbers, without asking any policy.

use crate::arguments::Arguments;
use crate::calls::NAME;
use crate::lifecycle::publishing::Right;
use crate::lifecycle::{content_keys, grants, publishing};
use crate::policy::decider::Decider;
use crate::policy::{Permit, texts};
use crate::records::last::Last;
use crate::records::target::Target;
use crate::records::{last, store};
use bytes::Bytes;
use ledger::{Context, Foretold};
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{Envelope, MessageEvent, POLICIES_TOLD_MAX, Permitted, Published};
use ledger_storage::result::Event;

/// Most messages of one `set`.
pub const MESSAGES_PER_CALL_MAX: usize = 1024;

/// Bytes of the CDR encapsulation header before every message: two of representation, two of options.
const CDR_HEADER_BYTES: usize = 4;

/// The name of the event of what was published.
pub(crate) const MESSAGE: &str = "message";

const USAGE: &str = "set SERVICE EPOCH FIRST_SEQ PAYLOAD...";

/// `set SERVICE EPOCH FIRST_SEQ PAYLOAD...`
pub(crate) fn set(ctx: &mut Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new(USAGE, args, 4, 3 + MESSAGES_PER_CALL_MAX)?;
    let (epoch, first_seq) = (args.number(1, "EPOCH")?, args.number(2, "FIRST_SEQ")?);
    let (count, envelope) = check_payloads(args)?;
    let last_seq = first_seq
        .checked_add(count - 1)
        .filter(|last| *last < u64::MAX)
        .ok_or_else(|| args.bad(2, "FIRST_SEQ", first_seq.to_string(), "room for all messages below 2^64 - 1"))?;
    let submitter = ctx.submitter()?;
    let target = decider.records.target(ctx, args.text(0, "SERVICE")?)?;
    let right = publishing::may_publish(ctx, decider, submitter, &target, Some(epoch))?;

    let publisher = submitter.id();
    content_keys::check_key(ctx, &target, &publisher, envelope)?;
    let sequence = decider.rules.capabilities(&target)?.sequence;
    let before = last::read(ctx, &target.id, sequence, &publisher)?;
    let next_seq = last::follows(before.as_ref(), sequence, epoch);
    if first_seq < next_seq {
        return Err(Rejection::new(
            Code::StaleSequence,
            format!("newer messages of {} were published before", target.id),
        )
        .found(format!("sequence number {first_seq}"))
        .wanted(format!("at least {next_seq}")));
    }
    let permitted = match &right {
        Right::Grant(own) => {
            grants::renew_by_use(ctx, decider, &target, own)?;
            None
        }
        Right::Policies(permit) => permitted_by(ctx, &target, permit)?,
    };
    if permitted != before.and_then(|before| before.permitted) {
        tell_permitted(ctx, &target, &publisher, permitted.clone())?;
    }
    let at = target.service.sharing.idle_release_ms.map(|_| ctx.block_time());
    let last = Last { epoch, seq: last_seq, height: ctx.height(), publisher, count, at, permitted };
    last::write(ctx, &target.id, sequence, &last)?;
    ctx.emit("message", &target.id, store::json(&MessageEvent { epoch, first_seq, count })?);
    store::json(&Published { epoch, next_seq: last_seq + 1 })
}

/// The policies that permit a message without a grant; none under rules that do not tell them.
fn permitted_by(ctx: &Context<'_>, target: &Target, permit: &Permit) -> Result<Option<(u64, Vec<String>)>, Rejection> {
    if permit.policies.is_empty() {
        return Ok(None);
    }
    let policies = permit.policies.iter().take(POLICIES_TOLD_MAX).cloned().collect();
    Ok(Some((texts::version(ctx, &target.robot.organisation)?.number, policies)))
}

/// Tells which policies permit from now on what a publisher sends without a grant. Once, not with each message.
fn tell_permitted(
    ctx: &mut Context<'_>,
    target: &Target,
    publisher: &str,
    permitted: Option<(u64, Vec<String>)>,
) -> Result<(), Rejection> {
    let Some((policy_version, policies)) = permitted else { return Ok(()) };
    let permitted = Permitted { publisher: publisher.to_owned(), policy_version, policies };
    ctx.emit("permitted", &target.id, store::json(&permitted)?);
    Ok(())
}

/// The answer and the event of a `set` that succeeds, if it names the service in full. For good: nodes keep results
/// without it. A `set` that tells more keeps all that it tells.
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

/// The service that a `set` names, and how many messages it has.
pub(crate) fn publishes(args: &[Bytes]) -> Option<(&str, u64)> {
    let service = std::str::from_utf8(args.first()?).ok()?;
    Some((service, args.len().saturating_sub(3).max(1) as u64))
}

/// How many messages an event of a `set` reports.
pub(crate) fn published(event: &Event) -> Option<u64> {
    let event: MessageEvent = serde_json::from_slice(&event.payload).ok()?;
    Some(event.count)
}

/// Checks that every payload starts as CDR does, or is an envelope under the same content key as the others; returns how many they
/// are, and that key.
fn check_payloads(args: Arguments<'_>) -> Result<(u64, Option<u64>), Rejection> {
    let payloads = args.rest(3);
    let key = |payload: &Bytes| Envelope::parse(payload).map(|envelope| envelope.key);
    if let Some(first) = payloads.first().and_then(key) {
        return match payloads.iter().position(|payload| key(payload) != Some(first)) {
            None => Ok((payloads.len() as u64, Some(first))),
            Some(other) => {
                let wanted = format!("an envelope under key {first}, as the first message");
                Err(args.bad(3 + other, "PAYLOAD", "something else".to_owned(), &wanted))
            }
        };
    }
    check_cdr(args, payloads).map(|count| (count, None))
}

fn check_cdr(args: Arguments<'_>, payloads: &[Bytes]) -> Result<u64, Rejection> {
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
    use super::{Arguments, Bytes, Event, Foretold, check_cdr, foretell};

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
                let outcome = Arguments::new("", &payload, 4, 4).and_then(|args| check_cdr(args, args.rest(3)));
                assert_eq!(outcome.is_ok(), high == 0 && (id <= 3 || (6..=11).contains(&id)), "{high} {id}");
            }
        }
    }
}
