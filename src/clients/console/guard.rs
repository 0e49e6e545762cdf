//! Rejects requests for other hosts and from other pages ([`Names`](crate::clients::http::Names)), and sets the headers of every answer.

use super::Shared;
use crate::clients::http::{foreign, host_of};
use crate::process::config;
use axum::extract::{Request, State};
use axum::http::header::{
    CONTENT_SECURITY_POLICY, HeaderName, HeaderValue, REFERRER_POLICY, X_CONTENT_TYPE_OPTIONS, X_FRAME_OPTIONS,
};
use axum::middleware::Next;
use axum::response::Response;
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

/// Advice for a request by another name.
const NEXT: &str = "set [console] name in ledgerd.toml to the name that browsers use; a proxy must pass the host \
                    header unchanged (docs/console.md)";

/// The origin of a request: what its browser calls this console.
#[derive(Clone)]
pub(super) struct Origin(pub(super) String);

/// The names and addresses by which browsers may know a console of a node that others reach at `reached`, `HOST:PORT`.
pub(super) fn hosts(settings: &config::Console, reached: &str) -> Vec<String> {
    let named = [settings.name.as_str(), host_of(&settings.listen), host_of(reached), "localhost"];
    named.into_iter().filter(|name| !name.is_empty()).map(str::to_ascii_lowercase).collect()
}

/// Where browsers find the console that listens there, by `http` or `https`.
pub(super) fn address(scheme: &str, settings: &config::Console, reached: &str, listens: SocketAddr) -> String {
    let host = match settings.name.as_str() {
        "" if listens.ip().is_unspecified() => host_of(reached),
        "" => host_of(&settings.listen),
        name => name,
    };
    let port = listens.port();
    // Plain HTTP is on loopback only: browsers come there by a name through a proxy that ends TLS.
    if scheme == "http"
        && host == settings.name
        && host.parse::<IpAddr>().is_err()
        && !host.eq_ignore_ascii_case("localhost")
    {
        return format!("https://{host}");
    }
    match host.parse::<Ipv6Addr>() {
        Ok(address) => format!("{scheme}://[{address}]:{port}"),
        Err(_) => format!("{scheme}://{host}:{port}"),
    }
}

/// Answers requests that are meant for this console.
pub(super) async fn guarded(State(shared): State<Arc<Shared>>, mut request: Request, next: Next) -> Response {
    let mut answer = match shared.names.origin(request.headers(), request.method()) {
        Some(origin) => {
            request.extensions_mut().insert(Origin(origin));
            next.run(request).await
        }
        None => foreign("this console", NEXT),
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

    #[test]
    fn a_console_is_found_by_its_name_or_else_where_the_node_is_reached() {
        let at = |listen: &str, name: &str, listens: &str| {
            let settings = config::Console { listen: listen.into(), name: name.into(), ..Default::default() };
            address("https", &settings, "10.0.0.4:7450", listens.parse().unwrap())
        };
        assert_eq!(at("0.0.0.0:0", "", "0.0.0.0:4711"), "https://10.0.0.4:4711");
        assert_eq!(at("127.0.0.1:7452", "", "127.0.0.1:7452"), "https://127.0.0.1:7452");
        assert_eq!(at("[::1]:7452", "", "[::1]:7452"), "https://[::1]:7452");
        assert_eq!(at("0.0.0.0:443", "robots.example", "0.0.0.0:443"), "https://robots.example:443");
        let settings =
            config::Console { listen: "127.0.0.1:7452".into(), name: "robots.example".into(), ..Default::default() };
        let proxied = address("http", &settings, "10.0.0.4:7450", "127.0.0.1:7452".parse().unwrap());
        assert_eq!(proxied, "https://robots.example");
    }

    #[test]
    fn a_console_has_the_names_of_its_settings_and_of_its_node() {
        let settings =
            config::Console { listen: "0.0.0.0:7452".into(), name: "Robots.example".into(), ..Default::default() };
        assert_eq!(hosts(&settings, "node1.lan:7450"), ["robots.example", "0.0.0.0", "node1.lan", "localhost"]);
    }
}
