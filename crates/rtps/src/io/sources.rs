//! The hosts with which a participant exchanges datagrams, by their addresses.

use std::net::{Ipv4Addr, UdpSocket};

/// Most addresses of this host that are remembered.
const OWN_MAX: usize = 256;

/// The hosts with which a participant exchanges datagrams.
#[derive(Clone, Debug)]
pub(super) enum Hosts {
    /// All that it reaches.
    All,
    /// This one, and the static peers.
    Local(LocalHosts),
}

/// This host and the static peers.
#[derive(Clone, Debug)]
pub(super) struct LocalHosts {
    peers: Vec<Ipv4Addr>,
    own: Vec<Ipv4Addr>,
}

impl Hosts {
    /// All hosts, or this one with these addresses and the static peers.
    pub(super) fn new(only_local: bool, own: &[Ipv4Addr], peers: &[Ipv4Addr]) -> Self {
        if !only_local {
            return Self::All;
        }
        Self::Local(LocalHosts { peers: peers.to_vec(), own: own.to_vec() })
    }

    /// Is it one of them? The kernel drops packets from other hosts that bear 127.0.0.0/8 or an address of this host.
    pub(super) fn contains(&mut self, address: Ipv4Addr) -> bool {
        match self {
            Self::All => true,
            Self::Local(hosts) => address.is_loopback() || hosts.peers.contains(&address) || hosts.is_own(address),
        }
    }
}

impl LocalHosts {
    /// An interface may have got a new address since the domain was joined.
    fn is_own(&mut self, address: Ipv4Addr) -> bool {
        if self.own.contains(&address) {
            return true;
        }
        let is_own = is_of_this_host(address);
        if is_own && self.own.len() < OWN_MAX {
            self.own.push(address);
        }
        is_own
    }
}

/// Does this host have the address? The kernel binds a socket to its own addresses only.
fn is_of_this_host(address: Ipv4Addr) -> bool {
    !address.is_unspecified()
        && !address.is_multicast()
        && !address.is_broadcast()
        && UdpSocket::bind((address, 0)).is_ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// TEST-NET-1 and TEST-NET-2: no host has these.
    const PEER: Ipv4Addr = Ipv4Addr::new(192, 0, 2, 1);
    const STRANGER: Ipv4Addr = Ipv4Addr::new(198, 51, 100, 1);

    #[test]
    fn a_local_participant_takes_datagrams_of_this_host_and_of_static_peers_only() {
        let mut hosts = Hosts::new(true, &[], &[PEER]);
        assert!(hosts.contains(Ipv4Addr::LOCALHOST) && hosts.contains(PEER));
        for stranger in [STRANGER, Ipv4Addr::UNSPECIFIED, Ipv4Addr::BROADCAST, Ipv4Addr::new(239, 255, 0, 1)] {
            assert!(!hosts.contains(stranger), "{stranger}");
        }
        assert!(Hosts::new(false, &[], &[]).contains(STRANGER));
    }

    #[test]
    fn an_address_is_of_this_host_if_a_socket_can_be_bound_to_it() {
        assert!(is_of_this_host(Ipv4Addr::LOCALHOST));
        assert!(!is_of_this_host(STRANGER));
    }
}
