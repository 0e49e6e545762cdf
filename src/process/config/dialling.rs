//! `[peers] allow`: addresses that a node dials although they are of its own machine, or have a privileged port.
//!
//! Each organisation registers the addresses of its nodes, and all nodes dial them. Without a rule an organisation could make
//! them dial services of their own machines.

use ledger_base::rejection::{Code, Rejection};
use std::net::{IpAddr, SocketAddr};
use std::str::FromStr;

/// Below it, ports are those of services of the system (RFC 6335 §6).
const PRIVILEGED_BELOW: u16 = 1024;
/// Stands for any address or any port.
const ANY: &str = "*";

/// `IP:PORT`, either of which may be `*`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AllowedAddress {
    ip: Option<IpAddr>,
    port: Option<u16>,
}

impl FromStr for AllowedAddress {
    type Err = Rejection;

    fn from_str(text: &str) -> Result<Self, Rejection> {
        let refused = || {
            Rejection::new(Code::BadConfiguration, "the address cannot be read")
                .found(format!("{text:?}"))
                .wanted("IP:PORT, where either may be *: 127.0.0.1:*, *:443, [::1]:7451")
        };
        let (ip, port) = text.rsplit_once(':').ok_or_else(refused)?;
        let ip = ip.strip_prefix('[').and_then(|ip| ip.strip_suffix(']')).unwrap_or(ip);
        Ok(Self {
            ip: (ip != ANY).then(|| ip.parse()).transpose().map_err(|_| refused())?,
            port: (port != ANY).then(|| port.parse()).transpose().map_err(|_| refused())?,
        })
    }
}

impl AllowedAddress {
    fn has(&self, address: SocketAddr) -> bool {
        self.ip.is_none_or(|ip| ip == address.ip().to_canonical())
            && self.port.is_none_or(|port| port == address.port())
    }
}

/// The addresses that a node dials for other organisations.
#[derive(Clone, Debug)]
pub(crate) struct DialRules {
    /// The node itself is reached at loopback, so its network is on this machine.
    is_local: bool,
    /// The port at which it is reached.
    port: Option<u16>,
    allowed: Vec<AllowedAddress>,
}

impl DialRules {
    /// The rules of a node that others reach at `own`, `HOST:PORT`.
    pub(crate) fn new(own: &str, allowed: &[AllowedAddress]) -> Self {
        let (host, port) = own.rsplit_once(':').unwrap_or((own, ""));
        let host = host.trim_start_matches('[').trim_end_matches(']');
        let is_local = host.eq_ignore_ascii_case("localhost") || host.parse().is_ok_and(is_loopback);
        Self { is_local, port: port.parse().ok(), allowed: allowed.to_vec() }
    }

    /// Why this node does not dial the address; none if it does.
    pub(crate) fn refusal(&self, address: SocketAddr) -> Option<&'static str> {
        if self.allowed.iter().any(|allowed| allowed.has(address)) {
            return None;
        }
        if is_loopback(address.ip()) && !self.is_local {
            return Some("an address of this machine itself");
        }
        let is_privileged = address.port() < PRIVILEGED_BELOW && self.port != Some(address.port());
        is_privileged.then_some("a privileged port")
    }
}

fn is_loopback(ip: IpAddr) -> bool {
    ip.to_canonical().is_loopback()
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    fn refused(own: &str, allowed: &[&str], address: &str) -> bool {
        let allowed: Vec<AllowedAddress> = allowed.iter().map(|text| text.parse().unwrap()).collect();
        DialRules::new(own, &allowed).refusal(address.parse().unwrap()).is_some()
    }

    #[test]
    fn loopback_is_dialled_by_a_node_of_loopback_alone() {
        for address in ["127.0.0.1:7451", "127.9.9.9:7451", "[::1]:7451", "[::ffff:127.0.0.1]:7451"] {
            for elsewhere in ["10.0.0.4:7450", "node1.lan:7450", "[fd00::4]:7450", "0.0.0.0:7450", ""] {
                assert!(refused(elsewhere, &[], address), "{elsewhere} {address}");
            }
            for here in ["127.0.0.1:7450", "localhost:7450", "[::1]:7450"] {
                assert!(!refused(here, &[], address), "{here} {address}");
            }
        }
        assert!(!refused("10.0.0.4:7450", &[], "10.0.0.5:7450"));
    }

    #[test]
    fn a_privileged_port_is_dialled_if_it_is_the_nodes_own_or_allowed() {
        for own in ["10.0.0.4:7450", "127.0.0.1:7450"] {
            assert!(refused(own, &[], "10.0.0.5:22") && refused(own, &[], "10.0.0.5:1023"));
            assert!(!refused(own, &[], "10.0.0.5:1024"));
        }
        assert!(!refused("10.0.0.4:443", &[], "10.0.0.5:443"));
        assert!(refused("10.0.0.4:443", &[], "10.0.0.5:22"));
    }

    #[test]
    fn allowed_addresses_are_dialled_and_no_others() {
        assert!(!refused("10.0.0.4:7450", &["*:443"], "10.0.0.5:443"));
        assert!(refused("10.0.0.4:7450", &["*:443"], "10.0.0.5:80"));
        assert!(!refused("10.0.0.4:7450", &["127.0.0.1:*"], "127.0.0.1:7451"));
        assert!(refused("10.0.0.4:7450", &["127.0.0.1:*"], "[::1]:7451"));
        assert!(!refused("10.0.0.4:7450", &["[::1]:7451"], "[::1]:7451"));
        for bad in ["", "*", "localhost:443", "10.0.0.5:port", "10.0.0.5:70000", "[::1]"] {
            assert!(bad.parse::<AllowedAddress>().is_err(), "{bad}");
        }
    }
}
