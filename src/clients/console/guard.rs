//! Which requests are looked at, and the headers of every answer.
//!
//! A page of somebody else can make a browser send requests here. Its requests say so in `Origin`. And its owner can let its own name
//! point to this machine (DNS rebinding). Its requests have that name in `Host`. Neither is answered.

use super::Shared;
use crate::process::config;
use axum::extract::{Request, State};
use axum::http::header::{
    CONTENT_SECURITY_POLICY, HOST, HeaderName, HeaderValue, ORIGIN, REFERRER_POLICY, X_CONTENT_TYPE_OPTIONS,
    X_FRAME_OPTIONS,
};
use axum::http::{HeaderMap, Method, StatusCode};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use std::net::{IpAddr, Ipv6Addr, SocketAddr};
use std::sync::Arc;

/// Nothing but what this node serves; no script or style in the page itself; in no frame of another page.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; \
                      base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

const HEADERS: [(HeaderName, &str); 7] = [
    (CONTENT_SECURITY_POLICY, POLICY),
    (X_CONTENT_TYPE_OPTIONS, "nosniff"),
    (X_FRAME_OPTIONS, "DENY"),
    (REFERRER_POLICY, "no-referrer"),
    (HeaderName::from_static("cross-origin-opener-policy"), "same-origin"),
    (HeaderName::from_static("cross-origin-resource-policy"), "same-origin"),
    (HeaderName::from_static("permissions-policy"), "camera=(), microphone=(), geolocation=(), payment=(), usb=()"),
];

/// The answer to a request that is not meant for this console.
const FOREIGN: &str = "the host is no name of this console (see [console] name in ledgerd.toml), \
                       or the request does not come from its page (Origin)\n";

/// The names by which browsers may reach the console.
pub(super) struct Names {
    scheme: &'static str,
    hosts: Vec<String>,
}

/// The origin of a request: what its browser calls this console.
#[derive(Clone)]
pub(super) struct Origin(pub(super) String);

/// The host of `HOST:PORT`, without the brackets of IPv6.
fn host_of(authority: &str) -> &str {
    match authority.strip_prefix('[') {
        Some(rest) => rest.split(']').next().unwrap_or(rest),
        None => authority.split(':').next().unwrap_or(authority),
    }
}

/// The names and addresses by which browsers may know a console of a node that others reach at `reached`, `HOST:PORT`.
pub(super) fn hosts(settings: &config::Console, reached: &str) -> Vec<String> {
    let named = [settings.name.as_str(), host_of(&settings.listen), host_of(reached), "localhost"];
    named.into_iter().filter(|name| !name.is_empty()).map(str::to_ascii_lowercase).collect()
}

impl Names {
    pub(super) fn new(hosts: Vec<String>, is_secure: bool) -> Self {
        Self { scheme: if is_secure { "https" } else { "http" }, hosts }
    }

    /// Where browsers find the console that listens there.
    pub(super) fn address(&self, settings: &config::Console, reached: &str, listens: SocketAddr) -> String {
        let host = match settings.name.as_str() {
            "" if listens.ip().is_unspecified() => host_of(reached),
            "" => host_of(&settings.listen),
            name => name,
        };
        let port = listens.port();
        match host.parse::<Ipv6Addr>() {
            Ok(address) => format!("{}://[{address}]:{port}", self.scheme),
            Err(_) => format!("{}://{host}:{port}", self.scheme),
        }
    }

    /// An address belongs to no name that somebody could let point elsewhere.
    fn are_ours(&self, host: &str) -> bool {
        let host = host_of(host).to_ascii_lowercase();
        host.parse::<IpAddr>().is_ok() || self.hosts.contains(&host)
    }

    /// The origin of a request for this console; none if it is meant for another one, or comes from another page.
    fn origin(&self, headers: &HeaderMap, method: &Method) -> Option<Origin> {
        let host = headers.get(HOST)?.to_str().ok().filter(|host| self.are_ours(host))?;
        let own = format!("{}://{host}", self.scheme);
        let told = headers.get(ORIGIN).map(|origin| origin.to_str().unwrap_or_default());
        let is_own = match told {
            Some(told) => told.eq_ignore_ascii_case(&own),
            None => method == Method::GET || method == Method::HEAD,
        };
        is_own.then_some(Origin(own))
    }
}

/// Answers requests that are meant for this console.
pub(super) async fn guarded(State(shared): State<Arc<Shared>>, mut request: Request, next: Next) -> Response {
    let mut answer = match shared.names.origin(request.headers(), request.method()) {
        Some(origin) => {
            request.extensions_mut().insert(origin);
            next.run(request).await
        }
        None => (StatusCode::FORBIDDEN, FOREIGN).into_response(),
    };
    for (name, value) in HEADERS {
        answer.headers_mut().insert(name, HeaderValue::from_static(value));
    }
    answer
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    fn names() -> Names {
        let settings =
            config::Console { listen: "0.0.0.0:7452".into(), name: "robots.example".into(), ..Default::default() };
        Names::new(hosts(&settings, "node1.lan:7450"), true)
    }

    fn origin(method: Method, host: &str, origin: Option<&str>) -> Option<String> {
        let mut headers = HeaderMap::new();
        headers.insert(HOST, host.parse().unwrap());
        if let Some(origin) = origin {
            headers.insert(ORIGIN, origin.parse().unwrap());
        }
        names().origin(&headers, &method).map(|Origin(origin)| origin)
    }

    #[test]
    fn a_page_of_somebody_else_and_a_name_of_somebody_else_are_refused() {
        for host in
            ["robots.example", "Robots.Example:7452", "node1.lan:7452", "localhost:9", "10.0.0.4:7452", "[::1]:7452"]
        {
            assert_eq!(origin(Method::GET, host, None), Some(format!("https://{host}")), "{host}");
            assert_eq!(origin(Method::POST, host, Some(&format!("https://{host}"))), Some(format!("https://{host}")));
            for other in [None, Some("null"), Some("https://evil.example"), Some("http://localhost:9")] {
                assert_eq!(origin(Method::POST, host, other), None, "{host} {other:?}");
            }
        }
        for host in ["evil.example", "robots.example.evil.example", "10.0.0.4.evil.example", "", "[::1].evil"] {
            let is_ours = host.starts_with("[::1]");
            assert_eq!(origin(Method::GET, host, None).is_some(), is_ours, "{host}");
        }
    }

    #[test]
    fn a_console_is_found_by_its_name_or_else_where_the_node_is_reached() {
        let at = |listen: &str, name: &str, listens: &str| {
            let settings = config::Console { listen: listen.into(), name: name.into(), ..Default::default() };
            let names = Names::new(hosts(&settings, "10.0.0.4:7450"), true);
            names.address(&settings, "10.0.0.4:7450", listens.parse().unwrap())
        };
        assert_eq!(at("0.0.0.0:0", "", "0.0.0.0:4711"), "https://10.0.0.4:4711");
        assert_eq!(at("127.0.0.1:7452", "", "127.0.0.1:7452"), "https://127.0.0.1:7452");
        assert_eq!(at("[::1]:7452", "", "[::1]:7452"), "https://[::1]:7452");
        assert_eq!(at("0.0.0.0:443", "robots.example", "0.0.0.0:443"), "https://robots.example:443");
    }
}
