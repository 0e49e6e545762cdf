//! The application: files that are part of this program. `console/build.mjs` makes them of the sources in `console/`.

use axum::Router;
use axum::http::header::{CACHE_CONTROL, CONTENT_TYPE, ETAG, IF_NONE_MATCH};
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use ledger_base::hash::Hash;

/// Path, type and content of each file.
const FILES: [(&str, &str, &[u8]); 4] = [
    ("/", "text/html; charset=utf-8", include_bytes!("../../../console/dist/index.html")),
    ("/console.js", "text/javascript; charset=utf-8", include_bytes!("../../../console/dist/console.js")),
    ("/console.css", "text/css; charset=utf-8", include_bytes!("../../../console/dist/console.css")),
    ("/icon.svg", "image/svg+xml", include_bytes!("../../../console/dist/icon.svg")),
];

/// Serves them.
pub(super) fn router() -> Router {
    let mut router = Router::new();
    for (path, kind, content) in FILES {
        let mark = format!("\"{}\"", Hash::of(&[content]));
        router =
            router.route(path, get(move |headers: HeaderMap| async move { answer(&headers, kind, content, &mark) }));
    }
    router
}

/// The file, unless the browser has this very one.
fn answer(headers: &HeaderMap, kind: &'static str, content: &'static [u8], mark: &str) -> Response {
    let kept = [(CACHE_CONTROL, "no-cache"), (ETAG, mark)];
    if headers.get(IF_NONE_MATCH).is_some_and(|known| known.as_bytes() == mark.as_bytes()) {
        return (StatusCode::NOT_MODIFIED, kept.map(|(name, value)| (name, value.to_owned()))).into_response();
    }
    (kept.map(|(name, value)| (name, value.to_owned())), [(CONTENT_TYPE, kind)], content).into_response()
}
