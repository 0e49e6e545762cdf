//! Answers to gRPC tools: the health of the node, and its services by their descriptions.
//!
//! Health: <https://github.com/grpc/grpc/blob/master/doc/health-checking.md>. It is that of `/readyz`, a second old at most. The
//! empty name and `ledgerd.v1.Gateway` stand for the node as a whole.

use crate::clients::gateway::Description;
use crate::clients::monitoring::is_ready;
use ledger_base::rejection::{Code, Rejection};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::watch;
use tokio::time::timeout;
use tonic_health::ServingStatus;
use tonic_health::pb::health_server::{Health, HealthServer};
use tonic_health::server::health_reporter;
use tonic_reflection::server::v1::{ServerReflection, ServerReflectionServer};
use tonic_reflection::server::{Builder, v1alpha};

/// Time between two looks at the node.
const EVERY: Duration = Duration::from_secs(1);
/// The names under which the health of the node is asked for.
const NAMES: [&str; 2] = ["", "ledgerd.v1.Gateway"];

/// The health of a node as a service, until the node stops.
pub(crate) fn health(node: Arc<Description>, mut stopping: watch::Receiver<bool>) -> HealthServer<impl Health> {
    let (reporter, server) = health_reporter();
    tokio::spawn(async move {
        loop {
            let status = if is_ready(&node) { ServingStatus::Serving } else { ServingStatus::NotServing };
            for name in NAMES {
                reporter.set_service_status(name, status).await;
            }
            // Until somebody says that the node stops, or nobody can say so any more.
            if timeout(EVERY, stopping.wait_for(|stop| *stop)).await.is_ok() {
                break;
            }
        }
        for name in NAMES {
            reporter.set_service_status(name, ServingStatus::NotServing).await;
        }
    });
    server
}

/// The descriptions of all services, in both versions that tools speak.
///
/// # Errors
/// [`Code::Internal`] if the descriptions cannot be read, which a test would find.
pub(crate) fn reflection() -> Result<
    (ServerReflectionServer<impl ServerReflection>, v1alpha::ServerReflectionServer<impl v1alpha::ServerReflection>),
    Rejection,
> {
    let described = || {
        Builder::configure()
            .register_encoded_file_descriptor_set(ledger_api::FILE_DESCRIPTORS)
            .register_encoded_file_descriptor_set(tonic_health::pb::FILE_DESCRIPTOR_SET)
    };
    let refused = |error: tonic_reflection::server::Error| {
        Rejection::new(Code::Internal, format!("the service descriptors cannot be read: {error}"))
    };
    Ok((described().build_v1().map_err(refused)?, described().build_v1alpha().map_err(refused)?))
}
