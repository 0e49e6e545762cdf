//! Steps as messages of the OpenTelemetry protocol (OTLP 1.x).

use crate::{Step, part};
use ledger_base::hash::Hash;
use opentelemetry_proto::tonic::collector::trace::v1::ExportTraceServiceRequest;
use opentelemetry_proto::tonic::common::v1::{AnyValue, KeyValue, any_value::Value};
use opentelemetry_proto::tonic::resource::v1::Resource;
use opentelemetry_proto::tonic::trace::v1::span::SpanKind;
use opentelemetry_proto::tonic::trace::v1::status::StatusCode;
use opentelemetry_proto::tonic::trace::v1::{ResourceSpans, ScopeSpans, Span, Status};
use std::time::SystemTime;

/// Bytes of the id of a trace.
const TRACE_BYTES: usize = 16;
/// Where the id of the whole way is in the id of a transaction, from this byte on.
const WHOLE_AT: usize = 16;

/// The names of a process.
pub(crate) fn resource(program: &str, instance: &str) -> Resource {
    let attributes = vec![
        fact("service.name", program.to_owned()),
        fact("service.instance.id", instance.to_owned()),
        fact("service.version", env!("CARGO_PKG_VERSION").to_owned()),
    ];
    Resource { attributes, ..Resource::default() }
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
        kind: SpanKind::Internal.into(),
        // Block time is that of another machine: no step ends before it begins.
        start_time_unix_nano: nanoseconds(begun).min(ended),
        end_time_unix_nano: ended,
        attributes: facts.into_iter().chain([transaction_id]).map(|(key, value)| fact(key, value)).collect(),
        status: failed.map(|code| Status { message: code.to_owned(), code: StatusCode::Error.into() }),
        ..Span::default()
    }
}

/// The steps that one process tells at a time.
pub(crate) fn export(resource: &Resource, spans: Vec<Span>) -> ExportTraceServiceRequest {
    let scope_spans = vec![ScopeSpans { spans, ..ScopeSpans::default() }];
    let of_process = ResourceSpans { resource: Some(resource.clone()), scope_spans, ..ResourceSpans::default() };
    ExportTraceServiceRequest { resource_spans: vec![of_process] }
}

fn fact(key: &str, value: String) -> KeyValue {
    let value = Some(AnyValue { value: Some(Value::StringValue(value)) });
    KeyValue { key: key.to_owned(), value, ..KeyValue::default() }
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
