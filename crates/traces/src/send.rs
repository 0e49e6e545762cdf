//! Hands steps to the collector: together, beside the work, and never twice. A collector that does not answer misses them.

use crate::otlp;
use opentelemetry_proto::tonic::collector::trace::v1::trace_service_client::TraceServiceClient;
use opentelemetry_proto::tonic::resource::v1::Resource;
use opentelemetry_proto::tonic::trace::v1::Span;
use std::time::{Duration, Instant};
use tokio::sync::mpsc::Receiver;
use tokio::time::{sleep, timeout};
use tonic::Status;
use tonic::transport::Endpoint;

/// How long steps wait for others to go with.
const GATHER: Duration = Duration::from_millis(500);
/// Most steps at a time.
const TOGETHER_MAX: usize = 512;
/// How long the collector may take.
const ANSWER_MAX: Duration = Duration::from_secs(5);
/// It is said again after so long that the collector does not take steps.
const SAID_EVERY: Duration = Duration::from_secs(300);

/// Runs until nobody tells steps any more.
pub(crate) async fn run(endpoint: Endpoint, resource: Resource, mut told: Receiver<Span>) {
    let mut client = TraceServiceClient::new(endpoint.connect_lazy());
    let mut said: Option<Instant> = None;
    while let Some(first) = told.recv().await {
        sleep(GATHER).await;
        let mut spans = vec![first];
        while let Some(next) = told.try_recv().ok().filter(|_| spans.len() < TOGETHER_MAX) {
            spans.push(next);
        }
        let steps = spans.len();
        let outcome = timeout(ANSWER_MAX, client.export(otlp::export(&resource, spans))).await;
        match outcome.unwrap_or_else(|_| Err(Status::deadline_exceeded("no answer in time"))) {
            Ok(_) if said.take().is_some() => tracing::info!("the collector of traces takes steps again"),
            Ok(_) => {}
            Err(status) if said.is_none_or(|at| at.elapsed() > SAID_EVERY) => {
                said = Some(Instant::now());
                let error = status.message();
                tracing::warn!(error, steps, "the collector takes no steps of traces: they are left out");
            }
            Err(_) => {}
        }
    }
}
