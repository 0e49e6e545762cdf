//! Messages that the bridge writes itself, in types that it knows.

use std::time::{Duration, SystemTime, UNIX_EPOCH};

use bytes::Bytes;
use ledger_base::rejection::{Code, Rejection};
use ledger_gate::sample::{SAMPLE_BYTES_MAX, Sample};
use ros_message::{ByteOrder, Fault, Library, Message, Time, Written};
use serde_json::{Value, json};

use crate::graph::names::TypeName;

/// A built-in type.
///
/// # Errors
/// [`Code::Internal`] if there is none of that name.
pub(crate) fn of(message: &str) -> Result<Message, Rejection> {
    Library::builtin().message(message).map_err(|fault| internal(&fault))
}

/// A sample with these values; fields that are not named are zero.
///
/// # Errors
/// [`Code::Internal`] if they are not of the type.
pub(crate) fn sample(message: &Message, value: &Value) -> Result<Sample, Rejection> {
    let written = Written::parse(&value.to_string()).map_err(|fault| internal(&fault))?;
    let bytes = message.encode(&written, ByteOrder::Little, Time::default()).map_err(|fault| internal(&fault))?;
    Sample::from_wire(Bytes::from(bytes), SAMPLE_BYTES_MAX)
}

/// A sample with the values that a person has written as JSON or YAML; fields that are not named are zero.
///
/// # Errors
/// [`Code::BadArgument`] if they are not of the type, or if its definition is not known.
pub(crate) fn written(message: &TypeName, text: &str) -> Result<Sample, Rejection> {
    let encode = || {
        let of = Library::builtin().message(&message.to_string())?;
        of.encode(&Written::parse(text)?, ByteOrder::Little, Time::default())
    };
    let bytes = encode().map_err(|Fault { message: what, found, wanted, next, .. }| {
        let rejection = Rejection::new(Code::BadArgument, format!("this is no {message}: {what}"));
        rejection.found(found).wanted(wanted).next(if next.is_empty() { "stop_hex takes CDR".to_owned() } else { next })
    })?;
    Sample::from_wire(Bytes::from(bytes), SAMPLE_BYTES_MAX)
}

/// A header stamped with a moment of the wall clock.
pub(crate) fn stamped(now: SystemTime) -> Value {
    let since: Duration = now.duration_since(UNIX_EPOCH).unwrap_or_default();
    json!({ "stamp": { "sec": i32::try_from(since.as_secs()).unwrap_or(i32::MAX), "nanosec": since.subsec_nanos() } })
}

fn internal(fault: &Fault) -> Rejection {
    let message = format!("a message of the bridge cannot be written: {}", fault.message);
    Rejection::new(Code::Internal, message).found(fault.found.as_str())
}
