//! The application: files that are part of this program, served as they stand in `console/`.

use axum::Router;
use axum::http::header::{CACHE_CONTROL, CONTENT_TYPE, ETAG, IF_NONE_MATCH};
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use ledger_base::hash::Hash;

/// A file: its path, and its content.
type File = (&'static str, &'static [u8]);

/// The files below `console/`, each at its own path.
macro_rules! files {
    ($($path:literal)*) => { [$((concat!("/", $path), include_bytes!(concat!(env!("CARGO_MANIFEST_DIR"), "/console/", $path)) as &[u8]),)*] };
}

const FILES: &[File] = &files! {
    "index.html"
    "console.css"
    "icon.svg"
    "main.js"
    "data/access.js"
    "data/api.js"
    "data/bytes.js"
    "data/calls.js"
    "data/der.js"
    "data/diff.js"
    "data/identity.js"
    "data/ledger.js"
    "data/live.js"
    "data/messages.js"
    "data/payload.js"
    "data/proof.js"
    "data/route.js"
    "data/session.js"
    "data/stop.js"
    "data/transaction.js"
    "pages/access.js"
    "pages/block.js"
    "pages/blocks.js"
    "pages/can.js"
    "pages/enrol.js"
    "pages/feed.js"
    "pages/flow.js"
    "pages/identities.js"
    "pages/nodes.js"
    "pages/policies.js"
    "pages/robot.js"
    "pages/robots.js"
    "pages/tasks.js"
    "pages/transaction.js"
    "view/chart.js"
    "view/dom.js"
    "view/meaning.js"
    "view/parts.js"
    "view/question.js"
};

/// The path of the start page.
const START: &str = "/index.html";

/// Serves them; the start page at `/`.
pub(super) fn router() -> Router {
    FILES.iter().fold(Router::new(), |router, (path, content)| {
        let (kind, tag) = (kind(path), format!("\"{}\"", Hash::of(&[content])));
        let path = if *path == START { "/" } else { path };
        router.route(path, get(move |headers: HeaderMap| async move { answer(&headers, kind, content, &tag) }))
    })
}

fn kind(path: &str) -> &'static str {
    match path.rsplit_once('.').map(|(_, end)| end) {
        Some("html") => "text/html; charset=utf-8",
        Some("css") => "text/css; charset=utf-8",
        Some("svg") => "image/svg+xml",
        _ => "text/javascript; charset=utf-8",
    }
}

/// The file, unless the browser has this very one.
fn answer(headers: &HeaderMap, kind: &'static str, content: &'static [u8], tag: &str) -> Response {
    let kept = [(CACHE_CONTROL, "no-cache".to_owned()), (ETAG, tag.to_owned())];
    if headers.get(IF_NONE_MATCH).is_some_and(|known| known.as_bytes() == tag.as_bytes()) {
        return (StatusCode::NOT_MODIFIED, kept).into_response();
    }
    (kept, [(CONTENT_TYPE, kind)], content).into_response()
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use std::path::Path;

    /// Not served: a file of types alone.
    const TYPES: &str = "/answers.js";

    /// The paths of the scripts below a directory of `console/`.
    fn scripts(top: &Path, below: &str) -> Vec<String> {
        let entries =
            std::fs::read_dir(top.join(below)).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap());
        let scripts = entries.filter(|name| name.ends_with(".js"));
        scripts
            .map(|name| format!("{}/{name}", if below.is_empty() { String::new() } else { format!("/{below}") }))
            .collect()
    }

    #[test]
    fn every_script_is_served_and_each_kind_has_its_type() {
        let top = Path::new(env!("CARGO_MANIFEST_DIR")).join("console");
        let mut wanted: Vec<_> =
            ["", "data", "pages", "view"].into_iter().flat_map(|below| scripts(&top, below)).collect();
        wanted.retain(|path| path != TYPES);
        let mut served: Vec<_> =
            FILES.iter().map(|(path, _)| (*path).to_owned()).filter(|path| path.ends_with(".js")).collect();
        wanted.sort();
        served.sort();
        assert_eq!(served, wanted);
        assert_eq!(
            ["/index.html", "/console.css", "/icon.svg"].map(kind).map(|kind| kind.split(';').next()),
            [Some("text/html"), Some("text/css"), Some("image/svg+xml"),]
        );
    }
}
