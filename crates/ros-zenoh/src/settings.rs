//! How a session joins the graph: mode, endpoints and TLS.

use std::{fmt, net::IpAddr, path::PathBuf, str::FromStr};

/// Longest host name in bytes.
const HOST_BYTES_MAX: usize = 253;

/// The way in which a session takes part.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Mode {
    /// It connects to a router, which carries everything. Nothing connects to it.
    #[default]
    Client,
    /// It connects to a router and to other peers, and they connect to it. The router only tells them of each other.
    Peer,
    /// It is the router.
    Router,
}

impl Mode {
    /// As it is written in a configuration.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Client => "client",
            Self::Peer => "peer",
            Self::Router => "router",
        }
    }
}

/// The protocol of a link.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Protocol {
    /// TCP without TLS.
    Tcp,
    /// TLS over TCP.
    Tls,
}

/// Where a session connects to, or listens: `tcp/127.0.0.1:7447`, `tls/router.local:7447`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Endpoint {
    /// Its protocol.
    pub protocol: Protocol,
    host: String,
    port: u16,
}

impl Endpoint {
    /// Does only this host reach it? A name other than `localhost` may be any host.
    pub fn is_loopback(&self) -> bool {
        let address = self.host.trim_start_matches('[').trim_end_matches(']');
        self.host == "localhost" || address.parse().is_ok_and(|address: IpAddr| address.is_loopback())
    }
}

impl fmt::Display for Endpoint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let protocol = match self.protocol {
            Protocol::Tcp => "tcp",
            Protocol::Tls => "tls",
        };
        write!(f, "{protocol}/{}:{}", self.host, self.port)
    }
}

/// The text is no endpoint.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("it is not of the form tcp/HOST:PORT or tls/HOST:PORT")]
pub struct NoEndpoint;

impl FromStr for Endpoint {
    type Err = NoEndpoint;

    fn from_str(text: &str) -> Result<Self, NoEndpoint> {
        let (protocol, address) = text.split_once('/').ok_or(NoEndpoint)?;
        let protocol = match protocol {
            "tcp" => Protocol::Tcp,
            "tls" => Protocol::Tls,
            _ => return Err(NoEndpoint),
        };
        let (host, port) = address.rsplit_once(':').ok_or(NoEndpoint)?;
        let is_v6 = host
            .strip_prefix('[')
            .and_then(|host| host.strip_suffix(']'))
            .is_some_and(|host| host.parse().is_ok_and(|address: IpAddr| address.is_ipv6()));
        // Nothing behind it: zenoh reads options there.
        let is_name = !host.is_empty()
            && host.len() <= HOST_BYTES_MAX
            && host.chars().all(|c| c.is_ascii_alphanumeric() || matches!(c, '.' | '-' | '_'));
        let is_number = !port.is_empty() && port.chars().all(|c| c.is_ascii_digit());
        if !is_number || !(is_v6 || is_name) {
            return Err(NoEndpoint);
        }
        Ok(Self { protocol, host: host.to_owned(), port: port.parse().map_err(|_| NoEndpoint)? })
    }
}

/// Files for TLS, in PEM.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Tls {
    /// The certificate authority of routers and peers.
    pub ca: Option<PathBuf>,
    /// The own certificate: with it the other end knows who this is.
    pub certificate: Option<PathBuf>,
    /// The key of that certificate.
    pub key: Option<PathBuf>,
}

/// All settings of a session.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Settings {
    /// The way in which it takes part.
    pub mode: Mode,
    /// Where it connects to.
    pub connect: Vec<Endpoint>,
    /// Where it listens. A client does not.
    pub listen: Vec<Endpoint>,
    /// Certificates.
    pub tls: Tls,
    /// Access control as zenoh's configuration has it, `{"enabled": true, …}`; none = everything is allowed.
    pub access_control: Option<String>,
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn an_endpoint_is_a_protocol_a_host_and_a_port() {
        for good in ["tcp/127.0.0.1:7447", "tls/router.local:1", "tcp/[::1]:0", "tcp/localhost:65535"] {
            assert_eq!(good.parse::<Endpoint>().unwrap().to_string(), good);
        }
        for bad in [
            "",
            "tcp/",
            "127.0.0.1:7447",
            "udp/127.0.0.1:1",
            "quic/a:1",
            "tcp/a",
            "tcp/a:",
            "tcp/a:65536",
            "tcp/a:+1",
            "tcp/a:1#iface=eth0",
            "tcp/a:1?rel=0",
            "tcp/a b:1",
            "tcp/[::1:1",
            "tcp/::1:1",
            "tcp/:1",
        ] {
            assert_eq!(bad.parse::<Endpoint>(), Err(NoEndpoint), "{bad}");
        }
    }

    #[test]
    fn only_addresses_of_this_host_are_loopback() {
        let is_loopback = |text: &str| text.parse::<Endpoint>().unwrap().is_loopback();
        assert!(["tcp/127.0.0.1:1", "tcp/127.9.9.9:1", "tls/[::1]:1", "tcp/localhost:1"].into_iter().all(is_loopback));
        let far = ["tcp/0.0.0.0:1", "tcp/[::]:1", "tcp/10.0.0.4:1", "tls/localhost.example:1", "tcp/robot:1"];
        assert!(!far.into_iter().any(is_loopback));
    }
}
