//! Ports of participants (§9.6.1.1), and the address by which a peer is reached.

use crate::interface::Config;
use std::net::{Ipv4Addr, SocketAddrV4};

/// The group of discovery (§9.6.1.4.1); here of samples as well.
pub(crate) const GROUP: Ipv4Addr = Ipv4Addr::new(239, 255, 0, 1);
/// Participants of a static peer that are asked, by their numbers 0 to 32. `rmw_cyclonedds` of Jazzy gives out exactly these
/// (`MaxAutoParticipantIndex` 32); Fast DDS asks the first 4, RustDDS the first 12.
pub(crate) const STATIC_PEER_PARTICIPANTS: u16 = 33;
/// Most addresses to which one datagram for one peer goes, if none of them is known to work.
const ADDRESSES_MAX: usize = 4;

/// Ports (§9.6.1.1): PB 7400, DG 250, PG 2, d0 0, d1 10, d2 1, d3 11. None beyond 65535.
fn port(domain: u16, offset: u32) -> Option<u16> {
    u16::try_from(7400 + 250 * u32::from(domain) + offset).ok()
}

/// The multicast address by which all participants of a domain find each other.
pub(crate) fn discovery_multicast(domain: u16) -> Option<SocketAddrV4> {
    Some(SocketAddrV4::new(GROUP, port(domain, 0)?))
}

/// Where all participants of a domain take samples.
pub(crate) fn data_multicast(domain: u16) -> Option<SocketAddrV4> {
    Some(SocketAddrV4::new(GROUP, port(domain, 1)?))
}

/// The port of discovery of a participant.
pub(crate) fn discovery_port(domain: u16, participant: u16) -> Option<u16> {
    port(domain, 10 + 2 * u32::from(participant))
}

/// The port of samples of a participant.
pub(crate) fn data_port(domain: u16, participant: u16) -> Option<u16> {
    port(domain, 11 + 2 * u32::from(participant))
}

/// Where participants of static peers may be, but this participant itself.
pub(crate) fn static_peers(config: &Config) -> Vec<SocketAddrV4> {
    let own = discovery_port(config.domain, config.participant_id);
    let ports = (0..STATIC_PEER_PARTICIPANTS).filter_map(|id| discovery_port(config.domain, id));
    let ports: Vec<u16> = ports.collect();
    let is_own = |to: &SocketAddrV4| Some(to.port()) == own && is_of_host(config, *to.ip());
    let all = config.static_peers.iter().flat_map(|ip| ports.iter().map(|port| SocketAddrV4::new(*ip, *port)));
    all.filter(|to| !is_own(to)).collect()
}

/// Is it an address of this host?
pub(crate) fn is_of_host(config: &Config, ip: Ipv4Addr) -> bool {
    ip.is_loopback() || config.host.contains(&ip)
}

/// The way to a peer: as few addresses as are certain to work.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Route {
    /// Empty if it cannot be reached.
    pub(crate) to: Vec<SocketAddrV4>,
    /// Is the peer on this host?
    pub(crate) is_local: bool,
}

/// Chooses among the addresses that a peer announces. `source`: the address from which it was heard, if it is trusted to work.
///
/// A peer is on this host if all its addresses are: `172.17.0.1` of Docker is on many hosts. Then the loopback is chosen if it is
/// announced. Otherwise the announced address from which the peer sends, then one of a network of this host, then all.
pub(crate) fn route(config: &Config, announced: &[SocketAddrV4], source: Option<Ipv4Addr>) -> Route {
    let usable = |to: &&SocketAddrV4| to.port() != 0 && !to.ip().is_unspecified() && !to.ip().is_broadcast();
    let announced: Vec<SocketAddrV4> = announced.iter().filter(usable).copied().collect();
    let is_local = !announced.is_empty() && announced.iter().all(|to| is_of_host(config, *to.ip()));
    let first = |wanted: &dyn Fn(Ipv4Addr) -> bool| announced.iter().find(|to| wanted(*to.ip())).copied();
    if is_local {
        let to = first(&|ip| ip.is_loopback()).or_else(|| announced.first().copied());
        return Route { to: to.into_iter().collect(), is_local };
    }
    let one = first(&|ip| Some(ip) == source && !ip.is_loopback())
        .or_else(|| first(&|ip| !is_of_host(config, ip) && config.addresses.iter().any(|own| is_same_net(*own, ip))));
    let to = match one {
        Some(to) => vec![to],
        // An address of this host may be a peer's whose other interface came later than the list of addresses.
        None => announced.iter().filter(|to| !to.ip().is_loopback()).take(ADDRESSES_MAX).copied().collect(),
    };
    Route { to, is_local }
}

/// Do they look like addresses of one network? The first 24 bits count: masks are not announced.
fn is_same_net(a: Ipv4Addr, b: Ipv4Addr) -> bool {
    let [a, b] = [a, b].map(|ip| u32::from(ip) >> 8);
    a == b
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::guid::GuidPrefix;
    use bytes::Bytes;
    use std::time::Duration;

    fn config(addresses: &[[u8; 4]]) -> Config {
        let addresses: Vec<Ipv4Addr> = addresses.iter().copied().map(Ipv4Addr::from).collect();
        Config {
            prefix: GuidPrefix([1; 12]),
            domain: 0,
            participant_id: 1,
            lease: Duration::from_secs(10),
            addresses: addresses.clone(),
            host: addresses,
            static_peers: vec![Ipv4Addr::LOCALHOST, Ipv4Addr::new(10, 0, 0, 9)],
            multicast: true,
            name: String::new(),
            user_data: Bytes::new(),
        }
    }

    fn at(ips: &[[u8; 4]]) -> Vec<SocketAddrV4> {
        ips.iter().map(|ip| SocketAddrV4::new(Ipv4Addr::from(*ip), 7411)).collect()
    }

    #[test]
    fn a_peer_on_this_host_is_reached_by_the_loopback_if_it_announces_it() {
        let config = config(&[[192, 168, 1, 5], [172, 17, 0, 1]]);
        let both = route(&config, &at(&[[192, 168, 1, 5], [127, 0, 0, 1]]), None);
        assert_eq!(both, Route { to: at(&[[127, 0, 0, 1]]), is_local: true });
        let one = route(&config, &at(&[[192, 168, 1, 5], [172, 17, 0, 1]]), None);
        assert_eq!(one, Route { to: at(&[[192, 168, 1, 5]]), is_local: true });
    }

    #[test]
    fn an_address_that_many_hosts_have_does_not_make_a_peer_local() {
        let config = config(&[[192, 168, 1, 5], [172, 17, 0, 1]]);
        let announced = at(&[[172, 17, 0, 1], [192, 168, 1, 7], [127, 0, 0, 1]]);
        assert_eq!(route(&config, &announced, None), Route { to: at(&[[192, 168, 1, 7]]), is_local: false });
    }

    #[test]
    fn the_address_from_which_a_peer_sends_is_chosen_before_others() {
        let config = config(&[[10, 0, 0, 5]]);
        let announced = at(&[[10, 0, 0, 7], [10, 1, 0, 7], [10, 2, 0, 7]]);
        let source = route(&config, &announced, Some(Ipv4Addr::new(10, 1, 0, 7)));
        assert_eq!(source.to, at(&[[10, 1, 0, 7]]));
        assert_eq!(route(&config, &announced, Some(Ipv4Addr::new(9, 9, 9, 9))).to, at(&[[10, 0, 0, 7]]));
        let elsewhere = at(&[[11, 0, 0, 7], [11, 1, 0, 7]]);
        assert_eq!(route(&config, &elsewhere, None).to, elsewhere);
        assert_eq!(route(&config, &[], None), Route::default());
    }

    #[test]
    fn static_peers_are_asked_at_the_ports_of_the_first_33_participants_and_not_at_the_own_one() {
        let all = static_peers(&config(&[]));
        assert_eq!(all.len(), 2 * 33 - 1);
        assert!(all.contains(&SocketAddrV4::new(Ipv4Addr::LOCALHOST, 7410)));
        assert!(!all.contains(&SocketAddrV4::new(Ipv4Addr::LOCALHOST, 7412)));
        assert!(all.contains(&SocketAddrV4::new(Ipv4Addr::new(10, 0, 0, 9), 7412)));
        assert_eq!((discovery_port(232, 62), discovery_port(232, 63)), (Some(65_534), None));
    }
}
