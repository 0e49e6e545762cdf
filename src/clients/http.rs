//! The HTTP API: questions and signed transactions as JSON, streams as JSON lines (docs/http.md).
//!
//! Each endpoint translates a request into a call of the gRPC services, in this process and as the same caller. It decides nothing
//! itself: rights, quotas and turns are those of the call. The listener of the node serves it to clients with a certificate, and the
//! [console](crate::clients::console) to browsers with a session.
//!
//! ```text
//! reads, calls, proofs, events, enrolment   the endpoints, by group
//! access      the identity of the caller; requests of browsers at the listener for certificates
//! names       `Host` and `Origin`
//! parameters  query strings and parts of paths
//! body        bodies of requests, limited in bytes and time
//! rejections  rejections as answers
//! lines       streams
//! shape       messages as JSON that `ledgerctl` does not print; the others are `ledger_api::facts`
//! ```

mod access;
mod body;
mod calls;
mod enrolment;
mod events;
mod lines;
mod names;
mod parameters;
mod proofs;
mod reads;
mod rejections;
mod shape;

pub(crate) use access::for_certificates;
pub(crate) use body::discard;
pub(crate) use names::{Names, foreign, host_of};
pub(crate) use rejections::{Rejected, answer, elsewhere, other_method};

use crate::clients::gateway::GatewayService;
use crate::trust::enrolment::EnrolmentService;
use axum::Router;
use axum::extract::Request;
use axum::middleware::from_fn;
use axum::routing::{MethodRouter, any, get, post};
use serde::de::DeserializeOwned;
use std::sync::Arc;

/// The services behind the endpoints.
pub(crate) struct Api {
    /// Answers questions and takes transactions.
    pub(crate) gateway: Arc<GatewayService>,
    /// Enrols.
    pub(crate) enrolment: Arc<EnrolmentService>,
}

/// An endpoint: method, path, handler.
type Endpoint = (&'static str, &'static str, MethodRouter<Arc<Api>>);

/// The endpoints for members.
fn for_members() -> Vec<Endpoint> {
    vec![
        ("GET", "/v1/status", get(reads::status)),
        ("GET", "/v1/nodes", get(reads::nodes)),
        ("GET", "/v1/blocks/{height}", get(reads::block)),
        ("GET", "/v1/transactions/{id}", get(reads::transaction)),
        ("GET", "/v1/audit", get(reads::audit)),
        ("GET", "/v1/denials", get(reads::denials)),
        ("POST", "/v1/query", post(calls::query)),
        ("POST", "/v1/transactions", post(calls::submit)),
        ("GET", "/v1/events", get(events::events)),
        ("GET", "/v1/blocks/{height}/proof", get(proofs::block)),
        ("GET", "/v1/transactions/{id}/proof", get(proofs::transaction)),
        ("GET", "/v1/governance", get(proofs::governance)),
    ]
}

/// The endpoints that need no identity: they make one.
fn for_newcomers() -> Vec<Endpoint> {
    vec![("GET", "/v1/network", get(enrolment::network)), ("POST", "/v1/enrol", post(enrolment::enrol))]
}

/// The endpoints of this node. Each request needs a [`Caller`](crate::process::caller::Caller) in its extensions.
pub(crate) fn router(api: Api) -> Router {
    let routed = |endpoints: Vec<Endpoint>| {
        endpoints.into_iter().fold(Router::new(), |router, (_, path, handler)| router.route(path, handler))
    };
    routed(for_members())
        .route_layer(from_fn(access::identified))
        .merge(routed(for_newcomers()))
        .method_not_allowed_fallback(other_method)
        .route("/v1/{*rest}", any(rejections::unknown_path))
        .with_state(Arc::new(api))
}

/// Is this the path of an endpoint that needs no identity?
pub(crate) fn is_for_newcomers(path: &str) -> bool {
    for_newcomers().iter().any(|(_, open, _)| *open == path)
}

/// A body of JSON from a client that has no identity yet.
pub(crate) async fn json_body<T: DeserializeOwned>(request: Request, form: &str) -> Result<T, Rejected> {
    Ok(body::json(request, body::NEWCOMER_BODY_BYTES_MAX, form).await?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_about_http_lists_every_endpoint_and_no_other() {
        let page = include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/docs/http.md"));
        let listed: Vec<_> = page.lines().filter_map(|line| line.strip_prefix("### `")?.strip_suffix('`')).collect();
        let endpoints = for_members().into_iter().chain(for_newcomers());
        let mut wanted: Vec<_> = endpoints.map(|(method, path, _)| format!("{method} {path}")).collect();
        wanted.extend(crate::clients::console::SESSION_ENDPOINTS.map(|(method, path)| format!("{method} {path}")));
        assert_eq!(listed, wanted);
    }
}
