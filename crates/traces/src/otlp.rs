//! The messages of the OpenTelemetry protocol (OTLP 1.x), as far as steps need them. A test gives them to the generated types of
//! OpenTelemetry itself.

use crate::{Step, part};
use ledger_base::hash::Hash;
use prost::Message;
use std::time::SystemTime;

/// The method that takes steps.
pub(crate) const EXPORT: &str = "/opentelemetry.proto.collector.trace.v1.TraceService/Export";
/// Bytes of the id of a trace.
const TRACE_BYTES: usize = 16;
/// Where the id of the whole way is in the id of a transaction, from this byte on.
const WHOLE_AT: usize = 16;
/// `SPAN_KIND_INTERNAL`.
const INTERNAL: i32 = 1;
/// `STATUS_CODE_ERROR`.
const ERROR: i32 = 2;

/// `ExportTraceServiceRequest`.
#[derive(Clone, PartialEq, Message)]
pub(crate) struct Export {
    /// The steps of one process.
    #[prost(message, repeated, tag = "1")]
    pub(crate) resource_spans: Vec<ResourceSpans>,
}

/// `ExportTraceServiceResponse`, of which nothing is read.
#[derive(Clone, PartialEq, Message)]
pub(crate) struct Exported {}

/// The steps of one process.
#[derive(Clone, PartialEq, Message)]
pub(crate) struct ResourceSpans {
    /// The process.
    #[prost(message, optional, tag = "1")]
    pub(crate) resource: Option<Resource>,
    /// Its steps.
    #[prost(message, repeated, tag = "2")]
    pub(crate) scope_spans: Vec<ScopeSpans>,
}

/// A process.
#[derive(Clone, PartialEq, Message)]
pub(crate) struct Resource {
    /// Its names.
    #[prost(message, repeated, tag = "1")]
    pub(crate) attributes: Vec<KeyValue>,
}

/// The steps of one part of a program.
#[derive(Clone, PartialEq, Message)]
pub(crate) struct ScopeSpans {
    /// The steps.
    #[prost(message, repeated, tag = "2")]
    pub(crate) spans: Vec<Span>,
}

/// A step.
#[derive(Clone, PartialEq, Message)]
pub(crate) struct Span {
    /// The first 16 bytes of the transaction's id.
    #[prost(bytes = "vec", tag = "1")]
    pub(crate) trace_id: Vec<u8>,
    /// Its own id, of 8 bytes.
    #[prost(bytes = "vec", tag = "2")]
    pub(crate) span_id: Vec<u8>,
    /// The id of the whole way; empty if it is that.
    #[prost(bytes = "vec", tag = "4")]
    pub(crate) parent_span_id: Vec<u8>,
    /// Its name.
    #[prost(string, tag = "5")]
    pub(crate) name: String,
    /// Its kind.
    #[prost(int32, tag = "6")]
    pub(crate) kind: i32,
    /// Nanoseconds since the UNIX epoch.
    #[prost(fixed64, tag = "7")]
    pub(crate) start_time_unix_nano: u64,
    /// The same for its end.
    #[prost(fixed64, tag = "8")]
    pub(crate) end_time_unix_nano: u64,
    /// More about it.
    #[prost(message, repeated, tag = "9")]
    pub(crate) attributes: Vec<KeyValue>,
    /// Did it go well?
    #[prost(message, optional, tag = "15")]
    pub(crate) status: Option<Status>,
}

/// How a step ended.
#[derive(Clone, PartialEq, Message)]
pub(crate) struct Status {
    /// Why it failed.
    #[prost(string, tag = "2")]
    pub(crate) message: String,
    /// Whether it failed.
    #[prost(int32, tag = "3")]
    pub(crate) code: i32,
}

/// A fact.
#[derive(Clone, PartialEq, Message)]
pub(crate) struct KeyValue {
    /// Its name.
    #[prost(string, tag = "1")]
    pub(crate) key: String,
    /// Its value.
    #[prost(message, optional, tag = "2")]
    pub(crate) value: Option<AnyValue>,
}

/// The value of a fact: a text, of all that there may be.
#[derive(Clone, PartialEq, Message)]
pub(crate) struct AnyValue {
    /// The text.
    #[prost(string, optional, tag = "1")]
    pub(crate) string_value: Option<String>,
}

/// The names of a process.
pub(crate) fn resource(program: &str, instance: &str) -> Resource {
    let attributes = vec![
        fact("service.name", program.to_owned()),
        fact("service.instance.id", instance.to_owned()),
        fact("service.version", env!("CARGO_PKG_VERSION").to_owned()),
    ];
    Resource { attributes }
}

/// A step of the message of this transaction. Its id comes from the transaction too, and is another one in each process.
pub(crate) fn span(transaction: &Hash, instance: &str, step: Step) -> Span {
    let Step { name, begun, ended, is_whole, failed, facts } = step;
    let whole = part(transaction, WHOLE_AT).to_vec();
    let own = Hash::of(&[&transaction.0, instance.as_bytes(), &[0], name.as_bytes()]);
    let (span_id, parent_span_id) = if is_whole { (whole, Vec::new()) } else { (part(&own, 0).to_vec(), whole) };
    let transaction_id = ("ledgerd.transaction", transaction.to_string());
    let ended = nanoseconds(ended);
    Span {
        trace_id: transaction.0.iter().copied().take(TRACE_BYTES).collect(),
        span_id,
        parent_span_id,
        name: name.to_owned(),
        kind: INTERNAL,
        // Block time is that of another machine: no step ends before it begins.
        start_time_unix_nano: nanoseconds(begun).min(ended),
        end_time_unix_nano: ended,
        attributes: facts.into_iter().chain([transaction_id]).map(|(key, value)| fact(key, value)).collect(),
        status: failed.map(|code| Status { message: code.to_owned(), code: ERROR }),
    }
}

/// The steps that one process tells at a time.
pub(crate) fn export(resource: &Resource, spans: Vec<Span>) -> Export {
    let scope_spans = vec![ScopeSpans { spans }];
    Export { resource_spans: vec![ResourceSpans { resource: Some(resource.clone()), scope_spans }] }
}

fn fact(key: &str, value: String) -> KeyValue {
    KeyValue { key: key.to_owned(), value: Some(AnyValue { string_value: Some(value) }) }
}

fn nanoseconds(time: SystemTime) -> u64 {
    let since = time.duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
    u64::try_from(since.as_nanos()).unwrap_or(u64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wall_at;

    #[test]
    fn the_transaction_names_the_trace_and_steps_of_different_processes_have_different_ids() {
        let id = Hash::of(&[b"a"]);
        let told = |instance: &str, is_whole| {
            span(&id, instance, Step { is_whole, ..Step::since("block", SystemTime::now()) })
        };
        let [whole, one, other] = [told("Org1/Salma", true), told("Org1/node1", false), told("Org2/node2", false)];
        for span in [&whole, &one, &other] {
            assert_eq!(span.trace_id, id.0[..16]);
            assert_eq!((span.span_id.len(), span.parent_span_id.is_empty()), (8, span == &whole));
        }
        assert_eq!((&one.parent_span_id, &other.parent_span_id), (&whole.span_id, &whole.span_id));
        assert!(one.span_id != other.span_id && one.span_id != whole.span_id);
        assert_eq!(told("Org1/node1", false).span_id, one.span_id, "told twice it is the same step");
    }

    #[test]
    fn a_step_never_ends_before_it_begins_and_says_why_it_failed() {
        let step = Step {
            begun: wall_at(9),
            ended: wall_at(5),
            failed: Some("NOT_HOLDER"),
            ..Step::since("block", wall_at(9))
        };
        let span = span(&Hash::ZERO, "", step.with("ledgerd.service", "R/cmd_vel"));
        assert_eq!((span.start_time_unix_nano, span.end_time_unix_nano), (5000, 5000));
        assert_eq!(span.status.map(|status| (status.code, status.message)), Some((2, "NOT_HOLDER".to_owned())));
        assert!(span.attributes.iter().any(|fact| fact.key == "ledgerd.service"));
    }
}
