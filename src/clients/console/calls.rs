//! The HTTP API under a session. Its calls are those of every client, with the same rights: what a browser changes it signs.

use super::Shared;
use super::opening::token;
use super::sessions::CALLS_MAX;
use crate::clients::http::{self, Api, Names, Rejected, discard};
use crate::process::caller::Caller;
use crate::process::page_connections::Source;
use axum::Router;
use axum::body::Body;
use axum::extract::{ConnectInfo, Request, State};
use axum::http::StatusCode;
use axum::middleware::{Next, from_fn_with_state};
use axum::response::{IntoResponse, Response};
use futures::StreamExt;
use ledger_base::rejection::{Code, Rejection};
use std::sync::Arc;
use std::time::Instant;

pub(super) fn router(shared: &Arc<Shared>) -> Router {
    let gateway = Arc::new(shared.parts.gateway.clone());
    let enrolment = Arc::new(shared.parts.enrolment.clone());
    http::router(Api { gateway, enrolment }).route_layer(from_fn_with_state(Arc::clone(shared), admitted))
}

/// Lets a call in as the identity of its session. A stream ends with the session.
async fn admitted(
    State(shared): State<Arc<Shared>>,
    ConnectInfo(Source(source)): ConnectInfo<Source>,
    mut request: Request,
    next: Next,
) -> Response {
    if http::is_for_newcomers(request.uri().path()) {
        request.extensions_mut().insert(Caller { identity: None, source });
        return next.run(request).await;
    }
    let now = Instant::now();
    let told = token(request.headers()).filter(|_| Names::is_of_own_page(request.headers()));
    let Some(session) = told.and_then(|token| shared.sessions.find(&token, now)) else {
        discard(request).await;
        return Rejected::from(
            Rejection::new(Code::CertificateRequired, "the call has no session, or its session has expired")
                .wanted("the header authorization: Session TOKEN, from a page of this console")
                .next("open a session: docs/http.md"),
        )
        .with_status(StatusCode::UNAUTHORIZED)
        .into_response();
    };
    let Some(busy) = session.begin(now) else {
        discard(request).await;
        return Rejected::from(
            Rejection::new(Code::Overloaded, "the session has too many concurrent calls")
                .wanted(format!("at most {CALLS_MAX} calls and streams"))
                .next("wait for responses, or close streams"),
        )
        .into_response();
    };
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
