//! The names by which this machine is reached, and the pages that requests come from.
//!
//! A page of another origin can make a browser send requests here: these say so in `Origin`. And its owner can let its own name
//! point to this machine (DNS rebinding): these requests have that name in `Host`.

use super::rejections::Rejected;
use axum::extract::Request;
use axum::http::header::{HOST, HeaderName, ORIGIN};
use axum::http::{HeaderMap, Method, StatusCode};
use axum::response::{IntoResponse, Response};
use ledger_base::rejection::{Code, Rejection};
use std::net::IpAddr;

/// Where a browser says whether a request comes from a page of the same origin.
const SITE: HeaderName = HeaderName::from_static("sec-fetch-site");

/// The names of a listener.
pub(crate) struct Names {
    scheme: &'static str,
    hosts: Vec<String>,
    /// The name by which browsers reach a listener of plain HTTP through a proxy that ends TLS; empty = there is none.
    proxied: String,
}

/// The host of `HOST:PORT`, without the brackets of IPv6.
pub(crate) fn host_of(authority: &str) -> &str {
    match authority.strip_prefix('[') {
        Some(rest) => rest.split(']').next().unwrap_or(rest),
        None => authority.split(':').next().unwrap_or(authority),
    }
}

/// A header that stands there more than once, or is no text: a proxy in between may have judged another one of its values.
struct Ambiguous;

/// The only value of a header; none if it is missing.
fn single<'a>(headers: &'a HeaderMap, name: &HeaderName) -> Result<Option<&'a str>, Ambiguous> {
    let mut values = headers.get_all(name).iter();
    let value = values.next().map(|value| value.to_str().map_err(|_| Ambiguous)).transpose()?;
    if values.next().is_some() { Err(Ambiguous) } else { Ok(value) }
}

/// `HOST:PORT` of a request: HTTP/2 has it in the address. None if it is ambiguous.
pub(super) fn host(request: &Request) -> Option<String> {
    let named = single(request.headers(), &HOST).ok()?;
    named.or_else(|| request.uri().authority().map(|authority| authority.as_str())).map(str::to_owned)
}

/// Does a page in a browser send this?
pub(super) fn is_of_other_page(headers: &HeaderMap) -> bool {
    headers.contains_key(ORIGIN) || headers.contains_key(SITE)
}

/// The answer to a request that is not meant for a page, such as `this console`.
pub(crate) fn foreign(page: &str, next: &str) -> Response {
    let rejection = Rejection::new(Code::Untrusted, format!("the request is not for {page}"))
        .found("another host name, a page of another origin, or one of these headers twice")
        .wanted("an address or a name of it in the header host, and no other page in the header origin")
        .next(next);
    Rejected::from(rejection).with_status(StatusCode::FORBIDDEN).into_response()
}

impl Names {
    /// Addresses belong to every listener, and so does `localhost`.
    pub(crate) fn new(hosts: impl IntoIterator<Item = String>, is_secure: bool) -> Self {
        let hosts = hosts.into_iter().chain(["localhost".to_owned()]).filter(|host| !host.is_empty());
        let hosts = hosts.map(|host| host.to_ascii_lowercase()).collect();
        Self { scheme: if is_secure { "https" } else { "http" }, hosts, proxied: String::new() }
    }

    /// Under this name, a proxy that ends TLS may stand before a listener of plain HTTP.
    pub(crate) fn proxied(self, name: &str) -> Self {
        Self { proxied: name.to_ascii_lowercase(), ..self }
    }

    /// `http` or `https`.
    pub(crate) fn scheme(&self) -> &'static str {
        self.scheme
    }

    /// Is this, `HOST` or `HOST:PORT`, one of them? An address belongs to no name that could point elsewhere.
    pub(super) fn has(&self, authority: &str) -> bool {
        let host = host_of(authority).to_ascii_lowercase();
        host.parse::<IpAddr>().is_ok() || self.hosts.contains(&host)
    }

    /// The origin of a request for this listener; none if it is meant for another one, or comes from another page.
    pub(crate) fn origin(&self, headers: &HeaderMap, method: &Method) -> Option<String> {
        let host = single(headers, &HOST).ok()?.filter(|host| self.has(host))?;
        let own = format!("{}://{host}", self.scheme);
        let is_read = method == Method::GET || method == Method::HEAD;
        match single(headers, &ORIGIN).ok()? {
            Some(origin) if origin.eq_ignore_ascii_case(&own) => Some(own),
            Some(origin) => {
                let proxied = format!("https://{host}");
                let is_proxied = !self.proxied.is_empty() && host_of(host).eq_ignore_ascii_case(&self.proxied);
                (is_proxied && origin.eq_ignore_ascii_case(&proxied)).then_some(proxied)
            }
            None => is_read.then_some(own),
        }
    }

    /// May a session be used by this request, whose `Origin` is right? Browsers leave `Origin` out where a page reads from its own
    /// origin, and say `same-origin` instead.
    pub(crate) fn is_of_own_page(headers: &HeaderMap) -> bool {
        headers.get_all(SITE).iter().all(|site| site == "same-origin")
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    fn origin(method: Method, host: &str, origin: Option<&str>) -> Option<String> {
        let mut headers = HeaderMap::new();
        headers.insert(HOST, host.parse().unwrap());
        if let Some(origin) = origin {
            headers.insert(ORIGIN, origin.parse().unwrap());
        }
        Names::new(["robots.example", "node1.lan"].map(str::to_owned), true).origin(&headers, &method)
    }

    #[test]
    fn another_page_and_a_foreign_name_are_rejected() {
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
    fn a_header_that_is_there_twice_is_rejected() {
        let names = Names::new(["robots.example".to_owned()], false);
        let mut headers = HeaderMap::new();
        headers.append(HOST, "robots.example".parse().unwrap());
        headers.append(ORIGIN, "http://robots.example".parse().unwrap());
        assert!(names.origin(&headers, &Method::POST).is_some());
        for (name, value) in
            [(HOST, "robots.example"), (ORIGIN, "http://robots.example"), (ORIGIN, "http://evil.example")]
        {
            let mut twice = headers.clone();
            twice.append(name, value.parse().unwrap());
            assert_eq!(names.origin(&twice, &Method::POST), None, "{value}");
        }
        let mut twice = HeaderMap::new();
        twice.append(SITE, "same-origin".parse().unwrap());
        twice.append(SITE, "cross-site".parse().unwrap());
        assert!(!Names::is_of_own_page(&twice));
    }

    #[test]
    fn a_proxy_that_ends_tls_stands_before_plain_http_under_the_configured_name_alone() {
        let asked = |names: &Names, host: &str, origin: &str| {
            let headers = HeaderMap::from_iter([(HOST, host.parse().unwrap()), (ORIGIN, origin.parse().unwrap())]);
            names.origin(&headers, &Method::POST)
        };
        let names = |name: &str| Names::new([name.to_owned()], false).proxied(name);
        let proxied = names("Robots.example");
        let secure = "https://robots.example";
        assert_eq!(asked(&proxied, "robots.example", secure).as_deref(), Some(secure));
        assert_eq!(
            asked(&proxied, "robots.example:8443", "https://robots.example:8443").as_deref(),
            Some("https://robots.example:8443")
        );
        assert_eq!(asked(&proxied, "localhost:7452", "https://localhost:7452"), None);
        assert_eq!(asked(&proxied, "robots.example", "https://evil.example"), None);
        assert_eq!(asked(&names(""), "localhost", "https://localhost"), None);
    }

    #[test]
    fn a_session_is_used_by_its_own_page_or_by_a_program() {
        let from = |site: &str| HeaderMap::from_iter([(SITE, site.parse().unwrap())]);
        assert!(Names::is_of_own_page(&from("same-origin")) && Names::is_of_own_page(&HeaderMap::new()));
        for site in ["cross-site", "same-site", "none"] {
            assert!(!Names::is_of_own_page(&from(site)), "{site}");
        }
    }
}
