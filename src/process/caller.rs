//! The caller: the extension of every request, and the connections of members.

use crate::process::connection_limiter::ConnectionLimiter;
use ledger_identity::Identity;
use std::hash::{Hash, Hasher};
use std::net::{IpAddr, Ipv6Addr};
use std::sync::Arc;

/// The caller; the extension of every request.
#[derive(Clone, Debug)]
pub(crate) struct Caller {
    /// The verified identity; none for a client without a certificate, which can only enrol.
    pub identity: Option<Arc<Identity>>,
    /// Where the connection comes from: who has no certificate is counted by this.
    pub source: IpAddr,
}

/// A member as it is counted: by its name, whichever of its certificates it shows.
#[derive(Clone, Debug)]
pub(crate) struct Named(pub(crate) Arc<Identity>);

/// The connections of members.
pub(crate) type Members = ConnectionLimiter<Named>;

impl Named {
    fn name(&self) -> (&str, &str) {
        (&self.0.organisation, &self.0.name)
    }
}

impl PartialEq for Named {
    fn eq(&self, other: &Self) -> bool {
        self.name() == other.name()
    }
}

impl Eq for Named {}

impl Hash for Named {
    fn hash<H: Hasher>(&self, state: &mut H) {
        self.name().hash(state);
    }
}

/// An address as it is counted: a holder of one address of IPv6 has 2⁶⁴ of them.
pub(crate) fn network_of(source: IpAddr) -> IpAddr {
    match source.to_canonical() {
        IpAddr::V6(address) => Ipv6Addr::from(u128::from(address) & !u128::from(u64::MAX)).into(),
        v4 => v4,
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn a_whole_network_of_ipv6_is_one_source_and_a_mapped_address_is_that_of_ipv4() {
        let (a, b): (Ipv6Addr, Ipv6Addr) = ("2001:db8::1".parse().unwrap(), "2001:db8::ffff:2".parse().unwrap());
        assert_eq!(network_of(a.into()), network_of(b.into()));
        let mapped: Ipv6Addr = "::ffff:10.0.0.1".parse().unwrap();
        assert_eq!(network_of(mapped.into()), IpAddr::from([10, 0, 0, 1]));
    }
}
