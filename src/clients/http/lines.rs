//! Streams: one JSON object on each line. A stream that fails ends with a line that is a rejection.

use super::Rejected;
use axum::body::Body;
use axum::http::header::{CACHE_CONTROL, CONTENT_TYPE};
use axum::response::{IntoResponse, Response};
use bytes::Bytes;
use futures::{Stream, StreamExt};
use serde::Serialize;
use std::convert::Infallible;
use tonic::Status;

/// The type of a stream.
const KIND: &str = "application/x-ndjson";

/// A stream of messages, each as this shape.
pub(super) fn answer<T, S: Serialize>(
    messages: impl Stream<Item = Result<T, Status>> + Send + 'static,
    mut shape: impl FnMut(T) -> S + Send + 'static,
) -> Response {
    let lines = messages.map(move |message| {
        let line = match message {
            Ok(message) => serde_json::to_vec(&shape(message)).unwrap_or_default(),
            Err(status) => Rejected::from(status).line().to_string().into_bytes(),
        };
        Ok::<_, Infallible>(Bytes::from([&line[..], b"\n"].concat()))
    });
    ([(CONTENT_TYPE, KIND), (CACHE_CONTROL, "no-store")], Body::from_stream(lines)).into_response()
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use ledger_base::rejection::{Code, Rejection};

    #[tokio::test]
    async fn each_message_is_a_line_and_so_is_the_end_of_a_stream_that_fails() {
        let failed = ledger_api::to_status(&Rejection::new(Code::Revoked, "the certificate was revoked"));
        let answer = answer(futures::stream::iter([Ok(1), Ok(2), Err(failed)]), |number| [number]);
        let body = axum::body::to_bytes(answer.into_body(), 1000).await.unwrap();
        let text = String::from_utf8(body.to_vec()).unwrap();
        let lines: Vec<&str> = text.lines().collect();
        assert!(text.ends_with('\n') && lines.len() == 3, "{text}");
        assert_eq!(lines.get(..2), Some(&["[1]", "[2]"][..]));
        assert!(text.contains("\"code\":\"LGR-2004\"") && text.contains("\"status\":403"), "{text}");
    }
}
