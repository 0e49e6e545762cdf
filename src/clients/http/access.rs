//! The callers of endpoints.

use super::body::discard;
use super::names::{Names, is_of_other_page};
use super::{Rejected, names};
use crate::process::caller::Caller;
use axum::Router;
use axum::extract::{Request, State};
use axum::http::StatusCode;
use axum::middleware::{Next, from_fn_with_state};
use axum::response::{IntoResponse, Response};
use ledger_base::rejection::{Code, Rejection};
use std::sync::Arc;

/// A call of a service as this caller.
pub(super) fn call<T>(caller: Caller, message: T) -> tonic::Request<T> {
    let mut request = tonic::Request::new(message);
    request.extensions_mut().insert(caller);
    request
}

/// Lets a request through that has an identity. It is checked before the body is kept; the call checks it again.
pub(super) async fn identified(request: Request, next: Next) -> Response {
    match request.extensions().get::<Caller>() {
        Some(Caller { identity: Some(_), .. }) => next.run(request).await,
        _ => {
            discard(request).await;
            Rejected::from(
                Rejection::new(Code::CertificateRequired, "this call requires an identity")
                    .wanted("a client certificate, or an open session at the console")
                    .next("enrol first: ledgerctl enroll; at the console, open a session"),
            )
            .into_response()
        }
    }
}

/// The endpoints at the listener where clients show certificates. A browser that has a certificate of its user would show it to
/// whatever page asks: so requests of browsers are rejected here.
pub(crate) fn for_certificates(endpoints: Router, names: Names) -> Router {
    endpoints.route_layer(from_fn_with_state(Arc::new(names), without_browsers))
}

async fn without_browsers(State(names): State<Arc<Names>>, request: Request, next: Next) -> Response {
    let host = names::host(&request).unwrap_or_default();
    let rejection = if !names.has(&host) {
        Rejection::new(Code::Untrusted, "the host is not a name of this node")
            .found(format!("{host:?}"))
            .wanted("an address, or a name of this node")
            .next("use its address, or the name in [member] address of ledgerd.toml")
    } else if is_of_other_page(request.headers()) {
        Rejection::new(Code::Untrusted, "requests of browsers are rejected here")
            .found("the header origin or sec-fetch-site")
            .next("use the console in browsers: see [console] in ledgerd.toml")
    } else {
        return next.run(request).await;
    };
    discard(request).await;
    Rejected::from(rejection).with_status(StatusCode::FORBIDDEN).into_response()
}
