//! Calls of gRPC-Web under a session. They are those of every client, with the same rights. Calls that change something by the caller's
//! word alone are left out: what a browser changes it signs.

use super::Shared;
use super::opening::token;
use crate::process::caller::Caller;
use crate::process::page_connections::Source;
use axum::Router;
use axum::body::Body;
use axum::extract::{ConnectInfo, Request, State};
use axum::http::StatusCode;
use axum::middleware::{Next, from_fn_with_state};
use axum::response::{IntoResponse, Response};
use futures::StreamExt;
use ledger_api::v1::enrolment_server::EnrolmentServer;
use ledger_api::v1::gateway_server::GatewayServer;
use std::sync::Arc;
use std::time::Instant;
use tonic_web::GrpcWebLayer;
use tower::Layer;

/// Most bytes of a call: the largest set of policies fits.
const CALL_BYTES_MAX: usize = 1 << 20;
/// Most bytes of a call without a session: a signing request and a secret take a few hundred.
const STRANGER_BYTES_MAX: usize = 32 << 10;

/// The calls of a session.
const CALLS: [&str; 12] = [
    "/ledgerd.v1.Gateway/Audit",
    "/ledgerd.v1.Gateway/Denials",
    "/ledgerd.v1.Gateway/GetBlock",
    "/ledgerd.v1.Gateway/GetTransaction",
    "/ledgerd.v1.Gateway/Governance",
    "/ledgerd.v1.Gateway/Nodes",
    "/ledgerd.v1.Gateway/Prove",
    "/ledgerd.v1.Gateway/ProveTransaction",
    "/ledgerd.v1.Gateway/Query",
    "/ledgerd.v1.Gateway/Status",
    "/ledgerd.v1.Gateway/Submit",
    "/ledgerd.v1.Gateway/Subscribe",
];

/// The calls of a browser that has no identity yet.
const OPEN_CALLS: [&str; 2] = ["/ledgerd.v1.Enrolment/Network", "/ledgerd.v1.Enrolment/Enrol"];

pub(super) fn router(shared: &Arc<Shared>) -> Router {
    let gateway = GatewayServer::new(shared.parts.gateway.clone()).max_decoding_message_size(CALL_BYTES_MAX);
    let enrolment = EnrolmentServer::new(shared.parts.enrolment.clone()).max_decoding_message_size(STRANGER_BYTES_MAX);
    let web = GrpcWebLayer::new();
    Router::new()
        .route_service("/ledgerd.v1.Gateway/{call}", web.layer(gateway))
        .route_service("/ledgerd.v1.Enrolment/{call}", web.layer(enrolment))
        .layer(from_fn_with_state(Arc::clone(shared), admitted))
}

/// Lets a call in as the identity of its session. A stream ends with the session.
async fn admitted(
    State(shared): State<Arc<Shared>>,
    ConnectInfo(Source(source)): ConnectInfo<Source>,
    mut request: Request,
    next: Next,
) -> Response {
    let path = request.uri().path();
    if OPEN_CALLS.contains(&path) {
        request.extensions_mut().insert(Caller { identity: None, source });
        return next.run(request).await;
    }
    if !CALLS.contains(&path) {
        return (StatusCode::NOT_FOUND, "no call of the console\n").into_response();
    }
    let now = Instant::now();
    let Some(session) = token(request.headers()).and_then(|token| shared.sessions.find(&token, now)) else {
        return (StatusCode::UNAUTHORIZED, "the session has ended: open another one\n").into_response();
    };
    let busy = session.begin(now);
    request.extensions_mut().insert(Caller { identity: Some(Arc::clone(&session.identity)), source });
    let answer = next.run(request).await;
    answer.map(|body| {
        let until = Box::pin(session.over());
        let parts = body.into_data_stream().take_until(until).map(move |part| {
            let _open = &busy;
            part
        });
        Body::from_stream(parts)
    })
}
