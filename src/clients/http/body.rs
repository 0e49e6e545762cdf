//! Bodies of requests: of one type, of a bounded size, read within a time.

use axum::body::Body;
use axum::extract::Request;
use axum::http::HeaderMap;
use axum::http::header::{CONTENT_LENGTH, CONTENT_TYPE};
use bytes::{Bytes, BytesMut};
use futures::StreamExt;
use ledger_base::rejection::{Code, Rejection};
use serde::de::DeserializeOwned;
use std::time::Duration;
use tokio::time::timeout;

/// Most bytes of a body: the largest set of policies fits.
pub(super) const BODY_BYTES_MAX: usize = 1 << 20;
/// Most bytes of a body of a client without an identity: a signing request and a secret take a few hundred.
pub(super) const NEWCOMER_BODY_BYTES_MAX: usize = 32 << 10;
/// Most bytes that are read of a body that is too large.
const DISCARDED_BYTES_MAX: usize = 4 << 20;
/// Longest time in which a body has to arrive.
const BODY_TIME_MAX: Duration = Duration::from_secs(10);

const JSON: &str = "application/json";
/// The type of a body of bytes.
const BYTES: &str = "application/octet-stream";

/// A body of bytes.
pub(super) async fn bytes(request: Request, bytes_max: usize) -> Result<Bytes, Rejection> {
    read(request, BYTES, "--data-binary @FILE -H 'content-type: application/octet-stream'", bytes_max).await
}

/// A body of JSON that has this form.
pub(super) async fn json<T: DeserializeOwned>(request: Request, bytes_max: usize, form: &str) -> Result<T, Rejection> {
    let body = read(request, JSON, "--json '…'", bytes_max).await?;
    serde_json::from_slice(&body).map_err(|error| {
        Rejection::new(Code::BadArgument, "the body cannot be read")
            .found(error.to_string())
            .wanted(form)
            .next("compare it with the example in docs/http.md")
    })
}

/// The body, if its head promises one that is accepted.
async fn read(request: Request, kind: &str, curl: &str, bytes_max: usize) -> Result<Bytes, Rejection> {
    if let Err(rejection) = check(request.headers(), kind, curl, bytes_max) {
        discard(request).await;
        return Err(rejection);
    }
    collect(request.into_body(), bytes_max, BODY_TIME_MAX).await
}

/// Reads something of a request whose body comes later. If that is rejected, the body is read all the same.
pub(super) async fn before<T>(
    request: Request,
    read: impl FnOnce(&Request) -> Result<T, Rejection>,
) -> Result<(T, Request), Rejection> {
    match read(&request) {
        Ok(read) => Ok((read, request)),
        Err(rejection) => {
            discard(request).await;
            Err(rejection)
        }
    }
}

/// Reads the body of a request that is rejected without it: many clients read no answer before all is sent.
pub(crate) async fn discard(request: Request) {
    if length(request.headers()) <= DISCARDED_BYTES_MAX {
        let _rejected_anyway = collect(request.into_body(), 0, BODY_TIME_MAX).await;
    }
}

/// The number of bytes that the head promises; 0 if it promises none.
fn length(headers: &HeaderMap) -> usize {
    headers.get(CONTENT_LENGTH).and_then(|value| value.to_str().ok()?.parse().ok()).unwrap_or_default()
}

/// The bytes of a body. More than are accepted are discarded as they arrive: many clients read no answer before all is sent.
async fn collect(body: Body, bytes_max: usize, time_max: Duration) -> Result<Bytes, Rejection> {
    let (mut parts, mut kept, mut bytes) = (body.into_data_stream(), BytesMut::new(), 0);
    let read = async {
        while let Some(part) = parts.next().await {
            let part =
                part.map_err(|error| Rejection::new(Code::Malformed, "the body ends early").found(error.to_string()))?;
            bytes += part.len();
            if bytes > DISCARDED_BYTES_MAX {
                break;
            }
            if bytes <= bytes_max {
                kept.extend_from_slice(&part);
            }
        }
        Ok::<_, Rejection>(())
    };
    timeout(time_max, read).await.map_err(|_| {
        Rejection::new(Code::Timeout, "the body arrived too slowly")
            .wanted(format!("the whole body within {} s", time_max.as_secs()))
            .next("send it again, or over a faster connection")
    })??;
    if bytes > bytes_max { Err(too_large(bytes, bytes_max)) } else { Ok(kept.freeze()) }
}

/// A body has this type, and says so: a form of another page can send none of these types without asking first.
fn check(headers: &HeaderMap, kind: &str, curl: &str, bytes_max: usize) -> Result<(), Rejection> {
    let header = |name| headers.get(name).and_then(|value| value.to_str().ok()).unwrap_or_default();
    let given = header(CONTENT_TYPE);
    if given.split(';').next().is_none_or(|given| !given.trim().eq_ignore_ascii_case(kind)) {
        return Err(Rejection::new(Code::BadArgument, "the body has the wrong content type")
            .found(format!("content-type {given:?}"))
            .wanted(kind)
            .next(format!("with curl: {curl}")));
    }
    let length = length(headers);
    if length > DISCARDED_BYTES_MAX { Err(too_large(length, bytes_max)) } else { Ok(()) }
}

fn too_large(bytes: usize, bytes_max: usize) -> Rejection {
    Rejection::new(Code::TooLarge, "the body is too large")
        .found(format!("{bytes} bytes, or more"))
        .wanted(format!("at most {bytes_max} bytes"))
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use serde_json::Value;

    fn request(kind: &str, body: impl Into<Body>) -> Request {
        Request::builder().header(CONTENT_TYPE, kind).body(body.into()).unwrap()
    }

    #[tokio::test]
    async fn a_body_of_another_type_size_form_or_pace_is_rejected() {
        let json = async |kind: &str, body: Body| json::<Value>(request(kind, body), 8, "{…}").await;
        assert!(json("application/json; charset=utf-8", "{}".into()).await.is_ok());
        assert_eq!(json("text/plain", "{}".into()).await.unwrap_err().code, Code::BadArgument);
        assert_eq!(json("application/json", "{".into()).await.unwrap_err().code, Code::BadArgument);
        assert_eq!(json("application/json", "{\"long\":1}".into()).await.unwrap_err().code, Code::TooLarge);
        let never = Body::from_stream(futures::stream::pending::<Result<Bytes, std::io::Error>>());
        assert_eq!(collect(never, 8, Duration::from_millis(1)).await.unwrap_err().code, Code::Timeout);
    }

    #[tokio::test]
    async fn a_length_beyond_the_limit_is_rejected_before_anything_is_read() {
        let never = Body::from_stream(futures::stream::pending::<Result<Bytes, std::io::Error>>());
        let mut request = request(BYTES, never);
        request.headers_mut().insert(CONTENT_LENGTH, (DISCARDED_BYTES_MAX + 1).into());
        assert_eq!(bytes(request, 8).await.unwrap_err().code, Code::TooLarge);
    }
}
