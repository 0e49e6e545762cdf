//! Rejections as answers: a status and JSON with `code`, `message`, `found`, `wanted` and `next`.

use super::body::discard;
use axum::extract::Request;
use axum::http::header::{CACHE_CONTROL, CONTENT_TYPE};
use axum::http::{HeaderValue, StatusCode};
use axum::response::{IntoResponse, Response};
use ledger_base::rejection::{Class, Code, Rejection};
use serde::Serialize;
use serde_json::{Map, Value};
use tonic::Status;

/// The headers of every answer: nothing is stored by caches.
const HEADERS: [(axum::http::HeaderName, &str); 2] = [(CONTENT_TYPE, "application/json"), (CACHE_CONTROL, "no-store")];

/// A rejected request.
pub(crate) struct Rejected {
    status: StatusCode,
    rejection: Box<Rejection>,
    /// More fields, such as the height of a transaction that was executed and rejected.
    more: Map<String, Value>,
}

impl Rejected {
    /// With a status of HTTP other than that of the code.
    pub(crate) fn with_status(self, status: StatusCode) -> Self {
        Self { status, ..self }
    }

    /// With the fields of this object.
    pub(super) fn with(self, more: Value) -> Self {
        match more {
            Value::Object(more) => Self { more, ..self },
            _ => self,
        }
    }

    /// The last line of a stream, which has its status of HTTP in itself.
    pub(super) fn line(&self) -> Value {
        let mut fields = self.fields();
        fields.insert("status".into(), self.status.as_u16().into());
        Value::Object(fields)
    }

    /// The JSON of the answer.
    fn json(&self) -> Value {
        Value::Object(self.fields())
    }

    fn fields(&self) -> Map<String, Value> {
        let Rejection { code, message, found, wanted, .. } = &*self.rejection;
        let next = self.rejection.advice();
        let mut fields = self.more.clone();
        let four_lines = [("message", message.as_str()), ("found", found), ("wanted", wanted), ("next", next)];
        fields.insert("code".into(), code.to_string().into());
        fields.extend(four_lines.map(|(name, text)| (name.to_owned(), text.into())));
        fields
    }
}

impl From<Rejection> for Rejected {
    fn from(rejection: Rejection) -> Self {
        Self { status: status_of(rejection.code), rejection: Box::new(rejection), more: Map::new() }
    }
}

/// A rejected call of a service.
impl From<Status> for Rejected {
    fn from(status: Status) -> Self {
        ledger_api::from_status("this node", &status).into()
    }
}

impl IntoResponse for Rejected {
    fn into_response(self) -> Response {
        (self.status, HEADERS, self.json().to_string()).into_response()
    }
}

/// The status of HTTP for a code: programs that know only HTTP react to it.
fn status_of(code: Code) -> StatusCode {
    match (code, code.class()) {
        (Code::CertificateRequired, _) => StatusCode::UNAUTHORIZED,
        (Code::NotFound | Code::Pruned, _) => StatusCode::NOT_FOUND,
        (Code::TooLarge, _) => StatusCode::PAYLOAD_TOO_LARGE,
        (Code::Overloaded, _) => StatusCode::TOO_MANY_REQUESTS,
        (_, Class::Denied) => StatusCode::FORBIDDEN,
        (_, Class::Invalid) => StatusCode::BAD_REQUEST,
        (_, Class::Conflict) => StatusCode::CONFLICT,
        (_, Class::Unreachable) => StatusCode::SERVICE_UNAVAILABLE,
        (_, Class::Ok | Class::Failure) => StatusCode::INTERNAL_SERVER_ERROR,
    }
}

/// An answer in JSON.
pub(crate) fn answer(body: &impl Serialize) -> Result<Response, Rejected> {
    let body = serde_json::to_vec(body);
    let body =
        body.map_err(|error| Rejection::new(Code::Internal, "the answer cannot be encoded").found(error.to_string()))?;
    Ok((HEADERS, body).into_response())
}

/// The answer where nothing is.
pub(super) async fn unknown_path(request: Request) -> Rejected {
    let rejection = Rejection::new(Code::NotFound, "unknown path")
        .found(request.uri().path())
        .wanted("a path in docs/http.md")
        .next("health and metrics have a separate listener: [admin] listen in ledgerd.toml");
    discard(request).await;
    rejection.into()
}

/// The answer beside the services of gRPC: tools of gRPC hear that there is no such call, all others that there is no such path.
pub(crate) async fn elsewhere(request: Request) -> Response {
    let kind = request.headers().get(CONTENT_TYPE).map(HeaderValue::as_bytes).unwrap_or_default();
    if kind.starts_with(b"application/grpc") {
        return Status::unimplemented("unknown call").into_http();
    }
    unknown_path(request).await.into_response()
}

/// The answer to another method than that of an endpoint.
pub(crate) async fn other_method(request: Request) -> Rejected {
    let rejection = Rejection::new(Code::BadArgument, "the endpoint requires another method")
        .found(format!("{} {}", request.method(), request.uri().path()))
        .wanted("GET to read; POST to query, submit, enrol and open a session");
    discard(request).await;
    Rejected::from(rejection).with_status(StatusCode::METHOD_NOT_ALLOWED)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn a_rejection_keeps_its_four_lines_and_its_code_gives_the_status() {
        let held = Rejection::new(Code::Held, "Rover/cmd_vel is held").found("Org1/Salma").next("wait");
        let status = ledger_api::to_status(&held);
        let shown = Rejected::from(status).with(json!({ "height": 4 }));
        assert_eq!(shown.status, StatusCode::CONFLICT);
        let wanted = json!({
            "code": "LGR-3005", "message": "Rover/cmd_vel is held", "found": "Org1/Salma", "wanted": "", "next": "wait", "height": 4
        });
        assert_eq!(shown.json(), wanted);
    }

    #[test]
    fn every_code_has_a_status_of_its_class() {
        for code in Code::ALL {
            let status = status_of(*code).as_u16();
            let fits = match code.class() {
                Class::Denied => [401, 403].contains(&status),
                Class::Invalid => [400, 404, 413].contains(&status),
                Class::Conflict => status == 409,
                Class::Unreachable => [429, 503].contains(&status),
                Class::Ok | Class::Failure => status == 500,
            };
            assert!(fits, "{code}: {status}");
        }
    }
}
