//! Opens the sockets of a participant: four that receive, and those that send.

use super::filter;
use crate::discovery::locators::{GROUP, data_multicast, data_port, discovery_multicast, discovery_port};
use crate::interface::Channel;
use crate::limits::LOCATORS_MAX;
use socket2::{Domain, Protocol, SockFilter, Socket, Type};
use std::io::{self, ErrorKind};
use std::net::{Ipv4Addr, SocketAddr, UdpSocket};

/// Receive and send buffers that are asked for, bytes. The kernel grants at most `net.core.rmem_max` and `net.core.wmem_max`.
const BUFFER_BYTES: usize = 8 * 1024 * 1024;
/// A receive buffer below this is logged: a burst of a large sample overflows it, bytes.
const BUFFER_BYTES_LOW: usize = 1024 * 1024;
/// Largest participant id that is tried.
const PARTICIPANT_ID_MAX: u16 = 119;

/// The addresses of the interfaces of this host.
#[derive(Clone, Debug, Default)]
pub(super) struct Interfaces {
    /// All of them.
    pub(super) host: Vec<Ipv4Addr>,
    /// Those under which the participant is reached.
    pub(super) used: Vec<Ipv4Addr>,
    /// Those of `used` whose interfaces have multicast. The loopback has none in most systems.
    pub(super) multicast: Vec<Ipv4Addr>,
}

impl Interfaces {
    /// Reads them; `only`: those that may be used, all if there is none. Blocks for some system calls.
    pub(super) fn read(only: Option<&[Ipv4Addr]>) -> Self {
        let interfaces = netdev::get_interfaces().into_iter().flat_map(|interface| {
            let has_multicast = interface.is_multicast();
            interface.ipv4.into_iter().map(move |net| (net.addr(), has_multicast))
        });
        let mut interfaces: Vec<_> = interfaces.collect();
        // The loopback first: with more addresses than announcements have room for, it is among them.
        interfaces.sort_by_key(|(address, _)| (!address.is_loopback(), *address));
        interfaces.dedup_by_key(|(address, _)| *address);
        let host: Vec<_> = interfaces.iter().map(|(address, _)| *address).collect();
        interfaces.retain(|(address, _)| only.is_none_or(|only| only.contains(address)));
        interfaces.truncate(LOCATORS_MAX);
        if interfaces.is_empty() {
            let named =
                |addresses: &[Ipv4Addr]| addresses.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ");
            let (allowed, found) = (only.map_or_else(|| "all".to_owned(), named), named(&host));
            tracing::warn!(allowed, found, "no interface has an address that DDS may use: it cannot be reached");
        }
        let used = interfaces.iter().map(|(address, _)| *address).collect();
        let multicast = interfaces.iter().filter(|(_, has_multicast)| *has_multicast).map(|(address, _)| *address);
        Self { host, used, multicast: multicast.collect() }
    }
}

/// The sockets that receive.
#[derive(Debug)]
pub(super) struct ReceiveSockets {
    /// By what they receive.
    pub(super) channels: Vec<(Channel, UdpSocket)>,
    /// The participant id for which both unicast ports were free.
    pub(super) participant_id: u16,
    /// Does it receive multicasts?
    pub(super) has_multicast: bool,
}

/// The sockets that send.
#[derive(Debug)]
pub(super) struct SendSockets {
    /// To other hosts.
    pub(super) remote: UdpSocket,
    /// To this host. It is another one so that a slow network does not fill its buffer.
    pub(super) local: UdpSocket,
    /// To the multicast group, each by one interface.
    pub(super) multicast: Vec<UdpSocket>,
}

impl ReceiveSockets {
    /// Opens those of a participant of a domain, which receives multicasts by these interfaces. `sources`: if not none, datagrams
    /// of this host and of these addresses are taken only.
    ///
    /// # Errors
    /// If no participant id is free, or a socket cannot be opened. Without multicast it works by static peers.
    pub(super) fn open(domain: u16, interfaces: &[Ipv4Addr], sources: Option<&[Ipv4Addr]>) -> io::Result<Self> {
        // Attached before a socket is bound, so that nothing comes in before.
        let filter = sources.map(filter::local_or_from);
        let filter = filter.as_deref();
        let (participant_id, unicast) = unicast_receivers(domain, filter)?;
        let mut channels = Vec::from(unicast);
        let multicast = match interfaces {
            [] => None,
            _ => multicast_receivers(domain, interfaces, filter)
                .inspect_err(|error| tracing::warn!(domain, %error, "DDS receives no multicasts"))
                .ok(),
        };
        let has_multicast = multicast.is_some();
        channels.extend(multicast.into_iter().flatten());
        Ok(Self { channels, participant_id, has_multicast })
    }
}

impl SendSockets {
    /// Opens them: one for multicasts by each of these interfaces. With `only_local`, multicasts stay on this host.
    pub(super) fn open(interfaces: &[Ipv4Addr], only_local: bool) -> io::Result<Self> {
        let multicast = interfaces.iter().filter_map(|interface| multicast_sender(*interface, only_local)).collect();
        Ok(Self { remote: sender(None)?, local: sender(None)?, multicast })
    }
}

/// The sockets of the first participant id whose ports are free. They are not shared, so that a port belongs to one participant.
fn unicast_receivers(domain: u16, filter: Option<&[SockFilter]>) -> io::Result<(u16, [(Channel, UdpSocket); 2])> {
    for participant_id in 0..=PARTICIPANT_ID_MAX {
        let open = |channel| {
            let port = port(channel, domain, participant_id).ok_or(ErrorKind::AddrInUse)?;
            receiver(port, false, filter).map(|socket| (channel, socket))
        };
        match open(Channel::DiscoveryUnicast).and_then(|first| Ok([first, open(Channel::DataUnicast)?])) {
            Ok(sockets) => return Ok((participant_id, sockets)),
            Err(error) if error.kind() == ErrorKind::AddrInUse => {}
            Err(error) => return Err(error),
        }
    }
    Err(io::Error::new(ErrorKind::AddrInUse, "every participant id of the ROS domain is in use"))
}

/// Sockets of the group. All participants of this host share their ports.
fn multicast_receivers(
    domain: u16,
    interfaces: &[Ipv4Addr],
    filter: Option<&[SockFilter]>,
) -> io::Result<[(Channel, UdpSocket); 2]> {
    let open = |channel| {
        let socket = receiver(port(channel, domain, 0).ok_or(ErrorKind::AddrInUse)?, true, filter)?;
        let mut joined = Err(ErrorKind::AddrNotAvailable.into());
        for interface in interfaces {
            // One without multicast does not take it from the others.
            joined = joined.or(socket.join_multicast_v4(&GROUP, interface));
        }
        joined.map(|()| (channel, socket))
    };
    Ok([open(Channel::DiscoveryMulticast)?, open(Channel::DataMulticast)?])
}

/// The port of a channel. None beyond 65535: the last domains have room for some participants only.
fn port(channel: Channel, domain: u16, participant_id: u16) -> Option<u16> {
    match channel {
        Channel::DiscoveryMulticast => discovery_multicast(domain).map(|group| group.port()),
        Channel::DataMulticast => data_multicast(domain).map(|group| group.port()),
        Channel::DiscoveryUnicast => discovery_port(domain, participant_id),
        Channel::DataUnicast => data_port(domain, participant_id),
    }
}

fn receiver(port: u16, is_shared: bool, filter: Option<&[SockFilter]>) -> io::Result<UdpSocket> {
    let socket = Socket::new(Domain::IPV4, Type::DGRAM, Some(Protocol::UDP))?;
    if let Some(filter) = filter {
        socket.attach_filter(filter)?;
    }
    if is_shared {
        socket.set_reuse_address(true)?;
        socket.set_reuse_port(true)?;
    }
    socket.set_recv_buffer_size(BUFFER_BYTES)?;
    // Linux reports twice of what it grants.
    let granted = socket.recv_buffer_size()? / 2;
    if granted < BUFFER_BYTES_LOW {
        tracing::info!(
            port,
            granted,
            "the receive buffer is small: a larger net.core.rmem_max keeps large samples whole"
        );
    }
    bound(socket, Ipv4Addr::UNSPECIFIED, port)
}

/// Sends multicasts by this interface; none if it cannot.
fn multicast_sender(interface: Ipv4Addr, only_local: bool) -> Option<UdpSocket> {
    let open = || {
        let socket = sender(Some(interface))?;
        // Other participants of this host receive them. With a TTL of 0 no other host does.
        socket.set_multicast_loop_v4(true)?;
        socket.set_multicast_ttl_v4(u32::from(!only_local))?;
        Ok(socket)
    };
    open().inspect_err(|error: &io::Error| tracing::debug!(%interface, %error, "no multicasts by this interface")).ok()
}

fn sender(interface: Option<Ipv4Addr>) -> io::Result<UdpSocket> {
    let socket = Socket::new(Domain::IPV4, Type::DGRAM, Some(Protocol::UDP))?;
    socket.attach_filter(&filter::nothing())?;
    socket.set_send_buffer_size(BUFFER_BYTES)?;
    if let Some(interface) = interface {
        socket.set_multicast_if_v4(&interface)?;
    }
    bound(socket, interface.unwrap_or(Ipv4Addr::UNSPECIFIED), 0)
}

fn bound(socket: Socket, address: Ipv4Addr, port: u16) -> io::Result<UdpSocket> {
    socket.set_nonblocking(true)?;
    socket.bind(&SocketAddr::from((address, port)).into())?;
    Ok(socket.into())
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    /// A domain that other tests do not use. Other participants with ports there take other ids.
    const DOMAIN: u16 = 231;

    fn opened() -> ReceiveSockets {
        ReceiveSockets::open(DOMAIN, &[Ipv4Addr::LOCALHOST], Some(&[])).unwrap()
    }

    #[test]
    fn participants_of_a_host_share_multicast_ports_and_have_unicast_ports_of_their_own() {
        let (first, second) = (opened(), opened());
        assert_ne!(first.participant_id, second.participant_id);
        for sockets in [&first, &second] {
            assert_eq!(sockets.channels.len(), 4);
            for (channel, socket) in &sockets.channels {
                let wanted = port(*channel, DOMAIN, sockets.participant_id);
                assert_eq!(Some(socket.local_addr().unwrap().port()), wanted, "{channel:?}");
            }
        }
    }

    #[test]
    fn ports_follow_from_the_domain_and_the_participant_id() {
        let ports = |domain, participant_id| {
            [Channel::DiscoveryMulticast, Channel::DataMulticast, Channel::DiscoveryUnicast, Channel::DataUnicast]
                .map(|channel| port(channel, domain, participant_id))
        };
        assert_eq!(ports(0, 0), [7400, 7401, 7410, 7411].map(Some));
        assert_eq!(ports(3, 2), [8150, 8151, 8164, 8165].map(Some));
        assert_eq!(ports(232, 63), [Some(65_400), Some(65_401), None, None]);
    }

    #[test]
    fn a_participant_without_multicast_has_its_unicast_sockets_only() {
        let sockets = ReceiveSockets::open(DOMAIN, &[], None).unwrap();
        assert_eq!((sockets.channels.len(), sockets.has_multicast), (2, false));
        // No interface has this address.
        let sockets = ReceiveSockets::open(DOMAIN, &[Ipv4Addr::new(192, 0, 2, 1)], None).unwrap();
        assert_eq!((sockets.channels.len(), sockets.has_multicast), (2, false));
    }

    #[test]
    fn the_loopback_is_among_the_interfaces_of_this_host_and_comes_first() {
        let all = Interfaces::read(None);
        assert_eq!(all.used.first(), Some(&Ipv4Addr::LOCALHOST));
        assert_eq!(Interfaces::read(Some(&[Ipv4Addr::LOCALHOST])).used, [Ipv4Addr::LOCALHOST]);
        assert!(Interfaces::read(Some(&[Ipv4Addr::BROADCAST])).used.is_empty());
    }
}
